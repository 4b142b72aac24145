"""Learning curves of notebook 05: Figures 5.3 to 5.5, A.1 and A.2, two models on the same axes."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure

from cassie_lib.errors import DataError
from cassie_lib.figures import COLOURS, COLUMN_WIDTH_IN

Drawn = tuple[Figure, Mapping[str, Any]]
THESIS_LABEL, CAUSAL_LABEL = "thesis architecture", "causal model"


class Curve(NamedTuple):
    """One metric of a training log.

    Attributes:
        epoch: Passes over the data, from 1; always 1 in a training that does not count them.
        minutes: Training time, wall clock.
        value: The metric.
    """

    epoch: np.ndarray
    minutes: np.ndarray
    value: np.ndarray


Log = Mapping[str, Curve]


def read_log(path: Path) -> dict[str, Curve]:
    """Read a training log: curves by metric.

    Raises:
        DataError: If it is no training log.
    """
    found: dict[str, list[tuple[float, float, float]]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                values = (int(row["epoch"]) + 1, float(row["seconds"]) / 60, float(row["value"]))
                found.setdefault(row["metric"], []).append(values)
        if not found:
            raise ValueError("no row")
    except (OSError, KeyError, TypeError, ValueError):
        raise DataError(f"{path.name} cannot be read: expected a training log") from None
    return {name: Curve(*np.array(rows).T) for name, rows in found.items()}


def mark_increments(axes: Axes, places: Iterable[float]) -> None:
    """Draw a vertical line wherever one more step is predicted from then on.

    The thesis draws them red; black dots are as plain in print and to the colour-blind.

    Args:
        axes: Where to draw.
        places: Of the increments, on the horizontal axis.
    """
    label = "one step more is predicted"
    for place in places:
        axes.axvline(place, color="black", linestyle=(0, (1, 1.5)), linewidth=1.1, label=label)
        label = "_"  # the legend names them once


def _increments(log: Log) -> np.ndarray:
    """Minutes at which a log's horizon grew; none in a log without a curriculum."""
    return log["increment"].minutes if "increment" in log else np.array([])


def add_epochs(axes: Axes, log: Log) -> None:
    """Tell the epochs of a log along the upper edge; they get longer with every predicted step."""
    epoch, minutes = log["horizon"].epoch, log["horizon"].minutes
    ticks = np.unique(np.linspace(0, len(epoch) - 1, 5).astype(int))
    above = axes.secondary_xaxis("top")
    above.set_xticks(minutes[ticks], [f"{value:.0f}" for value in epoch[ticks]])
    above.set_xlabel(f"epochs of the {THESIS_LABEL}", fontsize=7)


def plot_state_prediction(
    thesis: Log, causal: Log, other: str, thesis_values: Mapping[str, float]
) -> Drawn:
    """Train against another set, Eq 3.6 in raw units (Figure 5.3: test, 5.4: validation).

    Args:
        thesis: Log of the thesis's architecture; the loss covers the steps predicted by then.
        causal: Log of the causal model; the loss always covers all steps.
        other: ``"test"`` or ``"validation"``.
        thesis_values: The thesis's final losses by set, drawn as dotted lines.
    """
    figure, axes = plt.subplots(figsize=(COLUMN_WIDTH_IN, 3.3))
    table: dict[str, dict[str, np.ndarray]] = {}
    styles = {"train": "-", other: "--"}
    for label, log, colours in (
        (THESIS_LABEL, thesis, ("blue", "vermillion")),
        (CAUSAL_LABEL, causal, ("green", "orange")),
    ):
        for (name, line), colour in zip(styles.items(), colours, strict=True):
            curve = log[f"{name}/state_prediction_raw"]
            axes.plot(curve.minutes, curve.value, color=COLOURS[colour], linestyle=line,
                      label=f"{label}, {name}")  # fmt: skip
            table[f"{label}, {name}"] = curve._asdict()
    for name, line in styles.items():
        value = thesis_values[name]
        axes.axhline(value, color="0.4", linestyle=":" if line == "--" else "-.", linewidth=0.9,
                     label=f"thesis's {name}, {value:g} (unit unknown)")  # fmt: skip
    mark_increments(axes, _increments(thesis))
    add_epochs(axes, thesis)
    axes.set(yscale="log", xlabel="training time (min, 1 core)", ylabel="Eq 3.6, raw units")
    figure.legend(loc="outside lower center", ncols=2)
    return figure, table


