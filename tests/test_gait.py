"""Reference gaits: closed loops, features, smoothness, symmetry; recorded trajectories."""

import numpy as np
import pytest

from cassie_lib import gait
from cassie_lib.errors import ParameterError, TrajectoryError, UnknownNameError
from cassie_lib.recorded_gait import load_stepdata
from cassie_lib.robot import model as robot
from cassie_lib.robot.kinematics import LegKinematics
from cassie_lib.robot.schema import PERIOD, mirror_action

CASES = [("walk", 0.0), ("walk", 0.0509), ("walk", 1.0), ("hop", 0.0), ("hop", 0.4)]


@pytest.mark.parametrize(("name", "speed"), CASES)
def test_loops_are_closed_and_springs_at_rest(name, speed):
    reference, kinematics = gait.get_gait(name, speed), LegKinematics()
    for qpos in reference.qpos[::3]:
        assert np.abs(kinematics.loop_error(qpos)).max() < 1e-9
    springs = [kinematics.model.joint(f"{side}-{part}").qposadr[0]
               for side in ("left", "right") for part in ("shin", "heel-spring")]  # fmt: skip
    assert not reference.qpos[:, springs].any()
    limits = kinematics.model.jnt_range[
        [kinematics.model.joint(n).id for n in robot.parameters()["control"]["motor_order"]]
    ]
    assert (reference.motor_position > limits[:, 0]).all()
    assert (reference.motor_position < limits[:, 1]).all()


def test_published_features_of_the_recorded_gait():
    reference = gait.walk(0.0509)
    assert pytest.approx(0.84) == PERIOD * 0.03
    assert reference.foot_height_m.max(axis=0) == pytest.approx([0.11, 0.11], abs=0.002)
    assert ((reference.qpos[:, 2] > 1.02 - 1e-9) & (reference.qpos[:, 2] < 1.05)).all()
    assert np.abs(reference.qpos[:, 1]).max() == pytest.approx(0.026, abs=1e-3)
    # Of 28 samples 11 or 12 are in swing: 42 % of the cycle.
    assert reference.in_contact.mean() == pytest.approx(0.58, abs=0.04)
    assert reference.in_contact.any(axis=1).all()


@pytest.mark.parametrize(("name", "speed"), CASES)
def test_velocity_is_smooth_and_belongs_to_the_positions(name, speed):
    reference = gait.get_gait(name, speed)
    change = np.abs(np.diff(np.vstack([reference.qvel, reference.qvel[:1]]), axis=0)).max()
    assert change < 0.25 * 30.0  # rad/s a step: less than 250 rad/s^2
    mean = (np.roll(reference.motor_position, -1, 0) - reference.motor_position) / 0.03
    middle = (reference.qvel + np.roll(reference.qvel, -1, 0))[:, robot.motor_qvel()] / 2
    assert np.abs(mean - middle).max() < 1.0


def test_pelvis_advances_at_the_commanded_speed():
    reference = gait.walk(0.7)
    advance = np.diff(reference.qpos[:, 0]) / 0.03
    np.testing.assert_allclose(advance, 0.7, atol=1e-9)
    np.testing.assert_allclose(reference.qvel[:, 0], 0.7, atol=1e-9)


def test_second_half_of_the_cycle_mirrors_the_first():
    reference = gait.walk(0.3)
    # Differences of joint angles: the neutral poses of the two hips differ in sign conventions.
    angles = reference.motor_position
    np.testing.assert_allclose(np.roll(angles, -14, axis=0), mirror_action(angles), atol=1e-6)


def test_hop_leaves_the_ground_with_both_feet_and_flies_ballistically():
    reference = gait.hop()
    flying = ~reference.in_contact
    assert (flying[:, 0] == flying[:, 1]).all()
    assert 4 <= flying[:, 0].sum() <= 7
    air = np.flatnonzero(flying[:, 0])
    curvature = np.diff(reference.qpos[air, 2], 2) / 0.03**2
    np.testing.assert_allclose(curvature, -9.81, atol=0.05)


def test_bad_names_and_speeds():
    with pytest.raises(UnknownNameError, match="'trot': expected one of hop, step-in-place, walk"):
        gait.get_gait("trot")
    with pytest.raises(ParameterError, match="speed_mps = 1.5: expected 0 to 1"):
        gait.walk(1.5)
    with pytest.raises(ParameterError, match="speed_mps = -0.1"):
        gait.hop(-0.1)
    with pytest.raises(ParameterError):
        gait.walk(float("nan"))


def _rows(count=1680):
    """A recording of the reference itself, at 2 kHz."""
    reference = gait.walk(0.5)
    rows = np.zeros((count, 98))
    rows[:, 0] = np.arange(count) * 0.0005
    index = np.minimum(np.arange(count) // 60, PERIOD - 1)
    rows[:, 1:36], rows[:, 36:68] = reference.qpos[index], reference.qvel[index]
    # Between two samples the hips move on: whoever samples late or early reads other angles.
    rows[:, [8, 9, 10]] += 1e-3 * (np.arange(count) % 60)[:, None]
    return rows


@pytest.mark.parametrize("count", [1680, 1681])
def test_recorded_trajectory_round_trip(tmp_path, count):
    path = tmp_path / "stepdata.bin"
    _rows(count).astype("<f8").tofile(path)
    loaded, reference = load_stepdata(path), gait.walk(0.5)
    np.testing.assert_array_equal(loaded.motor_position, reference.motor_position)
    np.testing.assert_allclose(loaded.foot_height_m, reference.foot_height_m, atol=1e-3)
    assert loaded.speed_mps == pytest.approx(0.5, abs=0.03)


def _changed(column, value):
    rows = _rows()
    rows[100, column] = value
    return rows


@pytest.mark.parametrize(("rows", "text"), [
    (np.zeros((1680, 97)), "rows of 98"),
    (np.zeros((0, 98)), "0 bytes"),
    (np.zeros((1000, 98)), "1000 rows: expected 1680"),
    (_changed(5, np.nan), "not finite"),
    (_changed(0, 9.0), "time steps"),
    (_changed(4, 2.0), "quaternion of the pelvis of length 2"),
    (_changed(slice(11, 15), 0.0), "quaternion of the left achilles rod of length 0"),
    (_changed(slice(25, 29), 0.0), "quaternion of the right achilles rod of length 0"),
])  # fmt: skip
def test_wrong_recordings_are_refused(tmp_path, rows, text):
    path = tmp_path / "wrong.bin"
    rows.tofile(path)
    with pytest.raises(TrajectoryError, match=text):
        load_stepdata(path)


def test_missing_recording(tmp_path):
    with pytest.raises(TrajectoryError, match="cannot be read"):
        load_stepdata(tmp_path / "nothing.bin")
