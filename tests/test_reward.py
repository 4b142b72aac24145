"""Eq 3.10: weights, bounds, deadbands, the trap of standing, NumPy against torch."""

import numpy as np
import pytest
import torch

from cassie_lib import gait
from cassie_lib.errors import ShapeError
from cassie_lib.plots.robot import reference_states
from cassie_lib.reward import DEADBAND, WEIGHTS, ReferencePose, reward, reward_terms
from cassie_lib.robot import schema


def _perfect(count=3):
    """States that match a reference exactly, at the commanded speed."""
    rng = np.random.default_rng(0)
    states = np.zeros((count, 49))
    states[:, 1] = 1.0
    states[:, schema.MOTOR_POSITION] = rng.normal(size=(count, 10))
    states[:, schema.JOINT_POSITION] = rng.normal(size=(count, 6))
    states[:, schema.SPEED] = states[:, 15:16] = 0.3
    pose = ReferencePose(states[:, schema.MOTOR_POSITION].copy(),
                         states[:, schema.JOINT_POSITION].copy())  # fmt: skip
    return states, pose


def test_weights_sum_to_one_and_a_perfect_state_earns_them():
    assert sum(WEIGHTS.values()) == pytest.approx(1.0)
    states, pose = _perfect()
    terms = reward_terms(states, pose, np.zeros(3))
    for name, weight in WEIGHTS.items():
        np.testing.assert_allclose(terms[name], weight)
    np.testing.assert_allclose(reward(states, pose, np.zeros(3)), 1.0)


def test_constants_by_hand():
    states, pose = _perfect(1)
    states[0, 1] = np.cos(0.1)  # turned by 0.2 rad
    states[0, 5] += 0.1
    states[0, 9] -= 0.2
    states[0, 15] += 0.4
    states[0, 16] = -0.1
    states[0, 34] += 0.02
    terms = reward_terms(states, pose, np.array([0.3]))
    assert terms["orientation"][0] == pytest.approx(0.3 * np.exp(-5 * (1 - np.cos(0.1) ** 2)))
    assert terms["motor"][0] == pytest.approx(0.2 * np.exp(-30 * (0.15 * 0.01 + 0.05 * 0.04)))
    assert terms["forward_velocity"][0] == pytest.approx(0.2 * np.exp(-0.4))
    assert terms["lateral_velocity"][0] == pytest.approx(0.2 * np.exp(-0.1))
    assert terms["lateral_position"][0] == pytest.approx(0.05 * np.exp(-0.3))
    assert terms["spring"][0] == pytest.approx(0.05 * np.exp(-1000 * 0.02**2))


def test_deadbands_are_flat_inside_and_can_be_dropped():
    states, pose = _perfect(1)
    states[0, 15] += 0.9 * DEADBAND["forward_velocity"]
    states[0, 16] = 0.9 * DEADBAND["lateral_velocity"]
    near = np.array([0.9 * DEADBAND["lateral_position"]])
    assert reward(states, pose, near)[0] == pytest.approx(1.0)
    assert reward(states, pose, near, deadband=False)[0] < 0.99


def test_bounded_by_zero_and_one():
    rng = np.random.default_rng(1)
    states, pose = _perfect(200)
    states += rng.normal(0.0, 5.0, states.shape)
    states[:, 1:5] /= np.linalg.norm(states[:, 1:5], axis=1, keepdims=True)
    total = reward(states, pose, rng.normal(0.0, 5.0, 200))
    assert (total >= 0).all()
    assert (total <= 1).all()


def test_torch_gives_the_same_numbers_and_gradients():
    rng = np.random.default_rng(2)
    states, pose = _perfect(4)
    states += rng.normal(0.0, 0.1, states.shape)
    lateral = rng.normal(0.0, 0.3, 4)
    leaf = torch.tensor(states, requires_grad=True)
    tensors = ReferencePose(torch.tensor(pose.motor_position), torch.tensor(pose.joint_position))
    total = reward(leaf, tensors, torch.tensor(lateral))
    np.testing.assert_allclose(total.detach().numpy(), reward(states, pose, lateral), rtol=1e-12)
    total.sum().backward()
    for component in (1, 6, 15, 34):
        shifted = [states.copy() for _ in range(2)]
        shifted[0][:, component] -= 1e-6
        shifted[1][:, component] += 1e-6
        low, high = (reward(s, pose, lateral) for s in shifted)
        np.testing.assert_allclose(leaf.grad[:, component], (high - low) / 2e-6, atol=1e-6)


def test_standing_still_scores_high_and_is_the_trap():
    """READING_NOTES: 0.909 for standing.  Here: the standing pose, judged along the gait."""
    reference = gait.walk(0.0509)
    standing = reference_states(reference)
    pose = gait.step_in_place().motor_position[0]
    standing[:, schema.MOTOR_POSITION] = pose
    standing[:, schema.JOINT_POSITION] = reference.joint_position[0]
    standing[:, schema.PELVIS_VELOCITY] = 0.0
    score = reward(standing, reference.pose(np.arange(28)), np.zeros(28)).mean()
    assert 0.85 < score < 0.99


def test_wrong_shape():
    with pytest.raises(ShapeError, match=r"\(2, 48\): expected \(..., 49\)"):
        reward(np.zeros((2, 48)), ReferencePose(np.zeros(10), np.zeros(6)), 0.0)
