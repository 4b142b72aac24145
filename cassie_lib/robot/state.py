"""From MuJoCo's configuration to the 49 components of Table 4.1, batched."""

from __future__ import annotations

import numpy as np

from cassie_lib.robot import model as robot
from cassie_lib.robot import schema


def extract_state(qpos, qvel, acceleration, phase, speed) -> np.ndarray:
    """Assemble states.

    Args:
        qpos: ``(N, 35)`` positions, m and rad.
        qvel: ``(N, 32)`` velocities; linear ones in the world frame, angular in the body frame.
        acceleration: ``(N, 3)`` coordinate acceleration of the pelvis in the world frame, m/s^2:
            -9.81 in z in free fall, unlike an accelerometer's reading.
        phase: ``(N,)`` integer phase of the clock.
        speed: ``(N,)`` commanded forward speed, m/s.

    Returns:
        ``(N, 49)`` states.
    """
    state = np.empty((len(qpos), schema.STATE_SIZE))
    state[:, schema.PELVIS_HEIGHT] = qpos[:, 2:3]
    # q and -q are the same rotation; the non-negative scalar part keeps the signal continuous.
    state[:, schema.PELVIS_ORIENTATION] = qpos[:, 3:7] * np.where(qpos[:, 3:4] < 0.0, -1.0, 1.0)
    state[:, schema.MOTOR_POSITION] = qpos[:, robot.motor_qpos()]
    state[:, schema.PELVIS_VELOCITY] = qvel[:, 0:3]
    state[:, schema.PELVIS_ANGULAR_VELOCITY] = qvel[:, 3:6]
    state[:, schema.MOTOR_VELOCITY] = qvel[:, robot.motor_qvel()]
    state[:, schema.PELVIS_ACCELERATION] = acceleration
    state[:, schema.JOINT_POSITION] = qpos[:, robot.joint_qpos()]
    state[:, schema.JOINT_VELOCITY] = qvel[:, robot.joint_qvel()]
    state[:, schema.CLOCK] = schema.clock(phase)
    state[:, schema.SPEED] = np.asarray(speed)[:, None]
    return state
