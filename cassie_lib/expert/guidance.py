"""What the training reward adds to Eq 3.10, which alone teaches a robot to stand still."""

from __future__ import annotations

import numpy as np

#: How sharply a wrong foot height costs (1/m): 3 cm off keep 0.5 of the term.
_FOOT_SHARPNESS = 25.0
#: A tenth of the weight on a swinging foot leaves 0.22 of the term.
_LOAD_SHARPNESS = 15.0


def gait_term(foot_height_m, foot_load, reference_height_m, swing) -> np.ndarray:
    """Periodic swing/stance term: each foot in the air, or on the floor, when it should be.

    Eq 3.10 pays about 0.92 to a robot that stands still; this term pays it about 0.6, because in
    swing the foot has to be as high as in the reference and free of load.

    Args:
        foot_height_m: Heights of the soles over the floor, ``(N, 2)`` m.
        foot_load: Vertical ground reaction as a share of the robot's weight, ``(N, 2)``.
        reference_height_m: Heights of the reference at the same phases, ``(N, 2)`` m.
        swing: Whether the reference has the foot in the air, ``(N, 2)``.

    Returns:
        ``(N,)`` in [0, 1].
    """
    height = np.exp(-_FOOT_SHARPNESS * np.abs(foot_height_m - reference_height_m))
    unloaded = np.exp(-_LOAD_SHARPNESS * np.maximum(foot_load, 0.0))
    return (0.4 * height + 0.6 * np.where(swing, unloaded, 1.0 - unloaded)).mean(axis=1)


def long_swing(in_contact: np.ndarray) -> np.ndarray:
    """When a foot should be free of load: the swing of a reference and one step on either side.

    A foot leaves the floor a step late and returns a step early; asked for the reference's own
    swing it is free for 8 of 28 steps, less than a walk has.

    Args:
        in_contact: Whether the reference has each foot on the floor, by phase ``(28, 2)``.

    Returns:
        ``(28, 2)`` booleans; never both feet at once where the reference keeps one down.
    """
    swing = ~in_contact
    longer = swing | np.roll(swing, 1, axis=0) | np.roll(swing, -1, axis=0)
    return longer & ~(longer.all(axis=1, keepdims=True) & ~swing)


def velocity_term(mean_velocity_mps, speed_mps, sharpness: float = 4.0) -> np.ndarray:
    """Track the commanded speed over a whole cycle.

    Eq 3.10's velocity terms are too flat to tell 0.3 m/s from 1 m/s, and they also cost the sway
    that a walk needs; the mean over a cycle does neither.

    Args:
        mean_velocity_mps: Forward and sideways velocity, averaged over about a cycle, ``(N, 2)``.
        speed_mps: Commanded forward speed, ``(N,)``.
        sharpness: How sharply a wrong speed costs, s/m.

    Returns:
        ``(N,)`` in (0, 1].
    """
    error = np.abs(mean_velocity_mps[:, 0] - speed_mps) + np.abs(mean_velocity_mps[:, 1])
    return np.exp(-sharpness * error)
