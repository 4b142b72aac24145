"""Figures of notebook 02: how the expert was trained, how it walks, and the trap in the reward."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from cassie_lib.errors import DataError
from cassie_lib.figures import COLOURS, COLUMN_WIDTH_IN
from cassie_lib.recording import Recording
from cassie_lib.robot.model import parameters
from cassie_lib.robot.schema import CONTROL_PERIOD_S, GRAVITY

#: Updates over which the learning curve is averaged.
_SMOOTHING = 10


def read_log(*paths: Path) -> dict[str, np.ndarray]:
    """Long-form training logs as columns by metric, and ``step`` and ``seconds``.

    Args:
        paths: Logs of trainings that went on from each other: steps and seconds add up.

    Raises:
        DataError: If one is no training log.
    """
    parts = [_read_log(path) for path in paths]
    for before, part in zip(parts, parts[1:], strict=False):
        for key in ("step", "seconds"):
            part[key] = part[key] + before[key][-1]
    common = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in common}


def _read_log(path: Path) -> dict[str, np.ndarray]:
    columns: dict[str, list[float]] = {}
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        for row in rows:
            columns.setdefault(row["metric"], []).append(float(row["value"]))
        first = rows[0]["metric"]
        for key in ("step", "seconds"):
            columns[key] = [float(row[key]) for row in rows if row["metric"] == first]
    except (OSError, KeyError, IndexError, TypeError, ValueError):
        raise DataError(f"{path.name} cannot be read: expected a training log") from None
    return {name: np.array(values) for name, values in columns.items()}


def _smooth(values: np.ndarray) -> np.ndarray:
    width = min(_SMOOTHING, len(values))
    return np.convolve(values, np.ones(width) / width, mode="valid")


def plot_learning_curves(logs: dict[str, dict[str, np.ndarray]], standing_reward: float):
    """Plain Eq 3.10 during training against the wall clock.

    Args:
        logs: Logs of :func:`read_log` by label.
        standing_reward: Eq 3.10 of standing still, drawn as a line.

    Returns:
        The figure and its data.
    """
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(COLUMN_WIDTH_IN, 2.5))
    data = {}
    for label, log in logs.items():
        minutes = _smooth(log["seconds"]) / 60.0
        reward, failures = _smooth(log["plain_reward"]), _smooth(log["falls"])
        left.plot(minutes, reward, label=label)
        right.semilogy(minutes, np.maximum(failures, 1e-5), label=label)
        data[label] = {"minutes": minutes, "reward": reward, "failures_per_step": failures}
    left.axhline(standing_reward, color="0.4", ls=":", lw=1.0)
    left.text(1.0, standing_reward, "standing still", fontsize=6, ha="right", va="bottom",
              color="0.3", transform=left.get_yaxis_transform())  # fmt: skip
    left.set_ylabel("plain Eq 3.10 per step, with noise")
    right.set_ylabel("failures per control step")
    for ax in (left, right):
        ax.set_xlabel("wall clock (min, 2 cores)")
    left.legend(loc="lower right", fontsize=6.5, title="trained on", title_fontsize=6.5)
    return figure, data


def plot_contact_forces(recording: Recording, steps: slice, episode: int = 0):
    """Contact forces on the left foot along three axes (thesis Figure 6.1).

    Args:
        recording: Episodes of the expert.
        steps: Control steps to show.
        episode: Which episode.

    Returns:
        The figure and its data.
    """
    import matplotlib.pyplot as plt

    force = recording.foot_force[episode, steps, 0]
    time = CONTROL_PERIOD_S * np.arange(*steps.indices(recording.foot_force.shape[1]))
    weight = GRAVITY * sum(body["mass_kg"] for body in parameters()["bodies"])
    figure, axes = plt.subplots(3, 1, figsize=(COLUMN_WIDTH_IN, 3.6), sharex=True)
    names = ("forward x", "sideways y", "vertical z")
    for ax, name, values in zip(axes, names, force.T, strict=True):
        ax.plot(time, values, "-", color=COLOURS["blue"])
        ax.set_ylabel(f"{name} (N)")
    axes[2].axhline(weight, color="0.4", ls=":", lw=1.0)
    axes[2].text(1.01, weight, "body\nweight", fontsize=6, va="center", color="0.3",
                 transform=axes[2].get_yaxis_transform())  # fmt: skip
    axes[2].set_xlabel("time (s)")
    axes[0].set_title("left foot, mean over each control step of 0.03 s")
    return figure, {"time_s": time, "x_N": force[:, 0], "y_N": force[:, 1], "z_N": force[:, 2]}


def plot_foot_heights(recordings: dict[str, Recording], steps: slice, episode: int = 0):
    """Sole heights and reward of several policies side by side: the trap in the reward.

    Args:
        recordings: Recordings by label.
        steps: Control steps to show.
        episode: Which episode.

    Returns:
        The figure and its data.
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, len(recordings), figsize=(COLUMN_WIDTH_IN, 3.6), sharex=True,
                                sharey="row", squeeze=False)  # fmt: skip
    data = {}
    for (top, bottom), (label, recording) in zip(axes.T, recordings.items(), strict=True):
        time = CONTROL_PERIOD_S * np.arange(*steps.indices(recording.actions.shape[1]))
        height = recording.foot_height[episode, steps][: len(time)]
        reward = recording.reward[episode, steps]
        top.plot(time, 100.0 * height[:, 0], "-", color=COLOURS["blue"], label="left sole")
        top.plot(time, 100.0 * height[:, 1], "--", color=COLOURS["vermillion"], label="right sole")
        bottom.plot(time, reward, "-", color=COLOURS["black"])
        mean = np.nanmean(recording.reward)
        bottom.set_title(f"mean {mean:.3f}" if np.isfinite(mean) else "fell", fontsize=7.5)
        top.set_title(label)
        bottom.set_xlabel("time (s)")
        data[label] = {"time_s": time, "left_m": height[:, 0], "right_m": height[:, 1],
                       "reward": reward}  # fmt: skip
    axes[0, 0].set_ylabel("sole height (cm)")
    axes[1, 0].set_ylabel("Eq 3.10 per step")
    axes[1, 0].set_ylim(0.0, 1.05)
    axes[0, -1].legend(loc="upper right")
    return figure, data


