"""Planners in closed loop, on a plant that is the toy model itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
import torch
from planning_toys import (
    CONTEXT,
    TARGET,
    DoubleIntegrator,
    cem_parameters,
    gradient_parameters,
    history,
    quadratic_reward,
)

from cassie_lib.dynamics.model import History
from cassie_lib.errors import ParameterError
from cassie_lib.planning.candidates import Scorer
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.control import PlannerController, realised_return
from cassie_lib.planning.gradient_cem import GradientCEM
from cassie_lib.planning.objective import Objective
from cassie_lib.robot.schema import MOTOR_POSITION, clock


class Seen(NamedTuple):
    """Stands in for an observation of the walking protocol."""

    states: np.ndarray
    physics: np.ndarray
    phase: np.ndarray
    pelvis_position: np.ndarray
    step: int


class Watchful(DoubleIntegrator):
    """Keeps the histories that it is given."""

    def __init__(self, **options):
        super().__init__(**options)
        self.histories = []

    def prepare(self, history):
        self.histories.append(history)
        return history


class Lazy:
    """An expert that always answers with the step number."""

    def reset(self, count, seed=0):
        self.count, self.step = count, 0

    def act(self, observation):
        self.step += 1
        return np.full((self.count, 10), 0.001 * self.step)


def drive(controller, steps, count=2, height=1.0, seed=0):
    """Run a controller on the toy plant; returns states before each action and the actions."""
    plant = DoubleIntegrator()
    state = history(count).states[:, -1].clone()
    state[:, 0] = torch.as_tensor(height)
    controller.reset(count, seed)
    states, actions = [], []
    for step in range(steps):
        phase = np.full(count, (14 + step) % 28)
        state[:, 46:48] = torch.as_tensor(clock(phase), dtype=torch.float32)
        seen = Seen(
            state.numpy().copy(), np.full((count, 68), step), phase, np.zeros((count, 3)), step
        )
        action = torch.as_tensor(controller.act(seen), dtype=torch.float32)
        states.append(state.clone())
        actions.append(action)
        now = History(state[:, None], torch.zeros(count, 0, 10))
        state = plant.predict(now, action[:, None, None])[:, 0, 0].clone()
    return torch.stack(states, 1), torch.stack(actions, 1)


def controller(model=None, expert=None, make=gradient_parameters, **options):
    parameters = make(mean="warm", keep_best=True, include_mean=True)
    kind = GradientCEM if make is gradient_parameters else CEM
    objective = Objective(model or DoubleIntegrator(), quadratic_reward, 0.9)
    return PlannerController(kind(objective, parameters), expert, **options)


def test_planner_reaches_the_target_and_what_it_imagines_comes_true():
    made = controller()
    states, _ = drive(made, 25)
    error = (states[..., MOTOR_POSITION] - TARGET).abs().amax(dim=(0, 2))
    assert error[-1] < 0.2 * error[0]
    log = made.log()
    valid = np.isfinite(log.realised_return)
    assert valid.sum() == 2 * (25 - 4)
    # On the true model they differ only because every later step plans a little further ahead.
    np.testing.assert_allclose(
        log.realised_return[valid], log.imagined_return[valid], rtol=0.1, atol=1e-4
    )


def test_expert_drives_until_the_hand_over_and_the_context_is_what_happened():
    model = Watchful()
    made = controller(model, Lazy())
    states, actions = drive(made, 6)
    log = made.log()
    assert made.handover_step == log.handover_step == CONTEXT
    assert log.planned.all(axis=1).tolist() == [False] * 3 + [True] * 3
    assert np.isnan(log.plan_time_s[:3]).all()
    assert (log.plan_time_s[3:] > 0).all()
    assert actions[0, :3, 0].tolist() == pytest.approx([0.001, 0.002, 0.003])
    first, last = model.histories[0], model.histories[-1]
    torch.testing.assert_close(first.states, states[:, 1:4])
    torch.testing.assert_close(first.actions, actions[:, 1:3])
    torch.testing.assert_close(last.states, states[:, 3:6])
    torch.testing.assert_close(last.actions, actions[:, 3:5])
    assert (first.physics == 3).all()
    assert first.phase.tolist() == [17, 17]


def test_padded_context_needs_no_expert():
    model = Watchful()
    made = controller(model)
    states, actions = drive(made, 3)
    assert made.log().planned.all()
    padded = model.histories[0]
    torch.testing.assert_close(padded.states, states[:, :1].expand(-1, CONTEXT, -1))
    assert not padded.actions.any()
    # One real pair has displaced one copy.
    torch.testing.assert_close(model.histories[1].states[:, 1:], states[:, :2])
    torch.testing.assert_close(model.histories[1].actions[:, -1], actions[:, 0])


def test_fallen_robot_is_left_out_and_changes_nothing_for_the_others():
    together = controller(make=cem_parameters)
    _, actions = drive(together, 4, height=[1.0, 0.3])
    log = together.log()
    assert not actions[1].any()
    assert not log.planned[:, 1].any()
    assert np.isnan(log.imagined_return[:, 1]).all()
    _, alone = drive(controller(make=cem_parameters), 4, height=[1.0, 1.0])
    torch.testing.assert_close(actions[0], alone[0])


def test_seed_decides_the_actions():
    _, one = drive(controller(), 3)
    _, same = drive(controller(), 3)
    _, other = drive(controller(), 3, seed=9)
    assert torch.equal(one, same)
    assert not torch.allclose(one, other)


def test_context_of_one_state():
    _, actions = drive(controller(DoubleIntegrator(context=1)), 3)
    assert torch.isfinite(actions).all()


def test_realised_return_is_the_discounted_future():
    reward = np.random.default_rng(0).random((9, 2))
    found = realised_return(reward, 3, 0.9)
    expected = 0.9 * reward[3] + 0.81 * reward[4] + 0.729 * reward[5]
    np.testing.assert_allclose(found[2], expected)
    assert np.isfinite(found[:6]).all()
    assert np.isnan(found[6:]).all()
    assert np.isnan(realised_return(reward, 9, 0.9)).all()


def test_hand_over_must_leave_the_model_its_context():
    with pytest.raises(ParameterError, match="at least 2"):
        controller(expert=Lazy(), handover_step=1)
    with pytest.raises(ParameterError, match="expected 0 without an expert"):
        controller(handover_step=30)
    made = controller(expert=Lazy(), handover_step=CONTEXT - 1)
    drive(made, 3)
    assert made.log().planned.any(axis=1).tolist() == [False, False, True]


def test_scorer_gives_the_best_of_all_that_it_has_scored_as_a_plan():
    objective = Objective(DoubleIntegrator(), quadratic_reward, 0.9)
    start = history(2)
    scorer = Scorer(objective, start, torch.zeros(2, dtype=torch.long), torch.zeros(2))
    with pytest.raises(ParameterError, match="no candidates"):
        scorer.plan()
    drawn = 0.1 * torch.randn(2, 12, 4, 10, generator=torch.Generator().manual_seed(0))
    values = torch.cat([scorer(part).value for part in drawn.split(5, dim=1)], dim=1)
    plan = scorer.plan()
    assert torch.equal(plan.imagined_return, values.amax(dim=1))
    assert torch.equal(plan.actions, drawn[torch.arange(2), values.argmax(dim=1)])
    assert plan.rollouts == 12
    assert torch.equal(plan.states, objective.model.predict(start, plan.actions[:, None])[:, 0])
