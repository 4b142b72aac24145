"""The 49 components of a state and the 10 of an action: thesis Table 4.1 and Appendix A.3.

The order is that of the open RSS 2020 environment on which the thesis builds.  Linear velocity
and acceleration of the pelvis are in the world frame, its angular velocity is in the body frame,
angles are radians.  Table 4.1's ``[40, 46]`` for six velocities is one index too long, and
Appendix A.3 names the speed before the clock; the layout below is the one that its numbers fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cassie_lib.errors import ShapeError

STATE_SIZE = 49
ACTION_SIZE = 10
#: Control steps after which the clock repeats: phase counts 0..27 and starts again.
PERIOD = 28
#: The clock is sin and cos of 2*pi*phase/27; A.3's (-0.11609, -0.99324) is phase 14 exactly.
CLOCK_DIVISOR = 27
CONTROL_PERIOD_S = 0.03
GRAVITY = 9.81

PELVIS_HEIGHT = slice(0, 1)
PELVIS_ORIENTATION = slice(1, 5)
MOTOR_POSITION = slice(5, 15)
PELVIS_VELOCITY = slice(15, 18)
PELVIS_ANGULAR_VELOCITY = slice(18, 21)
MOTOR_VELOCITY = slice(21, 31)
PELVIS_ACCELERATION = slice(31, 34)
JOINT_POSITION = slice(34, 40)
JOINT_VELOCITY = slice(40, 46)
CLOCK = slice(46, 48)
SPEED = slice(48, 49)
#: Components that follow from the physics; the clock and the command are known beforehand.
PHYSICAL = slice(0, 46)

MOTOR_NAMES = tuple(
    f"{side}-{joint}"
    for side in ("left", "right")
    for joint in ("hip-roll", "hip-yaw", "hip-pitch", "knee", "foot")
)
#: Joints that are measured but not driven.
JOINT_NAMES = tuple(
    f"{side}-{joint}" for side in ("left", "right") for joint in ("shin", "tarsus", "foot")
)


@dataclass(frozen=True)
class Group:
    """One row of Table 4.1: neighbouring components of one kind."""

    name: str
    slice: slice
    unit: str
    order: int
    labels: tuple[str, ...]


GROUPS = (
    Group("pelvis height", PELVIS_HEIGHT, "m", 0, ("z",)),
    Group("pelvis orientation", PELVIS_ORIENTATION, "1", 0, ("w", "x", "y", "z")),
    Group("motor position", MOTOR_POSITION, "rad", 0, MOTOR_NAMES),
    Group("pelvis linear velocity", PELVIS_VELOCITY, "m/s", 1, ("x", "y", "z")),
    Group("pelvis angular velocity", PELVIS_ANGULAR_VELOCITY, "rad/s", 1, ("x", "y", "z")),
    Group("motor velocity", MOTOR_VELOCITY, "rad/s", 1, MOTOR_NAMES),
    Group("pelvis linear acceleration", PELVIS_ACCELERATION, "m/s^2", 2, ("x", "y", "z")),
    Group("unactuated joint position", JOINT_POSITION, "rad", 0, JOINT_NAMES),
    Group("unactuated joint velocity", JOINT_VELOCITY, "rad/s", 1, JOINT_NAMES),
    Group("clock", CLOCK, "1", 0, ("sin", "cos")),
    Group("commanded forward speed", SPEED, "m/s", 1, ("x",)),
)


@dataclass(frozen=True)
class Component:
    """One component of the state.

    Attributes:
        index: Position in the state vector, 0..48.
        name: Group and label, e.g. ``"motor position left-knee"``.
        unit: SI unit.
        order: Derivative order 0, 1 or 2 (the weights of Eq 3.6 depend on it).
        mirror: Index of the component that it becomes when left and right are exchanged.
        sign: Factor that goes with the exchange, +1 or -1.
    """

    index: int
    name: str
    unit: str
    order: int
    mirror: int
    sign: int


def _swap_sides(labels: tuple[str, ...]) -> list[int]:
    other = {"left": "right", "right": "left"}
    return [
        labels.index(f"{other[label.split('-')[0]]}-{label.split('-', 1)[1]}") for label in labels
    ]


def _mirror_rule(group: Group) -> tuple[list[int], list[int]]:
    """Local partner and sign of each label of a group under reflection in the x-z plane."""
    if group.labels in (MOTOR_NAMES, JOINT_NAMES):
        # Roll and yaw turn about axes in the mirror plane, so their angles change sign.
        signs = [-1 if label.endswith(("roll", "yaw")) else 1 for label in group.labels]
        return _swap_sides(group.labels), signs
    count = len(group.labels)
    signs = {
        "pelvis orientation": [1, -1, 1, -1],
        "pelvis linear velocity": [1, -1, 1],
        "pelvis angular velocity": [-1, 1, -1],
        "pelvis linear acceleration": [1, -1, 1],
        # Half a cycle turns the clock by almost pi; 28 steps over a divisor of 27 make it inexact,
        # so mirror_state asks for the phase when the clock has to be exact.
        "clock": [-1, -1],
    }.get(group.name, [1] * count)
    return list(range(count)), signs


def _components() -> tuple[Component, ...]:
    found = []
    for group in GROUPS:
        partners, signs = _mirror_rule(group)
        start = group.slice.start
        for local, label in enumerate(group.labels):
            name = (
                group.name
                if label in ("z", "x") and len(group.labels) == 1
                else (f"{group.name} {label}")
            )
            found.append(
                Component(
                    start + local,
                    name,
                    group.unit,
                    group.order,
                    start + partners[local],
                    signs[local],
                )
            )
    return tuple(found)


COMPONENTS = _components()
DERIVATIVE_ORDER = np.array([component.order for component in COMPONENTS])
_STATE_MIRROR = np.array([component.mirror for component in COMPONENTS])
_STATE_SIGN = np.array([float(component.sign) for component in COMPONENTS])
_ACTION_MIRROR = np.array(_swap_sides(MOTOR_NAMES))
_ACTION_SIGN = np.array([-1.0 if n.endswith(("roll", "yaw")) else 1.0 for n in MOTOR_NAMES])


def clock(phase):
    """Clock of a phase: ``(sin, cos)(2*pi*phase/27)``.

    Args:
        phase: Integer phase 0..27, any shape ``(...)``.

    Returns:
        Array ``(..., 2)``.
    """
    angle = 2.0 * np.pi * np.asarray(phase) / CLOCK_DIVISOR
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1)


def phase_from_clock(values):
    """Invert :func:`clock`: nearest integer phase of clock values ``(..., 2)``.

    Phase 27 has the clock of phase 0 (27 divides the angle), so 0 is returned for both.
    """
    values = np.asarray(values)
    angle = np.arctan2(values[..., 0], values[..., 1])
    return np.rint(angle * CLOCK_DIVISOR / (2.0 * np.pi)).astype(int) % CLOCK_DIVISOR


def mirror_state(states, phase=None):
    """Exchange left and right (reflection in the x-z plane).

    Args:
        states: Array ``(..., 49)``.
        phase: Phases ``(...)`` of the states; when given, the clock of the mirrored state is the
            exact clock half a cycle on, otherwise both its parts just change sign.

    Returns:
        Array ``(..., 49)``.

    Raises:
        ShapeError: If the last axis is not 49 long.
    """
    states = np.asarray(states)
    if states.shape[-1:] != (STATE_SIZE,):
        raise ShapeError(f"states have shape {states.shape}: expected (..., {STATE_SIZE})")
    mirrored = states[..., _STATE_MIRROR] * _STATE_SIGN
    if phase is not None:
        mirrored[..., CLOCK] = clock((np.asarray(phase) + PERIOD // 2) % PERIOD)
    return mirrored


def mirror_action(actions):
    """Exchange left and right in actions ``(..., 10)``.

    Raises:
        ShapeError: If the last axis is not 10 long.
    """
    actions = np.asarray(actions)
    if actions.shape[-1:] != (ACTION_SIZE,):
        raise ShapeError(f"actions have shape {actions.shape}: expected (..., {ACTION_SIZE})")
    return actions[..., _ACTION_MIRROR] * _ACTION_SIGN
