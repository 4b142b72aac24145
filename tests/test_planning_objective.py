"""The return that planners maximise."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from planning_toys import DoubleIntegrator, history, quadratic_reward

from cassie_lib.errors import ParameterError, UnknownNameError
from cassie_lib.gait import walk
from cassie_lib.planning.objective import Objective, integrate_lateral
from cassie_lib.planning.stage_reward import WalkingReward, foot_term
from cassie_lib.reward import ReferencePose, reward
from cassie_lib.robot.schema import PELVIS_VELOCITY

GAIT = walk(0.0509)
VY = PELVIS_VELOCITY.start + 1


def states_near_reference(count=2, candidates=3, horizon=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.zeros(count, candidates, horizon, 49) + 0.1 * torch.randn(
        count, candidates, horizon, 49, generator=generator
    )


@pytest.mark.parametrize("deadband", [True, False])
def test_walking_reward_is_equation_3_10_at_each_phase(deadband):
    states, lateral = states_near_reference(), 0.2 * torch.randn(2, 3, 4)
    phases = torch.tensor([[26, 27, 0, 1], [5, 6, 7, 8]])
    found = WalkingReward(GAIT, deadband=deadband)(states, phases, lateral)
    for episode in range(2):
        for step in range(4):
            phase = phases[episode, step].item()
            pose = ReferencePose(GAIT.motor_position[phase], GAIT.joint_position[phase])
            expected = reward(
                states[episode, :, step].numpy(), pose, lateral[episode, :, step].numpy(), deadband
            )
            np.testing.assert_allclose(found[episode, :, step], expected, rtol=1e-5)


def test_height_form_scores_height_and_not_position():
    states = states_near_reference()
    phases = torch.zeros(2, 4, dtype=torch.long)
    form = WalkingReward(GAIT, lateral="height")
    far = form(states, phases, torch.full((2, 3, 4), 5.0))
    assert torch.equal(far, form(states, phases, torch.zeros(2, 3, 4)))
    sunk = states.clone()
    states[..., 0], sunk[..., 0] = GAIT.qpos[0, 2], GAIT.qpos[0, 2] - 0.5
    lost = form(states, phases, None) - form(sunk, phases, None)
    assert lost.numpy() == pytest.approx(0.05 * (1 - np.exp(-0.5)), abs=1e-5)
    with pytest.raises(UnknownNameError, match="lateral term 'sideways'"):
        WalkingReward(GAIT, lateral="sideways")


def test_foot_term_pays_for_lifting_the_right_foot_and_pulls_a_low_one_up():
    phases = torch.arange(4)[None] + 5
    states = torch.zeros(1, 1, 4, 49)
    states[..., 0] = torch.as_tensor(GAIT.qpos[5:9, 2])
    states[..., 1:5] = torch.as_tensor(GAIT.qpos[5:9, 3:7])
    states[..., 5:15] = torch.as_tensor(GAIT.motor_position[5:9])
    states[..., 34:40] = torch.as_tensor(GAIT.joint_position[5:9])
    zero = torch.zeros(1, 1, 4)
    plain, stepping = (WalkingReward(GAIT, foot_weight=weight) for weight in (0.0, 0.3))
    expected = 0.7 * plain(states, phases, zero) + 0.3
    torch.testing.assert_close(stepping(states, phases, zero), expected, atol=1e-4, rtol=0.0)
    # Let the swinging foot (lifted in the reference) hang: a straighter knee lowers it.
    swing = int(GAIT.foot_height_m[5:9].mean(axis=0).argmax())
    knee = 5 + 5 * swing + 3
    states[..., knee] += 0.4
    leaf = states.clone().requires_grad_(True)
    (gradient,) = torch.autograd.grad(stepping(leaf, phases, zero).sum(), leaf)
    assert (stepping(states, phases, zero) < expected - 0.02).all()
    assert (gradient[..., knee] < 0.0).all()
    # A robot that keeps both feet on the floor gets nothing of the term over a cycle.
    heights = torch.as_tensor(GAIT.foot_height_m)
    standing = foot_term(torch.zeros(28, 2), heights, float(heights.mean()))
    assert standing.mean().item() == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(ParameterError, match="foot_weight is 1.5"):
        WalkingReward(GAIT, foot_weight=1.5)


def test_lateral_position_is_the_integral_of_velocity():
    # Constant acceleration: the trapezoid is exact.
    time = 0.03 * torch.arange(1, 6)
    states = torch.zeros(1, 1, 5, 49)
    states[..., VY] = 0.2 + 0.7 * time
    now = torch.zeros(1, 49)
    now[0, VY] = 0.2
    found = integrate_lateral(states, now, torch.tensor([0.4]))
    torch.testing.assert_close(found[0, 0], 0.4 + 0.2 * time + 0.35 * time**2)


def test_return_discounts_by_powers_and_adds_the_terminal_value():
    model, start = DoubleIntegrator(), history(2)
    actions = 0.1 * torch.randn(2, 3, 5, 10, generator=torch.Generator().manual_seed(1))
    seen = []

    def stage(states, phase, lateral_m):
        seen.append(phase)
        return torch.arange(1.0, 6.0).expand(2, 3, 5)

    def terminal(history, states, phase):
        assert states.shape == (2, 3, 5, 49)
        return torch.full((2, 3), 7.0)

    phase = torch.tensor([25, 3])
    score = Objective(model, stage, 0.9, terminal).bind(start, phase, torch.zeros(2))(actions)
    expected = sum(0.9**t * t for t in range(1, 6)) + 0.9**6 * 7.0
    assert score.value.numpy() == pytest.approx(expected, rel=1e-6)
    assert seen[0].tolist() == [[26, 27, 0, 1, 2], [4, 5, 6, 7, 8]]


def test_values_follow_their_candidates_when_these_are_permuted_or_split():
    actions = 0.1 * torch.randn(2, 7, 4, 10, generator=torch.Generator().manual_seed(2))
    order = torch.randperm(7, generator=torch.Generator().manual_seed(3))
    problem = history(2), torch.zeros(2, dtype=torch.long), torch.zeros(2)
    whole = Objective(DoubleIntegrator(), quadratic_reward).bind(*problem)(actions)
    permuted = Objective(DoubleIntegrator(), quadratic_reward).bind(*problem)(actions[:, order])
    torch.testing.assert_close(whole.value[:, order], permuted.value)
    model = DoubleIntegrator()
    with torch.no_grad():
        split = Objective(model, quadratic_reward, max_rows=6).bind(*problem)(actions)
    assert model.predictions == 3
    torch.testing.assert_close(split.value, whole.value)
    torch.testing.assert_close(split.states, whole.states)


def test_return_is_differentiable_through_lateral_velocity():
    class Sideways(DoubleIntegrator):
        """The first motor's action is the lateral velocity."""

        def predict(self, history, actions):
            states = super().predict(history, actions)
            keep = torch.ones(49)
            keep[VY] = 0.0
            one = 1.0 - keep
            return states * keep + actions[..., :1] * one

    actions = torch.full((1, 1, 4, 10), 0.2, requires_grad=True)
    form = WalkingReward(GAIT, deadband=False)
    score = Objective(Sideways(0.0), form).bind(
        history(), torch.zeros(1, dtype=torch.long), torch.tensor([0.3])
    )
    (gradient,) = torch.autograd.grad(score(actions).value.sum(), actions)
    assert (gradient[0, 0, :, 0] < 0).all()
    # The first step's velocity moves every later position as well.
    assert gradient[0, 0, 0, 0] < gradient[0, 0, -1, 0]


def test_bad_discount_is_refused():
    for discount in (0.0, 1.1, float("nan")):
        with pytest.raises(ParameterError, match="discount"):
            Objective(DoubleIntegrator(), quadratic_reward, discount)
