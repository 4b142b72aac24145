"""Gradient-CEM on dynamics whose best plan is known."""

from __future__ import annotations

import pytest
import torch
from planning_toys import (
    Spoiled,
    cem_parameters,
    gap,
    gradient_parameters,
    history,
    planner,
    solve,
)

from cassie_lib.errors import (
    ParameterError,
)
from cassie_lib.planning.candidates import Scorer
from cassie_lib.planning.gradient_cem import momentum_step, normalise


def test_gradient_cem_beats_cem_with_the_same_rollouts():
    gradient = solve(gradient_parameters())
    plain = solve(cem_parameters(samples=gradient.rollouts // 3, elites=8, iterations=2))
    assert plain.rollouts >= gradient.rollouts - 3
    assert 0 <= gap(gradient) < 0.05
    assert gap(gradient) < 0.3 * gap(plain)


def test_gradients_on_all_samples_are_at_least_as_good():
    elites = solve(gradient_parameters(iterations=1))
    everything = solve(gradient_parameters(iterations=1, gradient_on_all=True))
    assert gap(everything) < gap(elites) + 0.02
    assert everything.rollouts > elites.rollouts


def test_gradient_is_autograds_and_ascends():
    made = planner(gradient_parameters())
    start, phase = history(2), torch.zeros(2, dtype=torch.long)
    scorer = Scorer(made.objective, start, phase, torch.zeros(2))
    actions = 0.1 * torch.randn(2, 3, 4, 10, generator=torch.Generator().manual_seed(1))
    found = made._gradient(scorer, actions)
    step, direction = 1e-3, torch.randn(actions.shape, generator=torch.Generator().manual_seed(2))
    upper, lower = (scorer(actions + sign * step * direction).value for sign in (1, -1))
    expected = -(upper - lower) / (2 * step)
    torch.testing.assert_close((found * direction).sum((2, 3)), expected, rtol=2e-2, atol=2e-2)
    assert (scorer(actions - 1e-3 * found).value > scorer(actions).value).all()


def test_momentum_step_is_torch_sgd():
    target = torch.randn(2, 3, 4, 10, generator=torch.Generator().manual_seed(3))
    parameter = torch.nn.Parameter(torch.zeros_like(target))
    optimiser = torch.optim.SGD([parameter], lr=7e-2, momentum=0.8)
    actions, velocity = torch.zeros_like(target), torch.zeros_like(target)
    for _ in range(7):
        optimiser.zero_grad()
        (parameter - target).pow(2).sum().backward()
        optimiser.step()
        gradient = 2 * (actions - target)
        actions, velocity = momentum_step(actions, velocity, gradient, 7e-2, 0.8)
    torch.testing.assert_close(actions, parameter.detach())


def test_normalised_gradient_has_unit_norm_or_is_zero():
    gradient = torch.randn(1, 3, 4, 10) * torch.tensor([1e-6, 0.0, 1e6]).view(1, 3, 1, 1)
    norm = normalise(gradient).flatten(2).norm(dim=-1)[0]
    assert norm.tolist() == pytest.approx([1.0, 0.0, 1.0], abs=1e-5)


def test_an_annealed_rate_reaches_further_and_stops_closer():
    """Steps of unit gradients do not shrink by themselves: only annealed long ones end near."""
    options = {"normalise_gradient": True, "iterations": 1, "gradient_iterations": 12}
    long, short = {"learning_rate": 0.3}, {"learning_rate": 0.01}
    annealed = gap(solve(gradient_parameters(**options, **long, anneal=True)))
    assert annealed < 0.5 * gap(solve(gradient_parameters(**options, **long)))
    assert annealed < 0.5 * gap(solve(gradient_parameters(**options, **short)))


def test_gradient_survives_a_spoiled_candidate():
    # Steep steps push elites over the threshold; the rest must go on.
    parameters = gradient_parameters(learning_rate=0.5, keep_best=True, samples=32)
    plan = solve(parameters, model=Spoiled(0.02))
    assert plan.non_finite.item() > 0
    assert torch.isfinite(plan.actions).all()
    assert plan.actions[0, 0, 0] <= 0.02


@pytest.mark.parametrize(
    "changes", [{"gradient_iterations": 0}, {"learning_rate": 0.0}, {"momentum": 1.0}]
)
def test_bad_gradient_settings_are_refused(changes):
    with pytest.raises(ParameterError, match=next(iter(changes))):
        planner(gradient_parameters(**changes))
