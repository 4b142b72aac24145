"""Reference motions by inverse kinematics: step in place, walk at a speed, hop.

The thesis compares with a human-tuned recording (section 3.2.1); these references are made on
the same robot instead, near the recording's published features: a cycle of 28 control steps
(0.84 s), soles lifted by about 0.11 m, pelvis at 1.02-1.05 m, a sway of +-0.026 m and feet
0.135 m either side of the midline.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import mujoco
import numpy as np

from cassie_lib.errors import ParameterError, unknown_name
from cassie_lib.reward import ReferencePose
from cassie_lib.robot import model as robot
from cassie_lib.robot.kinematics import FootTarget, LegKinematics, standing_qpos
from cassie_lib.robot.schema import CONTROL_PERIOD_S, GRAVITY, PERIOD

PERIOD_S = PERIOD * CONTROL_PERIOD_S
FOOT_LIFT_M = 0.11
PELVIS_HEIGHT_M = 1.03
SWAY_M = 0.026
STANCE_WIDTH_M = 0.135
#: Share of the cycle that each foot is in the air; the left one first.
SWING_SHARE = 0.42
MAX_SPEED_MPS = 1.0
#: Share of the hop's cycle in free flight, around half of the cycle.
HOP_SHARE = 0.2
HOP_HEIGHT_M = 0.97
#: Sagittal shift of the feet from under the pelvis origin, as in the standing pose.
_FOOT_FORWARD_M = -0.002
#: Inverse kinematics per control step; velocities are central differences of this sampling.
_SAMPLES_PER_STEP = 4


@dataclass(frozen=True)
class GaitReference:
    """One cycle of a reference motion, sampled at the 28 phases of the clock.

    References are made once and shared: whoever changes an array changes it for all and copies it
    first.

    Attributes:
        name: Gait name.
        speed_mps: Forward speed in m/s.
        qpos: Configurations, ``(28, 35)``; the pelvis advances by ``speed * 0.03 s`` a phase.
        qvel: Velocities, ``(28, 32)``, central differences of a four times finer sampling.
        foot_height_m: Height of the soles' lowest point over the floor, ``(28, 2)``.
        in_contact: Whether a foot should carry load, ``(28, 2)``.
    """

    name: str
    speed_mps: float
    qpos: np.ndarray
    qvel: np.ndarray
    foot_height_m: np.ndarray
    in_contact: np.ndarray

    @property
    def motor_position(self) -> np.ndarray:
        """Driven joints, ``(28, 10)`` rad."""
        return self.qpos[:, robot.motor_qpos()]

    @property
    def joint_position(self) -> np.ndarray:
        """Measured, undriven joints, ``(28, 6)`` rad."""
        return self.qpos[:, robot.joint_qpos()]

    def pose(self, phase) -> ReferencePose:
        """What the reward of Eq 3.10 compares with at phases ``(...)`` (any integers)."""
        phase = np.asarray(phase) % PERIOD
        return ReferencePose(self.motor_position[phase], self.joint_position[phase])


def _smoothstep(u):
    """Quintic from 0 to 1 with zero velocity and acceleration at both ends."""
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def _swing_progress(cycle, start, share):
    """Progress 0..1 of a swing that starts at ``start``; 0 before it and 1 after it."""
    return np.clip(((cycle - start) % 1.0) / share, 0.0, 1.0)


def _foot_path(cycle, start, speed, lift, share):
    """Foot relative to the pelvis, forward and up, at cycle position 0..1.

    In stance the foot moves back with the ground.  The swing adds a quintic displacement to that
    same line, so that velocity and acceleration are continuous at lift-off and touch-down.
    """
    since = (cycle - start) % 1.0
    u = _swing_progress(cycle, start, share)
    stride = speed * PERIOD_S
    # Mid-stance, half-way between touch-down and the next lift-off, is under the pelvis.
    forward = stride * (_smoothstep(u) - since + (1.0 + share) / 2.0 - 1.0)
    return forward, lift * 64.0 * (u * (1.0 - u)) ** 3


def _hop_pelvis(cycle):
    """Pelvis height of the hop: parabolas in flight and in stance, of one speed where they meet."""
    flight = HOP_SHARE * PERIOD_S
    launch_speed = GRAVITY * flight / 2.0
    since = (cycle - (0.5 - HOP_SHARE / 2.0)) % 1.0 * PERIOD_S
    if since < flight:
        return HOP_HEIGHT_M + launch_speed * since - GRAVITY * since**2 / 2.0
    stance = PERIOD_S - flight
    u = (since - flight) / stance
    return HOP_HEIGHT_M - launch_speed * stance * u * (1.0 - u)


def _plan(name: str, cycle: float, speed: float):
    """Pelvis ``(y, z)`` and the two feet's ``(forward, lift)`` at one instant."""
    if name == "hop":
        foot = _foot_path(cycle, 0.5 - HOP_SHARE / 2.0, speed, 0.6 * FOOT_LIFT_M, HOP_SHARE)
        return 0.0, _hop_pelvis(cycle), (foot, foot)
    start = (0.5 - SWING_SHARE) / 2.0
    feet = tuple(
        _foot_path(cycle, start + half, speed, FOOT_LIFT_M, SWING_SHARE) for half in (0.0, 0.5)
    )
    # The pelvis leans over the standing foot: right while the left one swings.
    sway = -SWAY_M * np.sin(2.0 * np.pi * cycle)
    return sway, PELVIS_HEIGHT_M - 0.008 * np.cos(4.0 * np.pi * cycle), feet


