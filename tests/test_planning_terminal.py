"""What counts beyond the horizon."""

from __future__ import annotations

import math

import pytest
import torch
from planning_toys import DoubleIntegrator, gradient_parameters, history, quadratic_reward

from cassie_lib.dynamics.model import History
from cassie_lib.errors import ParameterError
from cassie_lib.expert.policy import ExpertPolicy
from cassie_lib.planning.assemble import make_planner
from cassie_lib.planning.gradient_cem import GradientCEM
from cassie_lib.planning.objective import Objective
from cassie_lib.planning.terminal import (
    CRITIC_UNIT,
    SPEED_SHARPNESS,
    CriticValue,
    CycleSpeed,
    TerminalSum,
)
from cassie_lib.presets import get_preset, replace
from cassie_lib.robot.schema import PELVIS_VELOCITY, PERIOD, SPEED

VX, VY = PELVIS_VELOCITY.start, PELVIS_VELOCITY.start + 1
COMMAND = 0.05


def test_critic_continues_its_memory_along_the_candidate():
    torch.manual_seed(0)
    policy = ExpertPolicy(hidden_size=8, layers=2).eval()
    past = history(2, context=4, seed=3)
    states = torch.randn(2, 3, 2, 49)
    found = CriticValue(policy)(past, states, None)
    for episode in range(2):
        for candidate in range(3):
            whole = torch.cat([past.states[episode], states[episode, candidate]])[:, None]
            value, _ = policy.critic(
                policy.normalise(whole), policy.critic.initial_memory(1), torch.zeros(6, 1)
            )
            torch.testing.assert_close(found[episode, candidate], CRITIC_UNIT * value[-1, 0, 0])


def test_terminal_value_has_gradients_after_use_in_inference_mode():
    value = CriticValue(ExpertPolicy(hidden_size=8, layers=1).eval())
    parameters = gradient_parameters(iterations=1, gradient_iterations=2)
    planner = GradientCEM(Objective(DoubleIntegrator(), quadratic_reward, 0.9, value), parameters)
    plan = planner.plan(history(), [0], [0.0])
    assert torch.isfinite(plan.actions).all()


def walk(velocity, context=30, horizon=10):
    """History and predicted states of one robot with ``velocity (steps, 2)``, commanded 0.05."""
    states = torch.zeros(1, context + horizon, 49)
    states[0, :, VX : VY + 1] = velocity
    states[..., SPEED.start] = COMMAND
    past = History(states[:, :context], torch.zeros(1, context - 1, 10))
    return past, states[:, None, context:]


def swaying(drift, first=0, steps=40):
    """On the commanded speed and with 0.3 m/s of sway about a drift to the side."""
    angle = 2 * math.pi * (torch.arange(steps) + first) / PERIOD
    forward = COMMAND + 0.1 * torch.cos(2 * angle)
    return torch.stack([forward, drift + 0.3 * torch.sin(angle)], dim=-1)


@pytest.mark.parametrize("drift", [0.0, 0.05, -0.05])
def test_speed_of_a_cycle_tells_drift_from_sway_at_every_phase(drift):
    expected = 2.0 * math.exp(-SPEED_SHARPNESS * abs(drift))
    for first in range(PERIOD):
        value = CycleSpeed(2.0)(*walk(swaying(drift, first)), None)
        assert value.shape == (1, 1)
        assert value.item() == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("context", "horizon"), [(30, 10), (5, 4), (6, 40), (18, 10), (1, 1)])
def test_speed_is_the_mean_of_the_last_cycle_or_of_what_is_known(context, horizon):
    generator = torch.Generator().manual_seed(context)
    velocity = 0.2 * torch.randn(context + horizon, 2, generator=generator)
    mean = velocity[-PERIOD:].mean(dim=0)
    error = (mean[0] - COMMAND).abs() + mean[1].abs()
    value = CycleSpeed(3.0)(*walk(velocity, context, horizon), None)
    torch.testing.assert_close(value[0, 0], 3.0 * torch.exp(-SPEED_SHARPNESS * error))


def test_speed_of_a_cycle_pulls_back_from_a_drift_and_towards_the_command():
    past, states = walk(swaying(0.05) + torch.tensor([-0.03, 0.0]))
    leaf = states.requires_grad_(True)
    (gradient,) = torch.autograd.grad(CycleSpeed()(past, leaf, None).sum(), leaf)
    assert (gradient[..., VX] > 0).all()
    assert (gradient[..., VY] < 0).all()
    others = [index for index in range(49) if index not in (VX, VY)]
    assert not gradient[..., others].any()


def test_terminal_values_add_up_and_change_nothing_where_they_are_absent():
    past, states = walk(swaying(0.05))
    parts = CycleSpeed(1.5), CriticValue(ExpertPolicy(hidden_size=8, layers=1).eval(), 0.3)
    found = TerminalSum(*parts)(past, states, None)
    torch.testing.assert_close(found, sum(part(past, states, None) for part in parts))
    model, preset = DoubleIntegrator(), get_preset("thesis").gradient_cem
    assert make_planner(model, preset).objective.terminal_value is None, "the thesis has none"
    made = make_planner(model, replace(preset, speed_weight=1.5)).objective.terminal_value
    torch.testing.assert_close(made(past, states, None), parts[0](past, states, None))
    expert = type("Expert", (), {"policy": parts[1]._policy})
    both = replace(preset, speed_weight=1.5, terminal_weight=0.3)
    made = make_planner(model, both, expert=expert).objective.terminal_value
    torch.testing.assert_close(made(past, states, None), found)


@pytest.mark.parametrize("weight", [-0.1, float("inf"), float("nan")])
def test_bad_weights_are_refused(weight):
    with pytest.raises(ParameterError, match=f"speed_weight is {weight}: expected a finite"):
        CycleSpeed(weight)
    with pytest.raises(ParameterError, match=f"terminal_weight is {weight}: expected a finite"):
        CriticValue(ExpertPolicy(hidden_size=8, layers=1), weight)
