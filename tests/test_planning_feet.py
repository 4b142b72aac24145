"""Soles of predicted states against the simulator's own sensors."""

import numpy as np
import torch

from cassie_lib import gait
from cassie_lib.planning.feet import SoleHeight, rotation_row
from cassie_lib.robot.schema import PELVIS_HEIGHT
from cassie_lib.simulator import Simulator


def _posed(count=12, seed=0):
    """Simulator in odd poses: any joint angles, the pelvis turned."""
    rng = np.random.default_rng(seed)
    reference = gait.walk(0.5)
    simulator = Simulator(count, 0.002)
    qpos = reference.qpos[rng.integers(0, 28, count)].copy()
    qpos[:, 7:] += rng.normal(0.0, 0.1, qpos[:, 7:].shape)
    qpos[:, 3:7] = rng.normal(0.0, 0.2, (count, 4)) + [1.0, 0.0, 0.0, 0.0]
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    simulator.reset(qpos=qpos)
    return simulator


def test_heights_are_those_of_the_simulator_in_any_pose():
    simulator = _posed()
    found = SoleHeight()(torch.as_tensor(simulator.states, dtype=torch.float32))
    assert np.ptp(simulator.foot_height) > 0.1
    np.testing.assert_allclose(found.numpy(), simulator.foot_height, atol=2e-6)


def test_heights_follow_the_pelvis_and_differentiate():
    states = torch.as_tensor(_posed(3).states, dtype=torch.float64).requires_grad_(True)

    def sole(s):
        return SoleHeight()(s.float()).double()

    (gradient,) = torch.autograd.grad(sole(states).sum(), states)
    # Both soles rise with the pelvis.
    torch.testing.assert_close(gradient[:, PELVIS_HEIGHT], torch.full((3, 1), 2.0).double())
    step = torch.zeros_like(states)
    for index in (5, 8, 9, 18 + 16, 35, 2):
        step.zero_()
        step[:, index] = 1e-3
        change = (sole(states + step) - sole(states - step)).sum(dim=1) / 2e-3
        torch.testing.assert_close(change, gradient[:, index], atol=2e-3, rtol=0.0)


def test_rotation_row_of_a_roll_lifts_the_left_side():
    quarter = torch.tensor([np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0])
    torch.testing.assert_close(rotation_row(quarter), torch.tensor([0.0, 1.0, 0.0]).double(),
                               atol=1e-7, rtol=0.0, check_dtype=False)  # fmt: skip
