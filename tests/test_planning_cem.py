"""CEM, and what it shares with Gradient-CEM, on dynamics whose best plan is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from planning_toys import (
    CONTEXT,
    DoubleIntegrator,
    Spoiled,
    cem_parameters,
    gap,
    gradient_parameters,
    history,
    planner,
    quadratic_reward,
    solve,
)

from cassie_lib.errors import (
    NonFiniteError,
    ParameterError,
    SchemaError,
    ShapeError,
    UnknownNameError,
)
from cassie_lib.planning.candidates import Candidates
from cassie_lib.planning.cem import CYCLES
from cassie_lib.planning.sampling import shift


def test_cem_approaches_the_linear_quadratic_optimum():
    few, diagonal, full = (
        gap(solve(cem_parameters(samples=1500, elites=150, iterations=c, covariance=covariance)))
        for c, covariance in ((2, "diagonal"), (20, "diagonal"), (20, "full"))
    )
    # Actions of neighbouring steps trade off: the full covariance learns that, the diagonal not.
    assert 0 <= full < 0.01 < diagonal < 0.2 < few


def test_imagined_return_leaves_the_terminal_value_out():
    def terminal(history, states, phase):
        return 100.0 + 0.0 * states[..., 0].sum(dim=-1)

    plain = solve(cem_parameters())
    valued = solve(cem_parameters(), terminal_value=terminal)
    # A constant changes neither the choice nor the part that can be compared with what follows.
    torch.testing.assert_close(valued.actions, plain.actions)
    torch.testing.assert_close(valued.imagined_return, plain.imagined_return)
    assert (valued.best_by_round > plain.best_by_round + 50.0).all()


@pytest.mark.parametrize("make", [cem_parameters, gradient_parameters])
def test_batch_of_episodes_is_single_plans(make):
    options = {"mean": "warm", "elite_reuse": 0.5, "noise_colour": 1.0, "include_mean": True}
    together = planner(make(**options))
    together.reset([5, 6, 7])
    alone = planner(make(**options))
    alone.reset([6])
    whole = history(3)
    part = history(3)._replace(states=whole.states[1:2], actions=whole.actions[1:2])
    for _ in range(2):
        many = together.plan(whole, np.zeros(3, int), np.zeros(3))
        one = alone.plan(part, np.zeros(1, int), np.zeros(1))
        torch.testing.assert_close(many.actions[1:2], one.actions, rtol=1e-4, atol=1e-5)
    assert not torch.allclose(many.actions[0], many.actions[1])


def test_planning_a_part_of_the_episodes_keeps_the_others_memory():
    options = {"mean": "warm", "elite_reuse": 0.3}
    one, other = planner(cem_parameters(**options)), planner(cem_parameters(**options))
    full = history(3)
    part = full._replace(states=full.states[[0, 2]], actions=full.actions[[0, 2]])
    for made in (one, other):
        made.reset([1, 2, 3])
        made.plan(full, np.zeros(3, int), np.zeros(3))
    a = one.plan(full, np.zeros(3, int), np.zeros(3))
    b = other.plan(part, np.zeros(2, int), np.zeros(2), episodes=[0, 2])
    torch.testing.assert_close(a.actions[[0, 2]], b.actions)


@pytest.mark.parametrize("make", [cem_parameters, gradient_parameters])
def test_same_seed_same_plan(make):
    one, same, other = (solve(make(), seeds=[seed]) for seed in (4, 4, 5))
    assert torch.equal(one.actions, same.actions)
    assert not torch.equal(one.actions, other.actions)


@pytest.mark.parametrize("make", [cem_parameters, gradient_parameters])
@pytest.mark.parametrize("covariance", ["diagonal", "full"])
def test_bounds_hold_and_bind(make, covariance):
    asked = []

    class Watched(DoubleIntegrator):
        def predict(self, history, actions):
            asked.append((actions.min().item(), actions.max().item()))
            return super().predict(history, actions)

    parameters = make(lower_rad=-0.02, upper_rad=0.01, covariance=covariance)
    plan = solve(parameters, model=Watched())
    eps = 1e-7
    assert min(low for low, _ in asked) >= -0.02 - eps
    assert max(high for _, high in asked) <= 0.01 + eps
    assert plan.actions.max() > 0.005
    assert plan.actions.min() < -0.015


def test_every_sample_an_elite():
    plan = solve(cem_parameters(samples=8, elites=8))
    assert torch.isfinite(plan.actions).all()
    assert torch.isfinite(solve(cem_parameters(samples=1, elites=1)).actions).all()


def test_best_seen_sequence_is_kept():
    kept = solve(cem_parameters(keep_best=True))
    assert kept.imagined_return == kept.best_by_round.max()
    last = solve(cem_parameters(keep_best=False))
    assert last.imagined_return == last.best_by_round[-1]
    with_gradient = solve(gradient_parameters(keep_best=True, iterations=1, std_floor_rad=0.1))
    # The optimised elites themselves, not just what was sampled, are remembered.
    assert with_gradient.imagined_return > with_gradient.best_by_round.max()


def test_imagined_return_and_states_are_those_of_the_plan():
    plan = solve(gradient_parameters(keep_best=True), episodes=2)
    model = DoubleIntegrator()
    states = model.predict(history(2), plan.actions[:, None])
    torch.testing.assert_close(plan.states, states[:, 0])
    discount = 0.9 ** torch.arange(1, 5)
    value = (quadratic_reward(states, None, None)[:, 0] * discount).sum(-1)
    torch.testing.assert_close(plan.imagined_return, value)


def test_warm_start_moves_the_last_plan_on():
    made = planner(cem_parameters(mean="warm", variance=(0.0,) * 10, std_floor_rad=0.0))
    made.reset([0])
    made._last[:] = 0.01 * torch.arange(4.0).view(1, 4, 1)
    previous = made._last.clone()
    plan = made.plan(history(), [0], [0.0])
    # Without variance the mean is all there is.
    torch.testing.assert_close(plan.actions, shift(previous))
    made.forget([0])
    assert torch.equal(made.plan(history(), [0], [0.0]).actions, torch.zeros(1, 4, 10))


@pytest.mark.parametrize("mean", CYCLES)
def test_a_cycles_mean_is_the_cycle_at_its_phase(mean):
    cycle = 0.01 * torch.arange(28.0)[:, None].expand(28, 10)
    made = planner(cem_parameters(mean=mean, variance=(0.0,) * 10, std_floor_rad=0.0), cycle=cycle)
    made.reset([0, 1])
    plan = made.plan(history(2), [26, 3], [0.0, 0.0])
    assert plan.actions[:, :, 0].numpy() * 100 == pytest.approx(
        np.array([[26, 27, 0, 1], [3, 4, 5, 6]]), abs=1e-4
    )


@pytest.mark.parametrize("carry", [0.0, 0.5, 1.0])
def test_part_of_the_last_departure_from_the_cycle_is_carried_over(carry):
    cycle = 0.01 * torch.arange(28.0)[:, None].expand(28, 10)
    still = {"variance": (0.0,) * 10, "std_floor_rad": 0.0}
    made = planner(cem_parameters(mean="feedforward", carry=carry, **still), cycle=cycle)
    made.reset([0])
    made._last[:] = 0.1 * torch.arange(4.0).view(1, 4, 1)
    plan = made.plan(history(), [5], [0.0])
    # At phase 5 the cycle is .05 .06 .07 .08; of the departure 0 .1 .2 .3 one step has gone by.
    wanted = np.array([0.05, 0.06, 0.07, 0.08]) + carry * np.array([0.1, 0.2, 0.3, 0.3])
    assert plan.actions[0, :, 0].numpy() == pytest.approx(wanted, abs=1e-5)
    again = made.plan(history(), [6], [0.0]).actions[0, 0, 0].item()
    assert again == pytest.approx(0.06 + carry**2 * 0.2, abs=1e-5), "it fades by itself"


def test_what_is_carried_makes_a_plan_better_than_one_that_begins_anew():
    """Few samples around a poor cycle: the plans of later steps go on from the earlier ones."""
    value = {}
    for carry in (0.0, 0.9):
        parameters = cem_parameters(
            mean="feedforward", carry=carry, samples=8, elites=2, iterations=1, keep_best=True
        )
        made = planner(parameters, cycle=torch.full((28, 10), 0.3))
        made.reset([0])
        for phase in range(12):
            plan = made.plan(history(), [phase], [0.0])
        value[carry] = plan.imagined_return.item()
    assert value[0.9] > value[0.0]


def test_a_zero_mean_carries_nothing():
    made = planner(cem_parameters(mean="zero", carry=0.9, variance=(0.0,) * 10, std_floor_rad=0.0))
    made.reset([0])
    made._last[:] = 0.1
    assert not made.plan(history(), [0], [0.0]).actions.any()


def test_spoiled_candidates_score_worst_and_are_counted():
    plan = solve(cem_parameters(variance=(0.04,) * 10), model=Spoiled(0.05))
    assert plan.non_finite.item() > 0
    assert plan.actions[0, 0, 0] <= 0.05
    assert torch.isfinite(plan.imagined_return).all()


def test_fewer_finite_candidates_than_elites():
    value = torch.tensor([[float("-inf"), 1.0, float("-inf"), 2.0]])
    actions = torch.arange(4.0).view(1, 4, 1, 1).expand(1, 4, 2, 10)
    top = Candidates(actions, value, torch.zeros(1, 4, 2, 49)).top(3)
    assert top.actions[0, :, 0, 0].tolist() == [3.0, 1.0, 3.0]


def test_no_finite_candidate_is_an_error_that_names_the_episode():
    with pytest.raises(NonFiniteError, match=r"episodes \[0, 1\]"):
        solve(cem_parameters(), episodes=2, model=Spoiled(-1.0))


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"elites": 65}, ParameterError, "elites is 65"),
        ({"elites": 0}, ParameterError, "elites is 0"),
        ({"iterations": 0}, ParameterError, "iterations is 0"),
        ({"horizon": 0}, ParameterError, "horizon is 0"),
        ({"lower_rad": 0.5, "upper_rad": -0.5}, ParameterError, "lower < upper"),
        ({"lower_rad": float("nan")}, ParameterError, "bounds"),
        ({"elite_reuse": 1.5}, ParameterError, "elite_reuse is 1.5"),
        ({"carry": -0.1}, ParameterError, "carry is -0.1"),
        ({"std_floor_rad": -0.1}, ParameterError, "std_floor_rad"),
        ({"variance": (0.01,) * 9}, ShapeError, "9 values"),
        ({"mean": "last"}, UnknownNameError, "planner mean 'last'"),
        ({"covariance": "banded"}, UnknownNameError, "covariance 'banded'"),
        ({"warm_fill": "mirror"}, UnknownNameError, "warm fill 'mirror'"),
        ({"mean": "expert"}, ParameterError, "action_cycle"),
        ({"mean": "reference"}, ParameterError, "action_cycle"),
    ],
)
def test_contradicting_settings_are_refused(changes, error, message):
    with pytest.raises(error, match=message):
        planner(cem_parameters(**changes))


def test_cycle_of_another_length_is_refused():
    with pytest.raises(ShapeError, match="action_cycle"):
        planner(cem_parameters(mean="expert"), cycle=np.zeros((27, 10)))
    with pytest.raises(NonFiniteError, match="action_cycle"):
        planner(cem_parameters(mean="expert"), cycle=np.full((28, 10), np.nan))


def test_history_of_another_schema_or_context_is_refused():
    made = planner(cem_parameters())
    start = history()
    with pytest.raises(SchemaError, match="expected the 3"):
        made.plan(history(context=CONTEXT - 1), [0], [0.0])
    with pytest.raises(SchemaError, match="49"):
        made.plan(start._replace(states=start.states[..., :40]), [0], [0.0])
    with pytest.raises(ShapeError, match="history actions"):
        made.plan(start._replace(actions=torch.zeros(1, 5, 10)), [0], [0.0])
    with pytest.raises(ShapeError, match="phase"):
        made.plan(start, [0, 1], [0.0])
    with pytest.raises(ShapeError, match="as reset"):
        made.plan(history(2), [0, 1], [0.0, 0.0])


def test_model_of_another_schema_is_refused():
    class Other(DoubleIntegrator):
        def predict(self, history, actions):
            return super().predict(history, actions)[..., :40]

    with pytest.raises(SchemaError, match="predicts"):
        solve(cem_parameters(), model=Other())
