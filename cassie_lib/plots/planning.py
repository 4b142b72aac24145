"""Figures of notebooks 06 and 07: rewards until the fall, what was imagined, why it fell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cassie_lib.figures import COLOURS, COLUMN_WIDTH_IN
from cassie_lib.planning.episodes import PlannedEpisodes
from cassie_lib.reward import WEIGHTS
from cassie_lib.robot.schema import PERIOD

Drawn = tuple[Figure, Mapping[str, Any]]
#: Lines across reward figures.
_LINES = {"pi*": (COLOURS["green"], "--"), "standing still": ("0.35", ":")}
_SYMBOL = {"pi*": "π*"}
#: One colour for one thing, in every figure of the planners.
TONES = {
    "feedforward": COLOURS["blue"],
    "true simulator": COLOURS["orange"],
    "expert": COLOURS["green"],
    "zero": COLOURS["vermillion"],
    "warm": COLOURS["sky"],
    "reference": COLOURS["black"],
}


def reward_panel(
    axes: Axes,
    found: PlannedEpisodes,
    lines: Mapping[str, float],
    *,
    colour: str = COLOURS["blue"],
    thesis_fall: int | None = None,
) -> dict[str, np.ndarray]:
    """Plain Eq 3.10 against the control step: median and range of the seeds still upright.

    The median ends where fewer than half of the seeds are upright.

    Args:
        axes: Where to draw.
        found: Episodes of a planner.
        lines: Reward per step of the baselines by name.
        colour: Of median and band.
        thesis_fall: Control step at which the thesis's robot fell.

    Returns:
        The plotted columns.
    """
    reward, length = found.recording.reward, found.recording.length
    last = max(1, int(length.max()))
    steps, upright = np.arange(last), reward[:, :last]
    middle = np.nanmedian(upright, axis=0) if length.max() else np.full(1, np.nan)
    low, high = np.nanmin(upright, axis=0), np.nanmax(upright, axis=0)
    # Of the last few seeds it would jump at every fall of another one.
    count = np.isfinite(upright).sum(axis=0)
    middle[2 * count < len(length)] = np.nan
    # With an outline: the range of the last seed has no height.
    axes.fill_between(steps, low, high, color=colour, alpha=0.25, lw=0.8, label="range of seeds")
    axes.plot(steps, middle, "-", color=colour, lw=0.9, label="median, while half are upright")
    for name, value in lines.items():
        tone, style = _LINES[name]
        axes.axhline(value, color=tone, ls=style, lw=1.0, label=_SYMBOL.get(name, name))
    handover = found.log.handover_step
    axes.axvline(handover, color="black", ls="-", lw=0.8, label="hand-over to the planner")
    if thesis_fall:
        axes.axvline(thesis_fall, color=COLOURS["purple"], ls="-.", lw=1.0,
                     label=f"thesis: fall at {thesis_fall}")  # fmt: skip
    fallen = np.flatnonzero(found.recording.fell & (length > 0))
    where = length[fallen]
    if len(fallen):
        axes.plot(
            where, reward[fallen, where - 1], "x", color=COLOURS["vermillion"], ms=5, mew=1.3,
            label="fall of a seed", clip_on=False, zorder=5,
        )  # fmt: skip
    axes.set(ylim=(0.0, 1.02), yticks=np.linspace(0.0, 1.0, 6), ylabel="Eq 3.10 per step")
    return {"step": steps, "median": middle, "low": low, "high": high,
            "seeds_upright": count}  # fmt: skip


def panels_legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend over the figure for all that is drawn in some panel, each label once."""
    found: dict[str, Any] = {}
    for ax in panels:
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    figure.legend(list(found.values()), list(found), loc="outside upper center", ncols=3)


def survival_panel(axes: Axes, trials: Mapping[str, PlannedEpisodes]) -> dict[str, Any]:
    """Share of seeds upright against planner-only control steps, one line per trial.

    Args:
        axes: Where to draw.
        trials: By label; ``"zero mean"`` and the like have the colour of :data:`TONES`.

    Returns:
        The plotted columns by label.
    """
    data = {}
    usual = len(next(iter(trials.values())).planner_steps)
    for index, (label, found) in enumerate(trials.items()):
        total, seeds = found.planner_limit, len(found.planner_steps)
        told = label if seeds == usual else f"{label},\n{seeds} seed{'s' * (seeds > 1)}"
        steps = np.arange(total + 1)
        # Upright for at least so many steps; at the end all that have not fallen remain.
        share = (found.planner_steps[:, None] >= steps).mean(axis=0)
        style = ("-", "--", "-.", ":")[index % 4]
        # Later lines are thinner: those that coincide show through one another.
        other = list(COLOURS.values())[index % len(COLOURS)]
        tone, width = TONES.get(label.removesuffix(" mean"), other), max(1.0, 4.0 - 0.6 * index)
        axes.plot(steps, share, style, color=tone, lw=width, label=told, drawstyle="steps-post")
        if share[-1] > 0:
            axes.plot(steps[-1], share[-1], ">", color=tone, ms=max(3.0, 9.0 - 1.2 * index))
        data[label] = {"planner_steps": steps, "share_upright": share}
    axes.plot([], [], ">", color="0.35", ms=5, label="still upright\nat the trial's end")
    axes.set(xlabel="planner-only control steps", ylabel="share of seeds upright")
    axes.set_xlim(left=0.0)
    axes.set_ylim(0.0, 1.05)
    # Beside the panel: inside it, one line more than fits would push the panels together.
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=6.5)
    return data


