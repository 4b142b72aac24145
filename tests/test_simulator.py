"""Batched simulation: determinism, mirror symmetry, pushes, divergence, bad input."""

import copy

import mujoco
import numpy as np
import pytest

from cassie_lib import gait
from cassie_lib.errors import NonFiniteError, ParameterError, ShapeError
from cassie_lib.physics_checks import compare_timesteps
from cassie_lib.robot import model as robot
from cassie_lib.robot import schema
from cassie_lib.robot.mjcf import build_mjcf
from cassie_lib.simulator import Simulator

COARSE = 0.002


def _actions(count, steps, seed=0, scale=0.1):
    return np.random.default_rng(seed).normal(0.0, scale, (steps, count, 10))


def test_s0_is_that_of_appendix_a3():
    state = Simulator(1).states[0]
    np.testing.assert_allclose(state[schema.PELVIS_ORIENTATION], [1, 0, 0, 0])
    np.testing.assert_allclose(
        state[schema.MOTOR_POSITION],
        [4.4792e-3, 0, 0.4973, -1.1997, -1.5968, -4.4792e-3, 0, 0.4973, -1.1997, -1.5968],
        atol=5e-5,
    )
    np.testing.assert_allclose(state[schema.PELVIS_VELOCITY], 0.0, atol=5e-4)
    assert not state[schema.MOTOR_VELOCITY].any()
    assert not state[schema.JOINT_VELOCITY].any()
    # Free fall at the first sample: a coordinate acceleration, not an accelerometer's reading.
    np.testing.assert_allclose(state[schema.PELVIS_ACCELERATION], [-0.078, 0.0, -9.8094], atol=0.12)
    # Closing the loops moves the tarsi by 0.006 rad from the published 1.4267.
    np.testing.assert_allclose(
        state[schema.JOINT_POSITION], [0, 1.4267, -1.5961, 0, 1.4267, -1.5961], atol=6e-3
    )
    np.testing.assert_allclose(state[schema.CLOCK], [-0.11609, -0.99324], atol=1e-5)
    assert state[schema.SPEED] == 0.0509


def test_first_steps_are_a_free_fall():
    simulator = Simulator(1)
    before = simulator.pelvis_position[0, 2]
    trajectory, _ = simulator._rollout(np.array([0]), np.zeros((1, 10)), 20)
    fallen = before - trajectory[0, :, 3]
    steps = np.arange(1, 21)  # semi-implicit Euler: the velocity is updated first
    np.testing.assert_allclose(fallen, 9.81 * 0.0005**2 * steps * (steps + 1) / 2, rtol=0.01)


@pytest.mark.parametrize("threads", [1, 2])
def test_same_bits_whatever_the_threads_and_the_company(threads):
    actions = _actions(4, 20)
    reference = Simulator(4, COARSE, threads=2)
    alone = Simulator(1, COARSE, threads=1)
    other = Simulator(4, COARSE, threads=threads)
    for action in actions:
        reference.step(action)
        other.step(action)
        alone.step(action[2:3])
    assert np.array_equal(reference.physics, other.physics)
    assert np.array_equal(reference.physics[2:3], alone.physics)


def test_snapshot_restores_the_future():
    simulator = Simulator(3, COARSE)
    actions = _actions(3, 12, seed=3)
    for action in actions[:6]:
        simulator.step(action)
    kept = simulator.snapshot()
    for action in actions[6:]:
        simulator.step(action)
    first = simulator.states
    simulator.restore(kept)
    for action in actions[6:]:
        simulator.step(action)
    assert np.array_equal(first, simulator.states)
    with pytest.raises(ShapeError, match="3 robots: expected 2"):
        Simulator(2, COARSE).restore(kept)


def _symmetric_model():
    """The robot without the published asymmetries: pelvis, a hip's centre of mass, neutral pose."""
    parameters = copy.deepcopy(robot.parameters())
    bodies = {body["body"]: body for body in parameters["bodies"]}
    bodies["cassie-pelvis"]["com_m"][1] = 0.0
    inertia = "inertia_kg_m2_xx_yy_zz_xy_xz_yz"
    bodies["cassie-pelvis"][inertia][3] = bodies["cassie-pelvis"][inertia][5] = 0.0
    bodies["right-hip-roll"]["com_m"][1] *= -1.0
    parameters["control"]["neutral_pose_rad"][5] *= -1.0
    return mujoco.MjModel.from_xml_string(build_mjcf(parameters))


def _mirror_configuration(qpos, qvel):
    """Reflect a configuration in the x-z plane."""
    swap = np.r_[21:35, 7:21]
    mirrored, velocity = qpos.copy(), qvel.copy()
    mirrored[7:] = qpos[swap]
    mirrored[1] *= -1
    mirrored[[4, 6]] *= -1
    for start in (7, 21):
        mirrored[[start, start + 1]] *= -1  # hip roll and yaw
        mirrored[[start + 4, start + 5]] *= -1  # rod: its frame is reflected in z
    velocity[6:] = qvel[np.r_[19:32, 6:19]]
    velocity[[1, 3, 5]] *= -1
    for start in (6, 19):
        velocity[[start, start + 1, start + 3, start + 4]] *= -1
    return mirrored, velocity