def _solve_cycle(name: str, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Configurations ``(28*4, 35)`` and foot lifts ``(28*4, 2)`` over one cycle."""
    kinematics = LegKinematics()
    count = PERIOD * _SAMPLES_PER_STEP
    ground = robot.FLOOR_HEIGHT_M + robot.FOOT_RADIUS_M
    guess = np.array(standing_qpos())
    configurations, lifts = np.empty((count, len(guess))), np.empty((count, 2))
    for index in range(count):
        cycle = index / count
        sway, height, feet = _plan(name, cycle, speed)
        guess[:3] = speed * cycle * PERIOD_S, sway, height
        left, right = (
            FootTarget(np.array([guess[0] + _FOOT_FORWARD_M + forward, side, ground + lift]))
            for side, (forward, lift) in zip((STANCE_WIDTH_M, -STANCE_WIDTH_M), feet, strict=True)
        )
        guess = kinematics.place_feet(guess, (left, right))
        configurations[index] = guess
        lifts[index] = [lift for _, lift in feet]
    return configurations, lifts


def _velocities(configurations: np.ndarray, speed: float) -> np.ndarray:
    """Central differences over the closed cycle, ``(samples, 32)``."""
    model = robot.load_model()
    step = CONTROL_PERIOD_S / _SAMPLES_PER_STEP
    count = len(configurations)
    velocities = np.empty((count, model.nv))
    for index in range(count):
        before = configurations[index - 1].copy()
        after = configurations[(index + 1) % count].copy()
        before[0] -= speed * PERIOD_S * (index == 0)
        after[0] += speed * PERIOD_S * (index == count - 1)
        mujoco.mj_differentiatePos(model, velocities[index], 2.0 * step, before, after)
    return velocities


@functools.lru_cache(maxsize=64)
def _make(name: str, speed: float) -> GaitReference:
    if not 0.0 <= speed <= MAX_SPEED_MPS:
        raise ParameterError(f"speed_mps = {speed}: expected 0 to {MAX_SPEED_MPS}")
    configurations, lifts = _solve_cycle(name, speed)
    every = slice(None, None, _SAMPLES_PER_STEP)
    velocities = _velocities(configurations, speed)[every]
    label = "step-in-place" if name == "walk" and speed == 0.0 else name
    return GaitReference(
        label, speed, configurations[every], velocities, lifts[every], lifts[every] <= 0.0
    )


def step_in_place() -> GaitReference:
    """Step on the spot: :func:`walk` at 0 m/s."""
    return _make("walk", 0.0)


def walk(speed_mps: float) -> GaitReference:
    """Walk forward.

    Args:
        speed_mps: Forward speed, 0 to 1 m/s.

    Raises:
        ParameterError: If the speed is out of range.
    """
    return _make("walk", float(speed_mps))


def hop(speed_mps: float = 0.0) -> GaitReference:
    """Hop on both legs, once a cycle.

    Args:
        speed_mps: Forward speed, 0 to 1 m/s.

    Raises:
        ParameterError: If the speed is out of range.
    """
    return _make("hop", float(speed_mps))


GAITS = {"step-in-place": lambda speed: step_in_place(), "walk": walk, "hop": hop}


def get_gait(name: str, speed_mps: float = 0.0) -> GaitReference:
    """Return a gait by name.

    Args:
        name: One of ``GAITS``.
        speed_mps: Forward speed in m/s; stepping in place has none.

    Raises:
        UnknownNameError: If there is no such gait.
        ParameterError: If the speed is out of range.
    """
    if name not in GAITS:
        raise unknown_name("gait", name, GAITS)
    return GAITS[name](speed_mps)
