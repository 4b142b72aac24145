"""From a state back to a configuration: what the state leaves out follows from loops and time."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from cassie_lib.errors import NonFiniteError, ParameterError, ShapeError
from cassie_lib.robot import model as robot
from cassie_lib.robot import schema
from cassie_lib.robot.kinematics import LegKinematics, standing_qpos
from cassie_lib.robot.state import configuration_from_state, extract_state
from cassie_lib.simulator import Simulator


@pytest.fixture(scope="module")
def motion():
    """States and configurations over a third of a second of noisy standing."""
    simulator = Simulator(1)
    random = np.random.default_rng(3)
    states, qpos = [simulator.states[0]], [simulator.physics[0, 1:36].copy()]
    for _ in range(10):
        simulator.step(0.1 * random.normal(size=(1, 10)))
        states.append(simulator.states[0].copy())
        qpos.append(simulator.physics[0, 1:36].copy())
    return np.array(states), np.array(qpos)


def body_positions(qpos):
    model = robot.load_model()
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data.xpos.copy()


def test_every_body_is_where_it_was_in_the_simulation(motion):
    states, qpos = motion
    found = configuration_from_state(states, qpos[0, :2])
    assert np.abs(found[:, 2:7] - qpos[:, 2:7]).max() < 1e-6
    for one, other in zip(found, qpos, strict=True):
        other = np.concatenate([one[:2], other[2:]])
        # MuJoCo's loop closures are soft: they give way by less than a millimetre.
        assert np.abs(body_positions(one) - body_positions(other)).max() < 2e-3


def test_it_is_the_inverse_of_extraction(motion):
    states, _ = motion
    found = configuration_from_state(states)
    again = extract_state(
        found, np.zeros((len(found), 32)), np.zeros((len(found), 3)), np.zeros(len(found)),
        np.zeros(len(found)),
    )  # fmt: skip
    positions = schema.DERIVATIVE_ORDER[: schema.PHYSICAL.stop] == 0
    assert np.abs(again - states)[:, :46][:, positions].max() < 1e-6


def test_pelvis_path_is_the_integral_of_its_velocity(motion):
    states, qpos = motion
    steady = np.repeat(states[:1], 5, axis=0)
    steady[:, schema.PELVIS_VELOCITY] = (1.0, -0.5, 0.0)
    found = configuration_from_state(steady, (2.0, 3.0))
    assert found[4, :2] == pytest.approx([2.0 + 4 * 0.03, 3.0 - 4 * 0.015])
    moved = configuration_from_state(states, qpos[0, :2])
    assert np.abs(moved[:, :2] - qpos[:, :2]).max() < 5e-3


def test_loops_close_with_loaded_springs_and_nothing_known_moves():
    legs, qpos = LegKinematics(), np.array(standing_qpos())
    shin = robot.load_model().joint("left-shin").qposadr[0]
    qpos[shin] = 0.05
    closed = legs.complete(qpos)
    assert np.abs(legs.loop_error(qpos)).max() > 1e-3
    assert np.abs(legs.loop_error(closed)).max() < 1e-9
    known = np.r_[0:7, robot.joint_qpos(), robot.motor_qpos()]
    assert np.array_equal(closed[known], qpos[known])


def test_an_impossible_state_is_drawn_as_well_as_it_can_be_or_refused(motion):
    state = motion[0][:1].copy()
    state[0, schema.JOINT_POSITION.start] -= 3.0  # the left shin, turned right round
    with pytest.raises(ParameterError, match="m from its targets"):
        configuration_from_state(state, gap_m=1e-6)
    assert np.isfinite(configuration_from_state(state, gap_m=1.0)).all()


def test_bad_input_is_named(motion):
    states = motion[0].copy()
    with pytest.raises(ShapeError, match=r"expected \(T, 49\)"):
        configuration_from_state(states[0])
    states[2, 5] = np.nan
    with pytest.raises(NonFiniteError):
        configuration_from_state(states)
