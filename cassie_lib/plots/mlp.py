"""Figures of notebook 04: learning curves of the baseline, and its errors beside no change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cassie_lib.dynamics.evaluation import CONSTANT, OpenLoop
from cassie_lib.dynamics.evaluation import GROUPS as ORDERS
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.figures import COLOURS, COLUMN_WIDTH_IN
from cassie_lib.plots.transformer import mark_increments, read_log
from cassie_lib.robot.schema import DERIVATIVE_ORDER, GROUPS, PHYSICAL, STATE_SIZE

Drawn = tuple[Figure, Mapping[str, Any]]
#: Metric name to (epochs, values).
Curves = Mapping[str, tuple[np.ndarray, np.ndarray]]
_COLOURS = {"train": "blue", "validation": "orange", "test": "vermillion"}
_LINES = {"train": "-", "validation": "--", "test": "-"}


def read_curves(path: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Read a training log: metric name to (epochs from 1, values).

    Raises:
        DataError: If it is no training log.
    """
    return {name: (found.epoch.astype(int), found.value) for name, found in read_log(path).items()}


def no_change_loss(result: OpenLoop, normalisation: Normalisation) -> np.ndarray:
    """Loss of predicting differences of zero at each step ``(T,)``, in units of the training loss.

    Mean over the 49 components of the squared error divided by the variance of the training
    data's one-step differences.
    """
    return _loss(result.no_difference, normalisation)


def model_loss(result: OpenLoop, normalisation: Normalisation) -> np.ndarray:
    """The same of the model, ``(T,)``: what the training log holds for the last epoch."""
    return _loss(result.difference, normalisation)


def _loss(errors: np.ndarray, normalisation: Normalisation) -> np.ndarray:
    spread = normalisation.difference_std.double().numpy()[PHYSICAL]
    return (errors / spread**2).sum(axis=1) / STATE_SIZE


def plot_single_step(runs: Sequence[Curves], no_change: Mapping[str, float]) -> Drawn:
    """Single-step learning curves (Figure 5.1): the loss, and the loss beside its first epoch.

    Args:
        runs: Curves of each seed: the median is drawn, and the range as a band.
        no_change: Loss of predicting no change on each set.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(COLUMN_WIDTH_IN, 2.6))
    table: dict[str, dict[str, np.ndarray]] = {}
    for name in _COLOURS:
        epochs = runs[0][f"{name}/state_prediction"][0]
        values = np.stack([curves[f"{name}/state_prediction"][1] for curves in runs])
        _band(left, name, epochs, values)
        _band(right, name, epochs, values / values[:, :1])
        table[name] = {
            "epoch": epochs, "median": np.median(values, axis=0), "low": values.min(axis=0),
            "high": values.max(axis=0), "no_change": np.full(len(epochs), no_change[name]),
        }  # fmt: skip
        left.axhline(no_change[name], color=COLOURS[_COLOURS[name]], linestyle=":", linewidth=0.9)
    left.set(yscale="log", xlabel="epoch", ylabel="loss, Eq 3.4 (normalised)")
    right.set(xlabel="epoch", ylabel="loss / loss after epoch 1")
    right.axhline(1.0, color="black", linestyle="-", linewidth=0.6)
    handles, labels = left.get_legend_handles_labels()
    handles.append(left.plot([], [], color="grey", linestyle=":", linewidth=0.9)[0])
    figure.legend(handles, [*labels, "predicting no change"], loc="outside upper center", ncols=4)
    return figure, table


def _band(axes: Axes, name: str, epochs: np.ndarray, values: np.ndarray) -> None:
    colour = COLOURS[_COLOURS[name]]
    axes.plot(epochs, np.median(values, axis=0), color=colour, linestyle=_LINES[name], label=name)
    axes.fill_between(epochs, values.min(axis=0), values.max(axis=0), color=colour, alpha=0.2)


def plot_curriculum(
    curves: Curves, losses: Mapping[str, np.ndarray], no_change: Mapping[str, np.ndarray]
) -> Drawn:
    """Learning curves over a growing number of predicted steps (Figure 5.2).

    Args:
        curves: Of the run; vertical lines mark one more predicted step.
        losses: Final loss at each predicted step ``(T,)`` by set.
        no_change: The same of predicting no change.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(COLUMN_WIDTH_IN, 2.6))
    table: dict[str, dict[str, np.ndarray]] = {}
    for name, colour in _COLOURS.items():
        epochs, values = curves[f"{name}/state_prediction"]
        left.plot(epochs, values, color=COLOURS[colour], linestyle=_LINES[name], label=name)
        table[f"{name} curve"] = {"epoch": epochs, "loss": values}
    begun = curves.get("increment", (np.array([]),))[0]
    # An increment after the last epoch begins a step that was never trained.
    mark_increments(left, begun[begun < epochs[-1]] + 0.5)
    for name in losses:
        steps = np.arange(1, len(losses[name]) + 1)
        colour = COLOURS[_COLOURS[name]]
        right.plot(steps, losses[name], color=colour, linestyle=_LINES[name], marker="o",
                   markersize=3)  # fmt: skip
        right.plot(steps, no_change[name], color=colour, linestyle=":", linewidth=0.9)
        table[f"{name} by step"] = {
            "step": steps, "loss": losses[name], "no_change": no_change[name]
        }  # fmt: skip
    left.set(yscale="log", xlabel="epoch", ylabel="loss, Eq 3.6 (normalised)")
    right.set(yscale="log", xlabel="predicted step (0.03 s each)", ylabel="final loss of that step")
    handles, labels = left.get_legend_handles_labels()
    handles.append(left.plot([], [], color="grey", linestyle=":", linewidth=0.9)[0])
    figure.legend(handles, [*labels, "predicting no change"], loc="outside upper center", ncols=3)
    return figure, table


