"""Figures of notebook 08: what the rounds of DAgger change."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, SymmetricalLogLocator

from cassie_lib.dagger import Round, to_transitions
from cassie_lib.dynamics.evaluation import CONSTANT, open_loop
from cassie_lib.dynamics.model import DynamicsModel
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.errors import DataError
from cassie_lib.figures import COLOURS, COLUMN_WIDTH_IN, bootstrap_interval
from cassie_lib.planning.episodes import PlannedEpisodes
from cassie_lib.plots.planning import panels_legend, reward_panel
from cassie_lib.robot.rendering import pictures

Drawn = tuple[Figure, Mapping[str, Any]]
#: Panels of the rewards: rounds 0, 1, 2 (the thesis's budget) and the last one.
SHOWN_ROUNDS = (0, 1, 2, -1)
#: Of the runs in order; the thesis's star is purple.
_RUN_TONES = [COLOURS[name] for name in ("blue", "orange", "green", "vermillion", "sky", "black")]


def plot_round_rewards(
    trials: Sequence[PlannedEpisodes | None], lines: Mapping[str, float], thesis_fall: int
) -> Drawn:
    """Reward until the fall or the end after rounds 0, 1, 2 and the last one (Figure 5.8).

    Args:
        trials: Gradient-CEM after each round, round 0 first, None where there is none.
        lines: Reward per step of the baselines by name.
        thesis_fall: Control step at which the thesis's robot fell after two rounds.
    """
    places = {place % len(trials) for place in SHOWN_ROUNDS if place < len(trials)}
    shown = {place: found for place in sorted(places) if (found := trials[place]) is not None}
    figure, axes = plt.subplots(
        len(shown), 1, figsize=(COLUMN_WIDTH_IN, 1.0 + 1.55 * len(shown)), squeeze=False
    )
    data = {}
    for ax, (index, found) in zip(axes[:, 0], shown.items(), strict=True):
        # The thesis's robot fell there after two rounds.
        fall = thesis_fall if index == 2 else None
        data[f"round {index}"] = reward_panel(ax, found, lines, thesis_fall=fall)
        begun = "" if found.log.handover_step else ", begun without the expert"
        steps = np.median(found.planner_steps)
        told = f"median of {steps:g} planner-only steps"
        if steps >= found.planner_limit:
            told = f"median upright to the end, {steps:g} planner-only steps"
        ax.set_title(f"round {index}{begun}: {told}")
        ax.set_xlim(0, 1.01 * found.recording.actions.shape[1])
    axes[-1, 0].set_xlabel("control step (0.03 s each)")
    panels_legend(figure, axes[:, 0])
    return figure, data


def planner_errors(
    models: Sequence[DynamicsModel],
    trials: Sequence[PlannedEpisodes],
    expert: Transitions,
    horizon: int,
) -> dict[str, np.ndarray]:
    """Relative error at the last predicted step, on expert states and on planner states.

    Both are squared errors over the variance of the expert's states, so that they compare.
    Planner states are those that the planner with the same model visited in closed loop.

    Args:
        models: Model of each round.
        trials: Episodes of the planner on each of them.
        expert: Recording of the expert that no model was trained on.
        horizon: Predicted control steps.

    Returns:
        ``{"expert states": (R,), "planner states": (R,)}``; NaN where no episode is long enough.
    """
    found: dict[str, list[float]] = {"expert states": [], "planner states": []}
    for model, trial in zip(models, trials, strict=True):
        own = open_loop(model, expert, horizon)
        varying = own.variance > CONSTANT
        # The first window predicts from the first action of the planner.
        begin = max(0, trial.log.handover_step - model.context + 1)
        try:
            errors = open_loop(model, to_transitions(trial.recording, begin), horizon).model
        except DataError:
            errors = np.full_like(own.model, np.nan)
        for name, values in (("expert states", own.model), ("planner states", errors)):
            relative = values[-1, varying] / own.variance[varying]
            found[name].append(float(relative.mean()))
    return {name: np.array(values) for name, values in found.items()}


def plot_progress(
    runs: Mapping[str, Sequence[PlannedEpisodes | None]],
    errors: Mapping[str, Mapping[str, np.ndarray]],
    rounds: Mapping[str, Sequence[Round]],
    thesis_steps: int,
    zero: Mapping[str, Sequence[PlannedEpisodes | None]],
) -> Drawn:
    """Planner-only steps and model errors against the round; a run has one colour in all panels.

    Args:
        runs: Trials after each round by label; round 0 first, None where there is none.
        errors: Of :func:`planner_errors` by label, for some of the runs.
        rounds: The rounds, with their reports, by label, for some of the runs.
        thesis_steps: Of the thesis after two rounds.
        zero: As ``runs``, for some of them, with plans that begin at the zero mean.
    """
    figure, axes = plt.subplots(1, 3, figsize=(COLUMN_WIDTH_IN, 3.1), width_ratios=(1.3, 1, 1))
    tones = dict(zip(runs, _RUN_TONES, strict=False))
    data = _all_steps(axes[0], runs, zero, tones, thesis_steps)
    for label, found in errors.items():
        for (name, values), style in zip(found.items(), ("o--", "s-"), strict=False):
            axes[1].plot(np.arange(len(values)), values, style, ms=3.5, color=tones[label])
            data[f"{name}, {label}"] = {"round": np.arange(len(values)), "relative_error": values}
    _explain(axes[1], next(iter(errors.values())), "states of")
    axes[1].set(yscale="log", ylabel="squared error / variance")
    axes[1].set_title("error, last step,\nover the expert's variance")
    for label, made in rounds.items():
        numbers = np.array([item.index for item in made])
        for when, style in (("before", "o--"), ("after", "s-")):
            values = np.array([item.report["relative_error"]["round"][when][-1] for item in made])
            axes[2].plot(numbers, values, style, ms=3.5, color=tones[label])
            data[f"round's data, {when} retraining, {label}"] = {
                "round": numbers, "relative_error": values
            }  # fmt: skip
    _explain(axes[2], ("before", "after"), "retraining")
    axes[2].set(ylim=(0.0, 1.35 * axes[2].get_ylim()[1]))  # room for the legend
    axes[2].set_title("on its new data,\nover their variance")
    axes[2].set_ylabel("squared error / variance")
    for ax in axes:
        ax.set_xticks(range(max(len(trials) for trials in runs.values())))
        ax.set_xlabel("round")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure, data


def _explain(ax: Axes, names: Iterable[str], title: str) -> None:
    """Legend of the two lines of a panel, whatever the colour: dashed first, then solid."""
    for name, style in zip(names, ("o--", "s-"), strict=False):
        ax.plot([], [], style, ms=3.5, color="0.35", label=name.removesuffix(" states"))
    ax.legend(title=title, title_fontsize=6.5, fontsize=6.5, handlelength=3.2)


def _all_steps(
    ax: Axes,
    runs: Mapping[str, Sequence[PlannedEpisodes | None]],
    zero: Mapping[str, Sequence[PlannedEpisodes | None]],
    tones: Mapping[str, str],
    thesis_steps: int,
) -> dict[str, Any]:
    """Planner-only steps of all runs: dotted where the plans begin at the zero mean."""
    data: dict[str, Any] = {}
    for place, (label, tone) in enumerate(tones.items()):
        style = "-o" if place == 0 else "--s"
        data[label] = _steps(ax, runs[label], tone, style, 0.12 * place, label)
        if label in zero:
            data[f"{label}, zero mean"] = _steps(ax, zero[label], tone, ":D", 0.12 * place)
    ax.plot([], [], ":D", color="0.35", ms=3.5, label="plans begun at the zero mean")
    ax.plot(2, thesis_steps, "*", color=COLOURS["purple"], ms=9, label="thesis (total)")
    ax.plot([], [], "^", color="black", ms=6, mfc="white", label="median reaches the end")
    ax.set(yscale="symlog", ylabel="control steps")
    ax.set_title("planner-only steps:\nmedian, interval, seeds")
    # A few hundred steps hold one power of ten: 1, 2 and 5 of each are named.
    ax.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=2, subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    tried = [trial for made in (*runs.values(), *zero.values()) for trial in made if trial]
    least = min(thesis_steps, *(int(trial.planner_steps.min()) for trial in tried))
    ax.set_ylim(0.5 * least if least > 2 else 0, 2 * ax.get_ylim()[1])
    return data


def _steps(
    ax: Axes,
    trials: Sequence[PlannedEpisodes | None],
    tone: str,
    style: str,
    shift: float,
    label: str | None = None,
) -> dict[str, np.ndarray]:
    """Median, interval and seeds of planner-only steps; a triangle where the trial ended first."""
    made = {index: found for index, found in enumerate(trials) if found is not None}
    rounds = np.array(list(made))
    numbers = rounds + shift
    steps = [found.planner_steps for found in made.values()]
    middle = np.array([np.median(values) for values in steps])
    bounds = np.array([bootstrap_interval(values) for values in steps]).T
    for number, values in zip(numbers, steps, strict=True):
        ax.plot(np.full(len(values), number), values, ".", color=tone, ms=3, alpha=0.35)
    ends = np.array([found.planner_limit for found in made.values()])
    # Trials of another length do not compare: no line leads there.
    parts = np.split(np.arange(len(rounds)), np.flatnonzero(np.diff(ends)) + 1)
    for place, part in enumerate(parts):
        ax.errorbar(numbers[part], middle[part], np.abs(bounds - middle)[:, part], fmt=style,
                    color=tone, capsize=3, ms=4, label=label if place == 0 else None)  # fmt: skip
    lasting = middle >= ends
    ax.plot(numbers[lasting], middle[lasting], "^", color=tone, ms=6, mfc="white", zorder=4)
    return {"round": rounds, "median": middle, "low": bounds[0], "high": bounds[1],
            "trial_ends_after": ends}  # fmt: skip


def longest(found: PlannedEpisodes) -> int:
    """Episode that lasted longest."""
    return int(found.recording.length.argmax())


def side_by_side(
    left: PlannedEpisodes, right: PlannedEpisodes, steps: int, *, stride: int = 2, size: int = 280
) -> np.ndarray:
    """Frames of the ends of two episodes, next to each other; both end at the same frame.

    Args:
        left: Its shortest episode is shown, up to its fall.
        right: Its longest episode is shown, up to its end.
        steps: Control steps, at most.
        stride: Control steps per frame.
        size: Pixels per side of each half.

    Returns:
        ``(F, size, 2 size, 3)`` uint8; an episode that is too short begins with a still.
    """
    halves = []
    for found, episode in ((left, int(left.recording.length.argmin())), (right, longest(right))):
        last = int(found.recording.length[episode])
        # Counted from the end, so that the stride never skips the last pose.
        rows = np.arange(last, max(-1, last - steps), -stride)[::-1]
        qpos = found.recording.qpos[episode, rows]
        halves.append(pictures(qpos, width=size, height=size)[0])
    frames = max(len(half) for half in halves)
    padded = [np.concatenate([half[:1].repeat(frames - len(half), 0), half]) for half in halves]
    return np.concatenate(padded, axis=2)
