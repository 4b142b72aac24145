"""Feed-forward of a gait: load, symmetry, and what it does on the true simulator."""

from __future__ import annotations

import numpy as np
import pytest

from cassie_lib import gait
from cassie_lib.planning.assemble import reference_cycle
from cassie_lib.planning.feedforward import feedforward_cycle, load_share
from cassie_lib.robot.model import motor_qpos, neutral_pose
from cassie_lib.robot.schema import PERIOD, mirror_action
from cassie_lib.simulator import Simulator

WALK = gait.walk(0.05)
HALF = PERIOD // 2


def test_load_moves_from_foot_to_foot_without_a_jump():
    share = load_share(WALK.in_contact)
    np.testing.assert_array_equal(share[~WALK.in_contact[:, 0]], 0.0)
    np.testing.assert_array_equal(share[~WALK.in_contact[:, 1]], 1.0)
    np.testing.assert_allclose(share, 1.0 - np.roll(share, HALF), atol=1e-12)
    assert np.abs(np.diff(share, append=share[0])).max() <= 0.25
    np.testing.assert_array_equal(load_share(gait.hop().in_contact), 0.5)


def test_mirrored_half_cycle_is_the_same_walk():
    # Targets, because the published neutral pose rolls both hips to the same side.
    target = feedforward_cycle(WALK) + neutral_pose()
    mirrored = mirror_action(np.roll(target, HALF, axis=0))
    # The trunk's published centre of mass is 0.3 mm off the midline.
    np.testing.assert_allclose(mirrored, target, atol=1e-3)


def played_back(reference, cycle, start, steps):
    """Mean error of the motors' angles (rad) of a robot that plays a cycle open loop."""
    simulator = Simulator(1, timestep_s=0.002)
    simulator.reset(qpos=reference.qpos[start], qvel=reference.qvel[start])
    errors = []
    for step in range(start, start + steps):
        simulator.step(cycle[None, step % PERIOD])
        wanted = reference.qpos[(step + 1) % PERIOD, motor_qpos()]
        errors.append(np.abs(simulator.qpos[0, motor_qpos()] - wanted))
    return np.mean(errors)


@pytest.mark.parametrize("start", [0, 7, 14, 21])
def test_drives_follow_the_gait_under_its_weight(start):
    """Over the first third of a cycle, before an uncontrolled robot tips over."""
    bare = played_back(WALK, reference_cycle(WALK), start, 10)
    carried = played_back(WALK, feedforward_cycle(WALK), start, 10)
    assert carried < 0.06 < bare
    assert carried < 0.5 * bare