def plot_speed_tracking(speeds, measured):
    """Mean forward speed less the commanded one, against that.

    Args:
        speeds: Commanded speeds, m/s.
        measured: Speeds of each episode, one array per commanded speed.

    Returns:
        The figure and its data.
    """
    import matplotlib.pyplot as plt

    figure, ax = plt.subplots(figsize=(0.65 * COLUMN_WIDTH_IN, 2.3))
    speeds = np.asarray(speeds)
    ax.axhspan(-0.05, 0.05, color="0.92", lw=0, label="±0.05 m/s")
    ax.axhline(0.0, color="0.5", lw=0.8)
    median = np.array([np.nanmedian(values) for values in measured])
    low = np.array([np.nanmin(values) for values in measured])
    high = np.array([np.nanmax(values) for values in measured])
    ax.errorbar(speeds, median - speeds, [median - low, high - median], fmt="o", ms=4,
                color=COLOURS["blue"], capsize=3, label="median and range of seeds")  # fmt: skip
    reach = 1.3 * max(0.05, float(np.nanmax(np.abs([low - speeds, high - speeds]))))
    ax.set_ylim(-reach, 1.4 * reach)  # room for the legend
    ax.set_xlabel("commanded forward speed (m/s)")
    ax.set_ylabel("mean speed − command (m/s)")
    ax.legend(loc="upper center", ncols=2, fontsize=6.5)
    return figure, {"commanded_mps": speeds, "median_mps": median, "least_mps": low,
                    "greatest_mps": high}  # fmt: skip
