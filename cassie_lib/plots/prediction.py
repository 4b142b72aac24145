"""Open-loop errors of notebook 05, the ghost beside the robot, and the effects of the grid."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from cassie_lib.dynamics.evaluation import CONSTANT, OpenLoop
from cassie_lib.dynamics.imagination import Imagined
from cassie_lib.figures import COLOURS, COLUMN_WIDTH_IN
from cassie_lib.grid_search import FACTORS
from cassie_lib.robot.rendering import pictures
from cassie_lib.robot.schema import CONTROL_PERIOD_S, GROUPS, PHYSICAL

Drawn = tuple[Figure, Mapping[str, Any]]
#: Set name to model label to errors.
Results = Mapping[str, Mapping[str, OpenLoop]]
_MODELS = (("blue", "-", "o"), ("green", "--", "s"), ("purple", "-.", "^"))
NO_CHANGE = "no change"


def relative_table(results: Results) -> pd.DataFrame:
    """Errors relative to the variance at every predicted step: one row per set and model."""
    rows = []
    for name, models in results.items():
        found = {label: result.relative for label, result in models.items()}
        found[NO_CHANGE] = next(iter(models.values())).relative_no_change
        for label, relative in found.items():
            steps = {f"step {i + 1}": f"{value:.2g}" for i, value in enumerate(relative)}
            rows.append({"set": name, "model": label, **steps})
    return pd.DataFrame(rows).set_index(["set", "model"])


def thesis_metric_table(results: Results, thesis_values: Mapping[str, float]) -> pd.DataFrame:
    """Eq 3.6 with w = 1, 2, 5 over all predicted steps, as mean and as sum over components.

    Args:
        results: Errors by set and model.
        thesis_values: The thesis's numbers for some of the sets.
    """
    rows = []
    for name, models in results.items():
        for label, result in models.items():
            rows.append({
                "set": name, "model": label,
                "thesis": thesis_values.get(name, np.nan),
                "raw, mean of 49": result.thesis_loss(),
                "raw, sum": result.thesis_loss(reduction="sum"),
                "normalised, mean of 49": result.thesis_loss(units="normalised"),
            })  # fmt: skip
    return pd.DataFrame(rows).set_index(["set", "model"])


def target_lines(models: Mapping[str, OpenLoop], targets: Mapping[int, float]) -> str:
    """Lines of text: relative error of each model and of no change beside each target."""
    lines = []
    for step, target in targets.items():
        found = {label: result.relative[step - 1] for label, result in models.items()}
        found[NO_CHANGE] = next(iter(models.values())).relative_no_change[step - 1]
        words = ", ".join(f"{label} {value:.2g}" for label, value in found.items())
        lines.append(f"error / variance at step {step}, target {target:g}: {words}")
    return "\n".join(lines)


def plot_relative_errors(results: Results, targets: Mapping[int, float]) -> Drawn:
    """Error relative to the variance by predicted step, one panel per set.

    Args:
        results: Errors by set and model.
        targets: Bound by step, drawn in the first panel.
    """
    figure, panels = plt.subplots(
        1, len(results), figsize=(COLUMN_WIDTH_IN, 2.5), sharey=True, squeeze=False
    )
    table: dict[str, dict[str, np.ndarray]] = {}
    for axes, (name, models) in zip(panels[0], results.items(), strict=True):
        for (label, result), style in zip(models.items(), _MODELS, strict=False):
            steps, (colour, line, marker) = np.arange(1, len(result.relative) + 1), style
            axes.plot(steps, result.relative, color=COLOURS[colour], linestyle=line,
                      marker=marker, markersize=2.5, label=label)  # fmt: skip
            table[f"{label}, {name}"] = {"step": steps, "relative": result.relative}
        still = result.relative_no_change
        axes.plot(steps, still, color="black", linestyle=":", label=NO_CHANGE)
        table[f"{NO_CHANGE}, {name}"] = {"step": steps, "relative": still}
        axes.set(yscale="log", xlabel="predicted step", xticks=[1, 5, 10])
        axes.set_title(name, fontsize=7.5)
    panels[0, 0].plot([*targets], [*targets.values()], "_", color="red", markersize=9,
                      markeredgewidth=1.5, label="target")  # fmt: skip
    panels[0, 0].set_ylabel("squared error / variance")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return figure, table


def plot_group_errors(models: Mapping[str, OpenLoop], steps: Sequence[int]) -> Drawn:
    """Error relative to the variance of each row of Table 4.1, one panel per predicted step.

    Args:
        models: Errors of each model on one set.
        steps: Predicted steps, from 1.
    """
    groups = [group for group in GROUPS if group.slice.start < PHYSICAL.stop]
    names = [group.name.replace("unactuated ", "") for group in groups]
    figure, panels = plt.subplots(
        1, len(steps), figsize=(COLUMN_WIDTH_IN, 2.7), sharex=True, sharey=True, squeeze=False
    )
    table: dict[str, dict[str, Any]] = {}
    for axes, step in zip(panels[0], steps, strict=True):
        lines = {label: (result.model, *style) for (label, result), style
                 in zip(models.items(), _MODELS, strict=False)}  # fmt: skip
        result = next(iter(models.values()))
        lines[NO_CHANGE] = (result.no_change, "black", "", "x")
        for label, (errors, colour, _, marker) in lines.items():
            values = [_relative(errors[step - 1], result.variance, group.slice) for group in groups]
            axes.plot(values, names, marker, color=COLOURS[colour], markersize=4, label=label)
            table[f"{label}, step {step}"] = {"group": names, "relative": values}
        axes.set(xscale="log", xlabel="squared error / variance", title=f"step {step}")
    panels[0, 0].invert_yaxis()
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure, table


def _relative(errors: np.ndarray, variance: np.ndarray, part: slice) -> float:
    varying = variance[part] > CONSTANT
    return float(np.mean(errors[part][varying] / variance[part][varying]))


def ghost_frames(found: Imagined, size: int = 360) -> tuple[np.ndarray, str]:
    """Frames ``(T + 1, size, size, 3)`` of the true robot and the imagined one, and how made."""
    return pictures(found.qpos, ghost=found.ghost, width=size, height=size, azimuth_deg=110.0)


def plot_ghosts(motions: Mapping[str, Imagined], count: int = 5) -> Drawn:
    """Strip of pictures: the robot as it moved, and in orange as each model imagined it.

    Args:
        motions: Imagined motions by model; all of one length.
        count: Pictures per model, evenly spread over the motion.
    """
    figure, panels = plt.subplots(
        len(motions), count, figsize=(COLUMN_WIDTH_IN, 1.45 * len(motions)), squeeze=False
    )
    table: dict[str, dict[str, np.ndarray]] = {}
    for row, (label, found) in zip(panels, motions.items(), strict=True):
        steps = np.linspace(0, len(found.qpos) - 1, count).round().astype(int)
        chosen = Imagined(*(part[steps] for part in (found.states, found.predicted, found.qpos,
                                                     found.ghost)))  # fmt: skip
        for axes, frame, step in zip(row, ghost_frames(chosen)[0], steps, strict=True):
            axes.imshow(frame)
            axes.set(xticks=[], yticks=[])
            axes.grid(visible=False)
            centimetres = 100 * found.pelvis_distance_m[step]
            axes.set_xlabel(f"pelvis {centimetres:.1f} cm off", fontsize=6)
            if row[0] is panels[0, 0]:
                axes.set_title(f"{CONTROL_PERIOD_S * step:.2f} s", fontsize=7.5)
        row[0].set_ylabel(label, fontsize=7)
        time = CONTROL_PERIOD_S * np.arange(len(found.qpos))
        table[label] = {"time_s": time, "pelvis_distance_m": found.pelvis_distance_m,
                        "joint_error_rad": found.joint_error_rad}  # fmt: skip
    return figure, table


def plot_grid_effects(rows: Sequence[Mapping[str, Any]]) -> Drawn:
    """Validation loss of the points that differ in one factor, beside the thesis's choice.

    Args:
        rows: Of :func:`~cassie_lib.grid_search.score_table`; those without a change are the
            choice with several seeds, whose range is the band.
    """
    figure, panels = plt.subplots(
        1, len(FACTORS), figsize=(COLUMN_WIDTH_IN, 2.5), sharey=True, squeeze=False
    )
    base = [row for row in rows if not row["changed"]]
    losses = np.array([row["one_step_loss"] for row in base])
    centre = np.median(losses)
    table: dict[str, dict[str, Any]] = {"the thesis's choice": {"seed": [r["seed"] for r in base],
                                        "loss": losses}}  # fmt: skip
    for axes, factor in zip(panels[0], FACTORS, strict=True):
        near = [row for row in rows if row["changed"].startswith(factor)]
        values = sorted([(row[factor], row["one_step_loss"]) for row in near]
                        + [(base[0][factor], centre)])  # fmt: skip
        axes.axhspan(losses.min() / centre, losses.max() / centre, color="0.85")
        axes.plot([f"{value:g}" for value, _ in values], [loss / centre for _, loss in values],
                  "o-", color=COLOURS["blue"], markersize=4)  # fmt: skip
        axes.plot([f"{base[0][factor]:g}"], [1.0], "o", color=COLOURS["vermillion"], markersize=5)
        axes.set(yscale="log", xlabel=factor.replace("_", " "))
        axes.tick_params(axis="x", labelsize=6)
        table[factor] = {"value": [v for v, _ in values], "loss": [loss for _, loss in values]}
    panels[0, 0].set_ylabel("validation loss /\nthat of the thesis's choice")
    return figure, table


__all__ = [
    "ghost_frames",
    "plot_ghosts",
    "plot_grid_effects",
    "plot_group_errors",
    "plot_relative_errors",
    "relative_table",
    "target_lines",
    "thesis_metric_table",
]
