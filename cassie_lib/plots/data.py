"""Figures of notebook 03: the collection pipeline, noise, coverage and shift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from cassie_lib.data.episodes import Episodes
from cassie_lib.figures import COLOURS, COLUMN_WIDTH_IN
from cassie_lib.plots.data_statistics import (
    GaitCloud,
    NoiseLevel,
    Projection,
    foot_paths,
    occupied_cells,
    settled,
)

Drawn = tuple[Figure, Mapping[str, Any]]
_SETS = ("wide", "train", "validation", "test")
_SET_COLOURS = dict(zip(_SETS, ("sky", "blue", "orange", "vermillion"), strict=True))

# Boxes of Figure 4.4: place (x, y) of the middle, text.
_BOXES = {
    "s0": (0.05, 0.62, "$s_0$\nApp. A.3"),
    "policy": (0.27, 0.62, "expert $\\pi^*$\nLSTM"),
    "sum": (0.52, 0.62, "$+$"),
    "noise": (0.52, 0.12, "$\\mathcal{N}(0, \\sigma^2)$\nevery component"),
    "robot": (0.84, 0.62, "MuJoCo, PD drive\n60 steps of 0.5 ms"),
    "data": (0.84, 0.12, "data set $\\mathcal{D}$\n+ forces, feet, phase"),
}
# Arrows: from, to, text beside it, place of the text.
_ARROWS = (
    ("s0", "policy", "$s_t$", (0.15, 0.66)),
    ("policy", "sum", "$a_t$", (0.43, 0.66)),
    ("noise", "sum", "", (0.0, 0.0)),
    ("sum", "robot", "$\\hat a_t$", (0.62, 0.66)),
    ("robot", "data", "$(s_t, \\hat a_t)$", (0.86, 0.37)),
)


def draw_pipeline() -> Drawn:
    """The collection pipeline as the thesis draws it (Figure 4.4)."""
    figure, axes = plt.subplots(figsize=(COLUMN_WIDTH_IN, 2.0))
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.axis("off")
    boxes = {}
    for name, (x, y, text) in _BOXES.items():
        style = "circle,pad=0.25" if name == "sum" else "round,pad=0.45"
        boxes[name] = axes.text(
            x, y, text, ha="center", va="center", fontsize=8,
            bbox={"boxstyle": style, "facecolor": "white", "edgecolor": COLOURS["blue"]},
        )  # fmt: skip
    for start, end, text, place in _ARROWS:
        _arrow(axes, boxes, start, end)
        axes.text(*place, text, ha="left", va="bottom" if place[1] > 0.5 else "center")
    # s_{t+1} goes back to the policy above the boxes.
    left, right, top = _BOXES["policy"][0], _BOXES["robot"][0], 0.92
    # From the middle of the box, which covers the line's first part.
    path = [_BOXES["robot"][1], top, top]
    axes.plot([right, right, left], path, "-", color="black", linewidth=1, zorder=1)
    axes.annotate("", xy=_BOXES["policy"][:2], xytext=(left, top + 0.005),
                  arrowprops=_arrow_style(patchB=boxes["policy"].get_bbox_patch()))  # fmt: skip
    axes.text((left + right) / 2, top - 0.02, "$s_{t+1}$ every 0.03 s, until a fall or the limit",
              ha="center", va="top", fontsize=7.5)  # fmt: skip
    edges = [*((a, b, t) for a, b, t, _ in _ARROWS), ("robot", "policy", "$s_{t+1}$")]
    columns = zip(("from", "to", "quantity"), zip(*edges, strict=True), strict=True)
    return figure, {name: list(values) for name, values in columns}


def _arrow(axes: Axes, boxes: Mapping[str, Any], start: str, end: str) -> None:
    axes.annotate(
        "", xy=_BOXES[end][:2], xytext=_BOXES[start][:2],
        arrowprops=_arrow_style(
            patchA=boxes[start].get_bbox_patch(), patchB=boxes[end].get_bbox_patch()
        ),
    )  # fmt: skip


def _arrow_style(**patches) -> dict[str, Any]:
    """An arrow that begins and ends at the edges of the boxes it joins."""
    return {"arrowstyle": "->", "shrinkA": 0, "shrinkB": 0, **patches}


def plot_noise(levels: Sequence[NoiseLevel], study: Episodes, shown: Sequence[float]) -> Drawn:
    """Falls and spread of the feet against sigma, and the left foot's path at some levels.

    Args:
        levels: From :func:`~cassie_lib.plots.data_statistics.noise_levels`.
        study: The episodes behind them.
        shown: Noise levels whose foot paths are drawn, rad.
    """
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(COLUMN_WIDTH_IN, 2.4))
    sigma = np.array([level.noise_std_rad for level in levels])
    share = np.array([level.falls / level.episodes for level in levels])
    bounds = np.array([level.interval for level in levels]).T
    spread = np.array([level.foot_spread_m for level in levels])
    bars = np.abs(bounds - share) * 100.0
    left.errorbar(sigma, 100 * share, bars, marker="o", markersize=3, capsize=2)
    left.set(xlabel="action noise $\\sigma$ (rad)", ylabel="episodes that fall (%)",
             ylim=(-3, 103))  # fmt: skip
    middle.plot(sigma, 1e3 * spread, marker="o", markersize=3)
    middle.set(xlabel="action noise $\\sigma$ (rad)", ylabel="foot path spread, RMS (mm)",
               ylim=(0, None))  # fmt: skip
    for level, colour in zip(reversed(sorted(shown)), ("sky", "orange", "black"), strict=False):
        x, z = _left_foot_path(study, level)
        right.plot(1e2 * x, 1e2 * z, color=COLOURS[colour], linestyle="-", linewidth=0.5,
                   alpha=0.7, label=f"$\\sigma$ = {level:g} rad")  # fmt: skip
    right.set(xlabel="foot fore-aft (cm)", ylabel="left sole height (cm)")
    handles, labels = right.get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside upper right", ncols=3, title="(c)")
    for handle in legend.get_lines():
        handle.set(linewidth=1.5, alpha=1.0)  # as thin as the paths they could not be told apart
    for axes, letter in zip((left, middle, right), "abc", strict=True):
        axes.set_title(f"({letter})", loc="left")
    data = {
        "noise_std_rad": sigma, "episodes": [level.episodes for level in levels],
        "falls": [level.falls for level in levels], "share": share, "low": bounds[0],
        "high": bounds[1], "median_steps": [level.median_steps for level in levels],
        "foot_spread_m": spread,
    }  # fmt: skip
    return figure, data


def _left_foot_path(study: Episodes, level: float, steps: int = 280) -> tuple[np.ndarray, ...]:
    """Path of the left foot in the longest episode of a level, settled part, ten cycles."""
    at_level = np.asarray(study.noise_std_rad) == level
    episode = int(np.argmax(np.where(at_level, study.episode_lengths, -1)))
    rows = study.rows(episode)
    chosen = np.arange(rows.start, rows.stop)[settled(study)[rows]][:steps]
    path = foot_paths(study)[chosen, 0]
    return path[:, 0], path[:, 2]


def plot_coverage(
    projection: Projection, sets: Mapping[str, Episodes], points: int = 4000
) -> Drawn:
    """States of each set on the first two principal components, and the cells that they occupy.

    The last samples before a fall are left out: they are wide, but nobody walks there.

    Args:
        projection: Fitted on the training set.
        sets: Data sets by name, widest first: later ones are drawn on top.
        points: Points per set; the cells are counted on as many samples of each.
    """
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(COLUMN_WIDTH_IN, 2.9), width_ratios=(1.6, 1)
    )
    kept = {name: episodes.states[~np.asarray(episodes.falling)] for name, episodes in sets.items()}
    kept = {name: values for name, values in kept.items() if len(values)}
    count = min(points, *(len(values) for values in kept.values()))
    table, cells = {}, []
    for name, values in kept.items():
        coordinates = projection(np.asarray(values))
        chosen = coordinates[np.linspace(0, len(coordinates) - 1, count).astype(int)]
        left.plot(chosen[:, 0], chosen[:, 1], ".", markersize=1.2, alpha=0.5, rasterized=True,
                  color=COLOURS[_SET_COLOURS[name]], label=name)  # fmt: skip
        cells.append(occupied_cells(coordinates, count))
        table[name] = {f"pc{k + 1}": chosen[:, k].round(4) for k in range(chosen.shape[1])}
    percent = 100 * projection.explained
    left.set(xlabel=f"principal component 1 ({percent[0]:.0f} % of variance)",
             ylabel=f"principal component 2 ({percent[1]:.0f} %)")  # fmt: skip
    left.legend(markerscale=8, handletextpad=0.2)
    colours = [COLOURS[_SET_COLOURS[name]] for name in kept]
    right.barh(list(kept), cells, color=colours)
    right.set(xlabel=f"cells (0.5 × 0.5) occupied\nby {count:,} states of each")
    right.invert_yaxis()
    return figure, table


def plot_shift(pairs: Mapping[str, tuple[Episodes, Episodes]]) -> Drawn:
    """Distance from the mean gait of the training set: over all samples, and per component group.

    Args:
        pairs: Training and test set by label; the first is drawn in blue, the second in red.
    """
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(COLUMN_WIDTH_IN, 3.0), width_ratios=(1, 1.1)
    )
    table: dict[str, dict[str, Any]] = {}
    quantiles = np.linspace(0.0, 1.0, 201)
    for index, (label, (train, test)) in enumerate(pairs.items()):
        colour = COLOURS[("blue", "vermillion")[index]]
        cloud = GaitCloud(train)
        for name, episodes, line in (("train", train, "-"), ("test", test, "--")):
            distance = np.quantile(cloud.distance(episodes), quantiles)
            left.plot(distance, 100 * quantiles, color=colour, linestyle=line,
                      label=f"{label}: {name}")  # fmt: skip
            table[f"{label} {name}"] = {"quantile": quantiles, "distance": distance}
        groups = cloud.group_distance(test)
        rows = np.arange(len(groups)) + 0.24 * (2 * index - 1)
        right.plot(list(groups.values()), rows, "o", color=colour)
        table[f"{label} groups"] = {"group": list(groups), "distance": list(groups.values())}
    left.set(
        xscale="log", ylabel="samples within (%),\nstart of episodes left out",
        xlabel="distance from the training set's\nmean gait (1: typical of that set)",
    )  # fmt: skip
    right.axvline(1.0, color="black", linestyle="-", linewidth=0.8)
    right.set_yticks(np.arange(len(groups)), list(groups), fontsize=6.5)
    right.invert_yaxis()
    right.set(xscale="log", xlabel="distance of the test set, per group\n(training set: 1)")
    for axes in (left, right):
        axes.xaxis.set_major_locator(LogLocator(10, subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels))
    return figure, table
