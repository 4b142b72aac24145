"""The thesis's reward, Eq 3.10, once for NumPy arrays and torch tensors, term by term.

The text lists the weights; the constants are those of the reward that it re-uses (RSS 2020).
A robot that stands still at 0.0509 m/s scores about 0.9: the reward alone proves no walking.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cassie_lib.errors import ShapeError
from cassie_lib.robot.schema import (
    JOINT_POSITION,
    MOTOR_POSITION,
    PELVIS_ORIENTATION,
    PELVIS_VELOCITY,
    SPEED,
    STATE_SIZE,
)

#: Weights of Eq 3.10; they sum to one.
WEIGHTS = {
    "orientation": 0.3,
    "motor": 0.2,
    "forward_velocity": 0.2,
    "lateral_velocity": 0.2,
    "lateral_position": 0.05,
    "spring": 0.05,
}
#: Errors of velocity (m/s) and position (m) that count as none.
DEADBAND = {"forward_velocity": 0.05, "lateral_velocity": 0.03, "lateral_position": 0.05}
_MOTOR_WEIGHTS = (0.15, 0.15, 0.10, 0.05, 0.05) * 2
_SHIN = (0, 3)


class ReferencePose(NamedTuple):
    """What Eq 3.10 compares with, at the phases of the states.

    Attributes:
        motor_position: Driven joints, ``(..., 10)`` rad.
        joint_position: Measured, undriven joints, ``(..., 6)`` rad.
    """

    motor_position: object
    joint_position: object


def _exp(values):
    return values.exp() if hasattr(values, "exp") else np.exp(values)


def _outside(error, name: str, deadband: bool):
    """Absolute error, zero inside the deadband (where its gradient is zero, too)."""
    error = abs(error)
    return error * (error >= DEADBAND[name]) if deadband else error


def reward_terms(states, reference: ReferencePose, lateral_m, deadband: bool = True) -> dict:
    """The six weighted terms of Eq 3.10.

    Args:
        states: ``(..., 49)``, NumPy array or torch tensor.
        reference: Reference pose at each state's own phase, of the same kind of array.
        lateral_m: Sideways position of the pelvis, ``(...)`` m, in the world frame; the state
            does not hold it.
        deadband: Whether small velocity and position errors count as none, as in the original;
            a planner may drop the deadbands to have a gradient inside them.

    Returns:
        Mapping from the names of :data:`WEIGHTS` to arrays ``(...)``; each lies in
        ``(0, weight]`` and their sum is the reward in ``(0, 1]``.

    Raises:
        ShapeError: If the last axis of ``states`` is not 49 long.
    """
    if tuple(states.shape[-1:]) != (STATE_SIZE,):
        raise ShapeError(f"states have shape {tuple(states.shape)}: expected (..., {STATE_SIZE})")
    motor_error = states[..., MOTOR_POSITION] - reference.motor_position
    motor = sum(30.0 * w * motor_error[..., i] ** 2 for i, w in enumerate(_MOTOR_WEIGHTS))
    joint_error = states[..., JOINT_POSITION] - reference.joint_position
    velocity = states[..., PELVIS_VELOCITY]
    errors = {
        # <q, [1, 0, 0, 0]> is the scalar part of the pelvis quaternion.
        "orientation": 5.0 * (1.0 - states[..., PELVIS_ORIENTATION.start] ** 2),
        "motor": motor,
        "forward_velocity": _outside(
            velocity[..., 0] - states[..., SPEED.start], "forward_velocity", deadband
        ),
        "lateral_velocity": _outside(velocity[..., 1], "lateral_velocity", deadband),
        "lateral_position": _outside(lateral_m, "lateral_position", deadband),
        "spring": sum(1000.0 * joint_error[..., i] ** 2 for i in _SHIN),
    }
    return {name: weight * _exp(-errors[name]) for name, weight in WEIGHTS.items()}


def reward(states, reference: ReferencePose, lateral_m, deadband: bool = True):
    """Eq 3.10: the sum of :func:`reward_terms`, shape ``(...)``; same arguments and errors."""
    return sum(reward_terms(states, reference, lateral_m, deadband).values())
