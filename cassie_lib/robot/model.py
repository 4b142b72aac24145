"""The compiled MuJoCo model of Cassie, its addresses, and its neutral standing configuration."""

from __future__ import annotations

import functools
import json

import mujoco
import numpy as np

from cassie_lib import paths
from cassie_lib.errors import ParameterError
from cassie_lib.robot.schema import CONTROL_PERIOD_S, JOINT_NAMES, MOTOR_NAMES

#: Height of the floor's surface in the world frame (m).
FLOOR_HEIGHT_M = -0.01
#: Radius of the foot capsules (m); a sole touches when a foot site is this far above the floor.
FOOT_RADIUS_M = 0.02
#: Full physics state: time, 35 positions, 32 velocities.
PHYSICS_SIZE = 68
_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS


@functools.cache
def parameters() -> dict:
    """Published parameters of the robot, as read from ``cassie_parameters.json``."""
    return json.loads(paths.ROBOT_PARAMETERS.read_text())


def load_model(timestep_s: float = 0.0005) -> mujoco.MjModel:
    """Compile ``cassie.xml``.

    Args:
        timestep_s: Physics step in s; the control period of 0.03 s must be a multiple of it.

    Returns:
        A new model, free to be changed by the caller.

    Raises:
        ParameterError: If the step is not positive or does not divide the control period.
    """
    substeps(timestep_s)
    model = mujoco.MjModel.from_xml_path(str(paths.ROBOT_XML))
    model.opt.timestep = timestep_s
    return model


def substeps(timestep_s: float) -> int:
    """Physics steps per control step: 60 at the 0.5 ms of the thesis.

    Raises:
        ParameterError: If the step is not positive or does not divide the control period.
    """
    count = round(CONTROL_PERIOD_S / timestep_s) if timestep_s > 0 else 0
    if count < 1 or abs(count * timestep_s - CONTROL_PERIOD_S) > 1e-9:
        raise ParameterError(
            f"timestep_s = {timestep_s}: expected a positive divisor of {CONTROL_PERIOD_S} s"
        )
    return count


@functools.cache
def _addresses() -> dict[str, np.ndarray]:
    model = load_model()
    positions = {
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j): model.jnt_qposadr[j]
        for j in range(model.njnt)
    }
    velocities = {
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j): model.jnt_dofadr[j]
        for j in range(model.njnt)
    }
    return {
        "motor_qpos": np.array([positions[name] for name in MOTOR_NAMES]),
        "motor_qvel": np.array([velocities[name] for name in MOTOR_NAMES]),
        "joint_qpos": np.array([positions[name] for name in JOINT_NAMES]),
        "joint_qvel": np.array([velocities[name] for name in JOINT_NAMES]),
    }


def motor_qpos() -> np.ndarray:
    """Addresses of the 10 motor positions in qpos."""
    return _addresses()["motor_qpos"]


def motor_qvel() -> np.ndarray:
    """Addresses of the 10 motor velocities in qvel."""
    return _addresses()["motor_qvel"]


def joint_qpos() -> np.ndarray:
    """Addresses of the 6 measured, undriven joint positions in qpos."""
    return _addresses()["joint_qpos"]


def joint_qvel() -> np.ndarray:
    """Addresses of the 6 measured, undriven joint velocities in qvel."""
    return _addresses()["joint_qvel"]


def neutral_pose() -> np.ndarray:
    """Offset of the PD targets, ``(10,)`` rad: target = action + neutral pose."""
    return np.array(parameters()["control"]["neutral_pose_rad"])


def torque_limit() -> np.ndarray:
    """Torque limits at the driven joints, ``(10,)`` N m."""
    return np.array([item["joint_torque_limit_Nm"] for item in parameters()["actuators"]])


def gains() -> tuple[np.ndarray, np.ndarray]:
    """Proportional (N m/rad) and derivative (N m s/rad) gains, each ``(10,)``."""
    control = parameters()["control"]
    return np.array(control["kp_Nm_per_rad"]), np.array(control["kd_Nms_per_rad"])


def nominal_qpos() -> np.ndarray:
    """Published standing configuration, ``(35,)``, as published: loops closed to about 6 mm."""
    return np.array(parameters()["nominal_configuration"]["qpos"], dtype=float)


def physics_state(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Pack configurations into MuJoCo's full physics state.

    Args:
        model: The compiled model.
        qpos: ``(N, 35)``, m and rad.
        qvel: ``(N, 32)``, m/s and rad/s.

    Returns:
        ``(N, 68)``: time (0 s), positions, velocities.
    """
    state = np.zeros((len(qpos), mujoco.mj_stateSize(model, _FULL)))
    state[:, 1 : 1 + model.nq] = qpos
    state[:, 1 + model.nq : 1 + model.nq + model.nv] = qvel
    return state