def plot_group_errors(results: Mapping[str, Mapping[str, OpenLoop]]) -> Drawn:
    """Error of positions, velocities and accelerations relative to their variance, by step.

    Args:
        results: Set name to model label to its errors, two sets and up to three models.  Sets
            differ by line, models by colour; predicting no change is black.
    """
    figure, panels = plt.subplots(1, 3, figsize=(COLUMN_WIDTH_IN, 2.5), sharey=True)
    table: dict[str, dict[str, np.ndarray]] = {}
    colours = [COLOURS[name] for name in ("blue", "vermillion", "green")]
    handles: list[Any] = []
    for line, (set_name, models) in zip((":", "-"), results.items(), strict=True):
        drawn = {label: result.model for label, result in models.items()}
        result = next(iter(models.values()))
        drawn["no change"] = result.no_change
        for colour, (label, errors) in zip([*colours[: len(models)], "black"], drawn.items(),
                                           strict=True):  # fmt: skip
            column = _by_order(errors, result.variance)
            # The first model is drawn wider: where another covers it, its edges still show.
            width = 3.0 if label == next(iter(drawn)) else 1.2
            for axes, values in zip(panels, list(column.values())[1:], strict=True):
                curve = axes.plot(column["step"], values, color=colour, linestyle=line,
                                  linewidth=width, label=label)  # fmt: skip
            table[f"{label}, {set_name}"] = column
            handles += curve if line == "-" else []
        handles += panels[0].plot([], [], color="grey", linestyle=line, label=f"{set_name} set")
    panels[0].set(yscale="log", ylabel="squared error / variance")
    for axes, group in zip(panels, ORDERS, strict=True):
        axes.set_title(group)
        axes.set_xlabel("predicted step")
        mean = axes.axhline(1.0, color="0.3", ls="-.", lw=0.8, label="predicting the mean")
    handles.append(mean)
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure, table


def _by_order(errors: np.ndarray, variance: np.ndarray) -> dict[str, np.ndarray]:
    """Mean squared errors ``(T, 46)`` over variance, averaged per derivative order."""
    column: dict[str, np.ndarray] = {"step": np.arange(1, len(errors) + 1)}
    for group, order in ORDERS.items():
        chosen = (variance > CONSTANT) & (DERIVATIVE_ORDER[PHYSICAL] == order)
        column[group] = (errors[:, chosen] / variance[chosen]).mean(axis=1)
    return column


def error_table(result: OpenLoop, mean_gait: OpenLoop, step: int) -> str:
    """Markdown table of root mean square errors per row of Table 4.1, in its unit.

    Args:
        result: Errors of a model.
        mean_gait: Errors of :class:`~cassie_lib.plots.mean_gait.MeanGait` on the same windows.
        step: Predicted step, from 1.
    """
    lines = [
        f"| group, step {step} | unit | model | mean gait | no change | model² / variance |",
        "|---|---|---|---|---|---|",
    ]
    for group in GROUPS:
        if group.slice.start >= PHYSICAL.stop:
            continue
        errors = (result.model, mean_gait.model, result.no_change)
        model, gait, none = (part[step - 1, group.slice] for part in errors)
        variance = result.variance[group.slice]
        varying = variance > CONSTANT
        ratio = model[varying] / variance[varying]
        relative = f"{ratio.mean():.3g}" if len(ratio) else "constant"
        lines.append(
            f"| {group.name} | {group.unit} | {np.sqrt(model.mean()):.3g} "
            f"| {np.sqrt(gait.mean()):.3g} | {np.sqrt(none.mean()):.3g} | {relative} |"
        )
    return "\n".join(lines) + "\n"
