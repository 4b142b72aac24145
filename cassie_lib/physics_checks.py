"""Experiments on the physics itself: step responses of the PD drive, coarse against fine steps."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from cassie_lib import gait
from cassie_lib.errors import ParameterError
from cassie_lib.robot import model as robot
from cassie_lib.robot.kinematics import standing_qpos
from cassie_lib.robot.schema import ACTION_SIZE, mirror_action
from cassie_lib.simulator import Simulator

_STEP_AT_S = 0.05


@dataclass(frozen=True)
class StepResponse:
    """Step responses of the ten motors, one motor at a time.

    Attributes:
        time_s: ``(T,)``.
        target_rad: Target of the motor that is stepped, ``(10, T)``, relative to the neutral pose.
        position_rad: Its position, ``(10, T)``, relative to the neutral pose.
        torque_Nm: Its torque at the joint, ``(10, T)``.
        limit_Nm: Torque limits, ``(10,)``.
    """

    time_s: np.ndarray
    target_rad: np.ndarray
    position_rad: np.ndarray
    torque_Nm: np.ndarray
    limit_Nm: np.ndarray


def pd_step_response(step_rad: float = 0.2, duration_s: float = 0.8) -> StepResponse:
    """Step each motor's target on a test stand: pelvis held, feet off the floor, no gravity.

    Args:
        step_rad: Size of the step; right roll and yaw go the other way.
        duration_s: Length of each response.

    Raises:
        ParameterError: If the duration is not longer than the 0.05 s before the step.
    """
    if duration_s <= _STEP_AT_S:
        raise ParameterError(f"duration_s = {duration_s}: expected more than {_STEP_AT_S} s")
    model = robot.load_model()
    model.opt.gravity[:] = 0.0
    # A pelvis of a thousand tonnes stands still, whatever the legs do.
    model.body_mass[1], model.body_inertia[1] = 1e6, 1e6
    count = round(duration_s / model.opt.timestep)
    time = np.arange(count) * model.opt.timestep
    # Mirrored, so that both legs turn outward and do not meet.
    steps = np.full(ACTION_SIZE, step_rad)
    steps[5:] = mirror_action(steps)[5:]
    target, position, torque = (np.zeros((ACTION_SIZE, count)) for _ in range(3))
    for motor in range(ACTION_SIZE):
        data = mujoco.MjData(model)
        data.qpos[:] = standing_qpos()
        data.qpos[2] = 5.0
        for row in range(count):
            data.ctrl[motor] = steps[motor] * (time[row] >= _STEP_AT_S)
            mujoco.mj_step(model, data)
            target[motor, row] = data.ctrl[motor]
            position[motor, row] = data.qpos[robot.motor_qpos()[motor]]
            torque[motor, row] = data.actuator_force[motor]
    return StepResponse(
        time, target, position - robot.neutral_pose()[:, None], torque, robot.torque_limit()
    )


@dataclass(frozen=True)
class TimestepComparison:
    """The same motion at coarse and fine physics.

    Attributes:
        time_s: ``(T,)``.
        fine_m: Pelvis path at 0.5 ms, ``(T, 3)``.
        coarse_m: Pelvis path at 2 ms, ``(T, 3)``.
    """

    time_s: np.ndarray
    fine_m: np.ndarray
    coarse_m: np.ndarray

    @property
    def distance_m(self) -> np.ndarray:
        """How far the two paths are apart, ``(T,)``."""
        return np.linalg.norm(self.fine_m - self.coarse_m, axis=1)


def compare_timesteps(
    fine_s: float = 0.0005, coarse_s: float = 0.002, steps: int = 33
) -> TimestepComparison:
    """Play the reference gait's angles open loop from s0 for about a second at both steps.

    Nothing corrects the robot, so every difference of the physics adds up.

    Args:
        fine_s: Fine physics step.
        coarse_s: Coarse physics step.
        steps: Control steps of 0.03 s.
    """
    cycle = gait.step_in_place().motor_position - robot.neutral_pose()
    paths = []
    for timestep_s in (fine_s, coarse_s):
        simulator = Simulator(1, timestep_s)
        path = [simulator.pelvis_position[0]]
        for _ in range(steps):
            simulator.step(cycle[(simulator.phase + 1) % len(cycle)])
            path.append(simulator.pelvis_position[0])
        paths.append(np.array(path))
    return TimestepComparison(0.03 * np.arange(steps + 1), *paths)
