"""Figures of notebook 01: the robot, its drive, its state and its reference gait."""

from __future__ import annotations

import numpy as np

from cassie_lib.figures import COLOURS, COLUMN_WIDTH_IN
from cassie_lib.gait import GaitReference
from cassie_lib.physics_checks import StepResponse, TimestepComparison
from cassie_lib.reward import WEIGHTS, reward_terms
from cassie_lib.robot import model as robot
from cassie_lib.robot.rendering import draw_skeleton, pictures
from cassie_lib.robot.schema import CONTROL_PERIOD_S, GROUPS, MOTOR_NAMES, PERIOD
from cassie_lib.robot.state import extract_state

#: Poses of the strip, as phases of the clock.
_STRIP = (0, 4, 8, 12, 16, 20, 24)
_SPACING_M = 0.5


def state_table():
    """Table 4.1 as a pandas frame: indices, component, unit, derivative order."""
    import pandas as pd

    rows = [
        {
            "indices": f"[{group.slice.start}, {group.slice.stop - 1}]",
            "component": group.name,
            "of": ", ".join(group.labels),
            "unit": group.unit,
            "derivative order": group.order,
        }
        for group in GROUPS
    ]
    return pd.DataFrame(rows).set_index("indices")


def plot_robot(qpos):
    """Cassie from three sides (thesis Figure 4.3).

    Args:
        qpos: ``(35,)``.

    Returns:
        The figure, its data, and how the pictures were made.
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(COLUMN_WIDTH_IN, 2.6))
    views = {"oblique": 125.0, "side": 90.0, "front": 180.0}
    for ax, (name, azimuth) in zip(axes, views.items(), strict=True):
        frames, how = pictures(qpos, azimuth_deg=azimuth, width=480, height=560, distance_m=2.0)
        ax.imshow(frames[0])
        ax.set_title(name)
        ax.axis("off")
    return figure, {"qpos": np.asarray(qpos, dtype=float)}, how


def plot_pd_tracking(response: StepResponse):
    """Step response and torque of every motor, left leg over right leg.

    Returns:
        The figure and its data.
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(4, 5, figsize=(COLUMN_WIDTH_IN, 5.2), sharex=True, sharey="row")
    data = {}
    for motor, name in enumerate(MOTOR_NAMES):
        side, column = divmod(motor, 5)
        angle, torque = axes[2 * side, column], axes[2 * side + 1, column]
        angle.plot(response.time_s, response.target_rad[motor], "--", color="0.4")
        angle.plot(response.time_s, response.position_rad[motor], "-", color=COLOURS["blue"])
        torque.plot(response.time_s, response.torque_Nm[motor], "-", color=COLOURS["vermillion"])
        limit = response.limit_Nm[motor]
        torque.text(0.97, 0.93, f"limit ±{limit:g}", ha="right", va="top", fontsize=6,
                    transform=torque.transAxes)  # fmt: skip
        angle.set_title(name, fontsize=7)
        data[name] = {
            "time_s": response.time_s[::10],
            "target_rad": response.target_rad[motor, ::10],
            "position_rad": response.position_rad[motor, ::10],
            "torque_Nm": response.torque_Nm[motor, ::10],
        }
    for row in (0, 2):
        axes[row, 0].set_ylabel("offset (rad)")
        axes[row + 1, 0].set_ylabel("torque (N m)")
    for ax in axes[-1]:
        ax.set_xlabel("time (s)")
    return figure, data


