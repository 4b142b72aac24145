"""The batched simulator against a plain loop over ``mujoco.mj_step``: the same bits.

Stored results stay valid across a faster version of cassie_lib/simulator.py because both versions
pass these tests (cassie_lib/artifacts/equal_code.py names the versions).
"""

import mujoco
import numpy as np
import pytest

from cassie_lib import gait
from cassie_lib.errors import ShapeError
from cassie_lib.robot import model as robot
from cassie_lib.robot.schema import GRAVITY, PERIOD
from cassie_lib.simulator import UPRIGHT_M, Simulator

FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
FORCES, ACCELERATION = slice(15, 21), slice(31, 34)
ROBOTS = 9


class PlainLoop:
    """One robot after the other, one physics step after the other, everything allocated anew."""

    def __init__(self, simulator: Simulator, models: list[mujoco.MjModel]) -> None:
        self.models, self.substeps = models, robot.substeps(simulator.timestep_s)
        self.physics = simulator.physics.copy()
        self.force = simulator.foot_force
        self.fallen = simulator.fallen.copy()
        self.acceleration = simulator.states[:, ACCELERATION].copy()
        self.push, self.pushed = np.zeros((len(models), 3)), np.zeros(len(models), dtype=int)

    def step(self, actions: np.ndarray) -> None:
        for i in np.flatnonzero(~self.fallen):
            self._advance(i, actions[i])
        self.pushed = np.maximum(self.pushed - 1, 0)

    def _advance(self, i: int, action: np.ndarray) -> None:
        model, forces = self.models[i], []
        data = mujoco.MjData(model)
        mujoco.mj_setState(model, data, self.physics[i], FULL)
        data.ctrl[:] = action
        if self.pushed[i]:
            data.xfrc_applied[1, :3] = self.push[i]
        for _ in range(self.substeps):
            mujoco.mj_step(model, data)
            forces.append(data.sensordata[FORCES].copy())
        physics = np.empty(robot.PHYSICS_SIZE)
        mujoco.mj_getState(model, data, physics, FULL)
        if not np.isfinite(physics).all() or np.abs(physics[36:]).max() >= 1e3:
            self.fallen[i] = True
            return
        self.physics[i], self.force[i] = physics, np.mean(forces, axis=0).reshape(2, 3)
        self.acceleration[i] = data.sensordata[:3] - [0.0, 0.0, GRAVITY]
        self.fallen[i] = not UPRIGHT_M[0] < physics[3] < UPRIGHT_M[1]


def _models(timestep_s: float, masses) -> list[mujoco.MjModel]:
    models = []
    for factor in masses:
        model = robot.load_model(timestep_s)
        model.body_mass[1] *= factor
        mujoco.mj_setConst(model, mujoco.MjData(model))
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        models.append(model)
    return models


def _start(timestep_s: float, threads: int, masses=(1.0,) * ROBOTS):
    models = _models(timestep_s, masses)
    simulator = Simulator(ROBOTS, timestep_s, threads, models)
    reference = gait.walk(0.5)
    phase = (3 * np.arange(ROBOTS)) % PERIOD
    simulator.reset(qpos=reference.qpos[phase], qvel=reference.qvel[phase], phase=phase)
    return simulator, PlainLoop(simulator, models), reference


def _assert_same_bits(simulator: Simulator, plain: PlainLoop) -> None:
    assert np.array_equal(simulator.physics, plain.physics)
    assert np.array_equal(simulator.foot_force, plain.force)
    assert np.array_equal(simulator.fallen, plain.fallen)
    assert np.array_equal(simulator.states[:, ACCELERATION], plain.acceleration)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("timestep_s", [0.0005, 0.002])
def test_playback_with_noise_until_most_have_fallen(timestep_s, threads):
    simulator, plain, reference = _start(timestep_s, threads)
    rng, fallen = np.random.default_rng(0), set()
    for _ in range(45):
        motors = reference.motor_position[(simulator.phase + 1) % PERIOD]
        actions = motors - robot.neutral_pose() + rng.normal(scale=0.2, size=(ROBOTS, 10))
        simulator.step(actions)
        plain.step(actions)
        _assert_same_bits(simulator, plain)
        fallen.add(int(simulator.fallen.sum()))
    # Whole batches, parts of it and, at the end, mostly robots that no longer move.
    assert len(fallen) > 3
    assert max(fallen) > ROBOTS / 2


def test_pushes_on_some_of_the_robots():
    simulator, plain, _ = _start(0.0005, 2)
    simulator.push([30.0, 0.0, 5.0], steps=3, indices=[1, 4])
    simulator.push([0.0, -20.0, 0.0], steps=1, indices=[7])
    plain.push[[1, 4]], plain.pushed[[1, 4]] = np.array([30.0, 0.0, 5.0]) / (3 * 60 * 0.0005), 3
    plain.push[7], plain.pushed[7] = np.array([0.0, -20.0, 0.0]) / (60 * 0.0005), 1
    for _ in range(5):
        simulator.step(np.zeros((ROBOTS, 10)))
        plain.step(np.zeros((ROBOTS, 10)))
        _assert_same_bits(simulator, plain)


def test_a_model_of_its_own_for_each_robot():
    simulator, plain, _ = _start(0.002, 2, np.linspace(0.8, 1.2, ROBOTS))
    for _ in range(8):
        simulator.step(np.full((ROBOTS, 10), 0.1))
        plain.step(np.full((ROBOTS, 10), 0.1))
        _assert_same_bits(simulator, plain)
    assert len(np.unique(simulator.qpos[:, 2])) == ROBOTS


def test_some_robots_reset_in_the_middle():
    simulator, plain, reference = _start(0.002, 2)
    for step in range(6):
        if step == 3:
            simulator.reset([0, 5], qpos=reference.qpos[0], qvel=reference.qvel[0], phase=0)
            plain.physics[[0, 5]] = simulator.physics[[0, 5]]
            plain.force[[0, 5]] = simulator.foot_force[[0, 5]]
        simulator.step(np.zeros((ROBOTS, 10)))
        plain.step(np.zeros((ROBOTS, 10)))
        _assert_same_bits(simulator, plain)


def test_one_robot_diverges_and_the_others_do_not_notice():
    simulator, plain, _ = _start(0.002, 2)
    for side in (simulator, plain):
        side.physics[3, 36 + 10] = 1e9
    with pytest.warns(RuntimeWarning, match=r"diverged for robot\(s\) \[3\]"):
        simulator.step(np.zeros((ROBOTS, 10)))
    plain.step(np.zeros((ROBOTS, 10)))
    _assert_same_bits(simulator, plain)
    assert simulator.fallen[3]


def test_models_of_other_sizes_are_refused():
    other = mujoco.MjModel.from_xml_string("<mujoco><worldbody/></mujoco>")
    with pytest.raises(ShapeError, match=r"models\[1\] has nq = 0.*expected nq = 35"):
        Simulator(2, 0.002, models=[robot.load_model(0.002), other])