@pytest.mark.parametrize("phase", [0, 7, 19])
def test_mirrored_action_from_a_mirrored_state_gives_the_mirrored_next_state(phase):
    reference = gait.walk(0.4)
    qpos, qvel = reference.qpos[phase], reference.qvel[phase]
    mirrored, velocity = _mirror_configuration(qpos, qvel)
    simulator = Simulator(2, models=[_symmetric_model() for _ in range(2)])
    simulator.reset(
        qpos=np.stack([qpos, mirrored]),
        qvel=np.stack([qvel, velocity]),
        phase=np.array([phase, phase + 14]),
    )
    action = np.random.default_rng(phase).normal(0.0, 0.2, 10)
    simulator.step(np.stack([action, schema.mirror_action(action)]))
    first, second = simulator.states
    wanted = schema.mirror_state(first, phase=simulator.phase[0])
    # Accelerations at impact are stiff: compared relative to their size.
    scale = np.ones(49)
    scale[schema.PELVIS_ACCELERATION] = 1e2
    assert np.abs((second - wanted) / scale).max() < 1e-6


def test_standing_forces_carry_the_weight():
    simulator = Simulator(1)
    for _ in range(8):
        simulator.step(np.zeros((1, 10)))
    total = simulator.foot_force[0].sum(axis=0)
    acceleration = simulator.states[0, schema.PELVIS_ACCELERATION]
    assert total[2] > 0.5 * 33.312 * 9.81
    assert abs(acceleration[2]) < 9.81


def test_push_changes_the_momentum_by_its_impulse():
    simulator = Simulator(1)
    simulator.reset(qpos=_high(), qvel=np.zeros(32))
    simulator.push([0.0, 8.0, 0.0], steps=2)
    for _ in range(3):
        simulator.step(np.zeros((1, 10)))
    data = mujoco.MjData(simulator.model)
    data.qpos[:], data.qvel[:] = simulator.qpos[0], simulator.qvel[0]
    mujoco.mj_forward(simulator.model, data)
    mujoco.mj_subtreeVel(simulator.model, data)
    assert data.subtree_linvel[0, 1] * 33.312 == pytest.approx(8.0, rel=0.02)


def _high():
    from cassie_lib.robot.kinematics import standing_qpos

    qpos = np.array(standing_qpos())
    qpos[2] = 2.5
    return qpos


def test_fall_is_found_and_freezes_the_robot():
    simulator = Simulator(2, COARSE)
    for _ in range(80):
        simulator.step(np.zeros((2, 10)))
    assert simulator.fallen.all()
    assert (simulator.pelvis_position[:, 2] < 0.45).all()
    kept = simulator.physics.copy()
    simulator.step(np.zeros((2, 10)))
    assert np.array_equal(kept, simulator.physics)
    simulator.reset([1])
    assert simulator.fallen.tolist() == [True, False]


def test_diverged_physics_is_a_fall_with_a_warning():
    simulator = Simulator(2, COARSE)
    qvel = np.zeros((2, 32))
    qvel[0, 6:] = 1e6
    simulator.reset(qvel=qvel)
    with pytest.warns(RuntimeWarning, match=r"diverged for robot\(s\) \[0\]"):
        simulator.step(np.zeros((2, 10)))
    assert simulator.fallen.tolist() == [True, False]
    assert np.isfinite(simulator.states).all()


def test_coarse_and_fine_physics_agree_over_a_second():
    comparison = compare_timesteps()
    assert comparison.time_s[-1] > 0.98
    assert comparison.distance_m.max() < 0.01
    assert np.ptp(comparison.fine_m[:, 2]) > 0.05  # it moved


@pytest.mark.parametrize(
    ("actions", "error", "text"),
    [
        (np.zeros((1, 10)), ShapeError, r"\(1, 10\): expected \(2, 10\)"),
        (np.zeros((2, 9)), ShapeError, r"expected \(2, 10\)"),
        (np.full((2, 10), np.nan), NonFiniteError, r"action\[0, 0\] = nan"),
        (np.full((2, 10), np.inf), NonFiniteError, "finite angle"),
    ],
)
def test_bad_actions_are_refused_and_nothing_moves(actions, error, text):
    simulator = Simulator(2, COARSE)
    before = simulator.physics.copy()
    with pytest.raises(error, match=text):
        simulator.step(actions)
    assert np.array_equal(before, simulator.physics)
    assert (simulator.phase == 14).all()


def test_bad_settings_are_refused():
    with pytest.raises(ParameterError, match="count = 0"):
        Simulator(0)
    with pytest.raises(ParameterError, match="divisor"):
        Simulator(1, 0.0011)
    with pytest.raises(NonFiniteError):
        Simulator(1, COARSE).reset(qpos=np.full(35, np.nan))
    with pytest.raises(ParameterError, match="steps = 0"):
        Simulator(1, COARSE).push([1, 0, 0], steps=0)
    with pytest.raises(ShapeError, match="one per robot"):
        Simulator(2, COARSE, models=[robot.load_model()])