def plot_reference(reference: GaitReference):
    """Strip of poses over one cycle, joint curves, and foot heights.

    Returns:
        The figure and its data.
    """
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(COLUMN_WIDTH_IN, 5.6))
    grid = figure.add_gridspec(3, 2, height_ratios=(1.9, 1.2, 1.0))
    strip = figure.add_subplot(grid[0, :])
    for place, phase in enumerate(_STRIP):
        pose = reference.qpos[phase].copy()
        draw_skeleton(strip, pose, offset_m=_SPACING_M * place - pose[0])
        strip.text(_SPACING_M * place, 1.12, f"phase {phase}", ha="center", fontsize=7)
    strip.set_xticks([])
    strip.set_ylabel("height (m)")
    strip.set_ylim(-0.05, 1.25)
    strip.set_xlim(-0.45, _SPACING_M * (len(_STRIP) - 1) + 0.85)  # room for the legend
    strip.grid(visible=False)
    for tone, name in ((COLOURS["blue"], "left leg"), (COLOURS["vermillion"], "right leg")):
        strip.plot([], [], "-", color=tone, label=name)
    strip.legend(loc="center right", fontsize=6.5)
    phases = np.arange(PERIOD + 1)
    offset = reference.motor_position - robot.neutral_pose()
    offset = np.vstack([offset, offset[:1]])
    for side, name in enumerate(("left", "right")):
        ax = figure.add_subplot(grid[1, side])
        for joint in range(5):
            ax.plot(phases, offset[:, 5 * side + joint], label=MOTOR_NAMES[joint][5:])
        ax.set_title(f"{name} leg")
        ax.set_xlabel("phase (control steps of 0.03 s)")
        ax.set_ylabel("offset from neutral (rad)")
    ax.legend(ncols=2, fontsize=6)
    feet = figure.add_subplot(grid[2, :])
    height = np.vstack([reference.foot_height_m, reference.foot_height_m[:1]])
    feet.plot(phases, height[:, 0], color=COLOURS["blue"], label="left")
    feet.plot(phases, height[:, 1], color=COLOURS["vermillion"], label="right")
    feet.set_xlabel("phase (control steps of 0.03 s)")
    feet.set_ylabel("sole height (m)")
    feet.legend()
    data = {
        "phase": phases,
        "left_foot_height_m": height[:, 0],
        "right_foot_height_m": height[:, 1],
    }
    data |= {f"{name}_offset_rad": offset[:, i] for i, name in enumerate(MOTOR_NAMES)}
    return figure, data


def reference_states(reference: GaitReference) -> np.ndarray:
    """States ``(28, 49)`` along a reference; accelerations by differences of its velocities."""
    acceleration = (np.roll(reference.qvel[:, :3], -1, axis=0) - reference.qvel[:, :3]) / (
        CONTROL_PERIOD_S
    )
    speed = np.full(PERIOD, reference.speed_mps)
    return extract_state(reference.qpos, reference.qvel, acceleration, np.arange(PERIOD), speed)


def plot_reward_terms(reference: GaitReference):
    """The six terms of Eq 3.10 along the reference, against the most that each can pay.

    Returns:
        The figure, its data, and the total per phase ``(28,)``.
    """
    import matplotlib.pyplot as plt

    phase = np.arange(PERIOD)
    terms = reward_terms(reference_states(reference), reference.pose(phase), reference.qpos[:, 1])
    total = sum(terms.values())
    figure, ax = plt.subplots(figsize=(COLUMN_WIDTH_IN, 2.8))
    bottom = np.zeros(PERIOD)
    colours = (COLOURS[name] for name in ("blue", "sky", "green", "orange", "vermillion", "purple"))
    for (name, values), colour in zip(terms.items(), colours, strict=True):
        label = f"{name.replace('_', ' ')} (≤ {WEIGHTS[name]:g})"
        ax.bar(phase, values, 0.9, bottom, color=colour, label=label)
        bottom += values
    ax.axhline(1.0, color="0.3", lw=0.8, ls="--")
    ax.set_xlabel("phase (control steps of 0.03 s)")
    ax.set_ylabel("reward, Eq 3.10")
    ax.set_ylim(0.0, 1.05)
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure, {"phase": phase, **terms, "total": total}, total


def plot_timesteps(comparison: TimestepComparison):
    """Pelvis height at coarse and fine physics, and how far the paths are apart.

    Returns:
        The figure and its data.
    """
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(COLUMN_WIDTH_IN, 2.2))
    left.plot(comparison.time_s, comparison.fine_m[:, 2], label="0.5 ms")
    left.plot(comparison.time_s, comparison.coarse_m[:, 2], label="2 ms")
    left.set_ylabel("pelvis height (m)")
    left.legend()
    right.plot(comparison.time_s, 1e3 * comparison.distance_m)
    right.axhline(10.0, color="0.4", ls="--", lw=0.8)
    right.text(0.0, 10.2, "bound 10 mm", fontsize=6, va="bottom")
    right.set_ylabel("distance (mm)")
    for ax in (left, right):
        ax.set_xlabel("time (s)")
    data = {
        "time_s": comparison.time_s,
        "fine_height_m": comparison.fine_m[:, 2],
        "coarse_height_m": comparison.coarse_m[:, 2],
        "distance_m": comparison.distance_m,
    }
    return figure, data
