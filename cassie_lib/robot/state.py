"""From MuJoCo's configuration to the 49 components of Table 4.1, batched, and back."""

from __future__ import annotations

import numpy as np

from cassie_lib.errors import NonFiniteError, ShapeError
from cassie_lib.robot import model as robot
from cassie_lib.robot import schema
from cassie_lib.robot.kinematics import LegKinematics, standing_qpos


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


def configuration_from_state(states, start_xy=(0.0, 0.0), gap_m: float = 0.05) -> np.ndarray:
    """Configurations along a sequence of states, true or predicted: the inverse of extraction.

    Height, orientation, motors, shins, tarsi and feet are in the state.  Pelvis x and y are
    integrated from its velocity (trapezoids).  Rods, heel springs and cranks follow from closing
    the loops.  The foot joints are both driven and measured, so they are in the state twice; the
    driven one counts.

    Args:
        states: ``(T, 49)`` consecutive control steps.
        start_xy: Pelvis x and y at the first state, m, world.
        gap_m: Largest loop gap that may remain when a predicted state is no possible one, m.

    Returns:
        ``(T, 35)`` qpos.

    Raises:
        ShapeError: If ``states`` is not ``(T, 49)``.
        NonFiniteError: If it holds NaN or infinity.
        ParameterError: If the loops cannot be closed to ``gap_m``.
    """
    states = np.asarray(states, dtype=float)
    if states.ndim != 2 or states.shape[1] != schema.STATE_SIZE:
        raise ShapeError(f"states have shape {states.shape}: expected (T, {schema.STATE_SIZE})")
    if not np.isfinite(states).all():
        raise NonFiniteError("states hold NaN or infinity: expected finite values")
    velocity = states[:, schema.PELVIS_VELOCITY][:, :2]
    moves = schema.CONTROL_PERIOD_S * (velocity[1:] + velocity[:-1]) / 2
    qpos = np.tile(standing_qpos(), (len(states), 1))
    qpos[:, :2] = np.asarray(start_xy) + np.vstack([np.zeros(2), np.cumsum(moves, axis=0)])
    qpos[:, 2:3] = states[:, schema.PELVIS_HEIGHT]
    orientation = states[:, schema.PELVIS_ORIENTATION]
    qpos[:, 3:7] = orientation / np.linalg.norm(orientation, axis=1, keepdims=True)
    qpos[:, robot.joint_qpos()] = states[:, schema.JOINT_POSITION]
    qpos[:, robot.motor_qpos()] = states[:, schema.MOTOR_POSITION]
    legs, guess = LegKinematics(), qpos[0]
    known = np.r_[0:7, robot.joint_qpos(), robot.motor_qpos()]
    for row in qpos:
        # The neighbour's rods are the best guess: they turn little in one control step.
        guess = guess.copy()
        guess[known] = row[known]
        row[:] = guess = legs.complete(guess, gap_m)
    return qpos