def plot_rewards(
    learned: PlannedEpisodes,
    oracle: PlannedEpisodes,
    means: Mapping[str, PlannedEpisodes],
    lines: Mapping[str, float],
    thesis_fall: int,
) -> Drawn:
    """Reward until the fall or the end, on the learned and the true model (Figures 5.6, 5.7).

    Args:
        learned: The planner on the learned model.
        oracle: The same planner on the true simulator.
        means: Trials with other initial means of the plans.
        lines: Reward per step of the baselines by name.
        thesis_fall: Control step of the thesis's fall.
    """
    figure, axes = plt.subplots(
        3, 1, figsize=(COLUMN_WIDTH_IN, 6.0), height_ratios=(1.25, 1.0, 1.0)
    )
    top = reward_panel(axes[0], learned, lines, thesis_fall=thesis_fall)
    steps = oracle.recording.actions.shape[1]
    middle = reward_panel(axes[1], oracle, lines, colour=TONES["true simulator"],
                          thesis_fall=thesis_fall if thesis_fall < steps else None)  # fmt: skip
    seeds, few = len(learned.recording.length), len(oracle.recording.length)
    axes[0].set_title(f"planning on the learned model, {seeds} seeds")
    axes[1].set_title(f"the same planner on the true simulator, {few} seed" + "s" * (few > 1))
    for ax in axes[:2]:
        ax.set_xlabel("control step (0.03 s each)")
        ax.set_xlim(0, 1.01 * learned.recording.actions.shape[1])
    axes[1].axvspan(steps, axes[1].get_xlim()[1], color="0.93", lw=0)
    axes[1].text(steps, 0.05, "  not run: too expensive", fontsize=6.5, color="0.4")
    survival = survival_panel(axes[2], {**means, "true simulator": oracle})
    # The planner's first step lies under the hand-over of the panels above.
    axes[2].set_xlim(np.array(axes[0].get_xlim()) - learned.log.handover_step)
    panels_legend(figure, axes[:2])
    return figure, {"learned": top, "oracle": middle} | {
        f"upright, {name}": columns for name, columns in survival.items()
    }


def plot_imagined(trials: Mapping[str, PlannedEpisodes], horizon: int) -> Drawn:
    """Imagined against realised return of every plan, and their difference before the end.

    Both are Eq 3.11 over the reward that the planner maximises, foot term included, without what
    counts beyond the horizon.  The plan is made anew at every step, so the realised return is not
    that of the plan itself.

    Args:
        trials: Trials by label.
        horizon: tau; plans whose horizon reaches past the end of an episode are left out.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(COLUMN_WIDTH_IN, 2.7))
    data = {}
    tones = (COLOURS["blue"], COLOURS["orange"], COLOURS["green"])
    for tone, (label, found) in zip(tones, trials.items(), strict=False):
        imagined, realised = found.imagined_and_realised()
        left.plot(realised, imagined, ".", color=tone, ms=1.5, alpha=0.35, rasterized=True)
        left.plot([], [], "o", color=tone, ms=4, label=label)
        before, error = _optimism(found, horizon)
        right.plot(before, error, "-", color=tone, label=label)
        data[label] = {"imagined": imagined, "realised": realised}
        data[f"{label}, before the end"] = {"steps_before_end": before, "median_difference": error}
    low, high = left.get_xlim()
    left.plot([low, high], [low, high], "-", color="0.5", lw=0.8, label="equal")
    left.set(xlabel="realised return of the plan's steps", ylabel="imagined return")
    right.axhline(0.0, color="0.5", lw=0.8)
    right.invert_xaxis()
    right.set(xlabel="control steps before the end", ylabel="imagined − realised (median)")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure, data


def _optimism(
    found: PlannedEpisodes, horizon: int, reach: int = 4 * PERIOD
) -> tuple[np.ndarray, np.ndarray]:
    """Median difference of imagined and realised return, by control steps before the end."""
    difference = (found.log.imagined_return - found.log.realised_return).T
    before = found.recording.length[:, None] - np.arange(difference.shape[1])
    known = np.isfinite(difference)
    counts = np.arange(reach, horizon, -1)
    rows = [difference[known & (before == count)] for count in counts]
    kept = [index for index, row in enumerate(rows) if len(row)]
    return counts[kept], np.array([np.median(rows[index]) for index in kept])


def plot_fall_terms(found: PlannedEpisodes, reach: int = 2 * PERIOD) -> Drawn:
    """The six terms of Eq 3.10 before the end of an episode, each as share of its weight.

    Mean over the seeds that fell (over all of them if none did).
    """
    recording = found.recording
    chosen = recording.fell if recording.fell.any() else np.ones(len(recording.length), bool)
    before = recording.length[chosen, None] - np.arange(recording.actions.shape[1])
    counts = np.arange(min(reach, int(before.max())), 0, -1)
    figure, ax = plt.subplots(figsize=(COLUMN_WIDTH_IN, 2.6))
    data: dict[str, Any] = {"steps_before_end": counts}
    styles = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)))
    for (name, weight), tone, style in zip(WEIGHTS.items(), COLOURS.values(), styles, strict=False):
        values = recording.terms[name][chosen] / weight
        data[name] = np.array([values[before == count].mean() for count in counts])
        label = f"{name.replace('_', ' ')} ({weight:g})"
        ax.plot(counts, data[name], linestyle=style, color=tone, label=label)
    ax.invert_xaxis()
    ax.set_ylim(0.0, 1.02)
    ended = f"the fall ({chosen.sum()} seeds)" if recording.fell.any() else "the end (no fall)"
    ax.set(xlabel=f"control steps before {ended}", ylabel="term / its weight")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure, data