def plot_penalised(log: Log) -> Drawn:
    """Training loss of Eq 3.9 and its two parts (Figure 5.5), in the units of training.

    Args:
        log: Log of the thesis's architecture.
    """
    figure, axes = plt.subplots(figsize=(COLUMN_WIDTH_IN, 3.0))
    table: dict[str, dict[str, np.ndarray]] = {}
    for metric, label, colour, line in (
        ("penalised", "Eq 3.9 (the sum)", "black", "-"),
        ("state_prediction", "state prediction (Eq 3.6)", "blue", "--"),
        ("gradient_penalty", "penalty, before λ", "orange", "-."),
    ):
        curve = log[f"train/{metric}"]
        axes.plot(curve.minutes, curve.value, color=COLOURS[colour], linestyle=line, label=label)
        table[metric] = curve._asdict()
    mark_increments(axes, _increments(log))
    add_epochs(axes, log)
    axes.set(yscale="log", xlabel="training time (min, 1 core)", ylabel="loss (normalised)")
    figure.legend(loc="outside lower center", ncols=3)
    return figure, table


def plot_steps(thesis: Log, causal: Log, name: str) -> Drawn:
    """Loss of each predicted step, both models on the same axes (A.1: train, A.2: validation).

    Args:
        thesis: Log of the thesis's architecture; a step has a curve from its increment on.
        causal: Log of the causal model.
        name: ``"train"``, ``"validation"`` or ``"test"``.
    """
    figure, panels = plt.subplots(1, 2, figsize=(COLUMN_WIDTH_IN, 3.0), sharex=True, sharey=True)
    table: dict[str, dict[str, np.ndarray]] = {}
    prefix = f"{name}/raw_step_"
    logs = {THESIS_LABEL: thesis, CAUSAL_LABEL: causal}
    steps = sorted({int(key[len(prefix) :]) for log in logs.values() for key in log
                    if key.startswith(prefix)})  # fmt: skip
    # The last shades of viridis are too bright for white paper.
    shades = plt.get_cmap("viridis")(np.linspace(0.0, 0.92, len(steps)))
    for axes, (label, log) in zip(panels, logs.items(), strict=True):
        for step, shade in zip(steps, shades, strict=True):
            if (curve := log.get(f"{prefix}{step}")) is not None:
                axes.plot(curve.minutes, curve.value, color=shade, linestyle="-", linewidth=1.0,
                          marker="." if len(curve.value) == 1 else None)  # fmt: skip
                table[f"{label}, step {step}"] = curve._asdict()
        axes.set(yscale="log", xlabel="training time (min, 1 core)", title=label)
    mark_increments(panels[0], _increments(thesis))
    panels[0].set_ylabel(f"{name}, summand of Eq 3.6, raw units")
    edges = np.append(np.array(steps) - 0.5, steps[-1] + 0.5)
    scale = plt.cm.ScalarMappable(BoundaryNorm(edges, len(steps)), ListedColormap(shades))
    figure.colorbar(scale, ax=panels, label="predicted step", ticks=steps, pad=0.01)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center")
    return figure, table


__all__ = [
    "CAUSAL_LABEL",
    "THESIS_LABEL",
    "Curve",
    "Log",
    "mark_increments",
    "plot_penalised",
    "plot_state_prediction",
    "plot_steps",
    "read_log",
]
