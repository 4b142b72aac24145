"""Figure of notebook 07: what a plan costs in time, and a gradient in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

from cassie_lib.figures import COLOURS, COLUMN_WIDTH_IN
from cassie_lib.planning.cost_sweep import GradientCost, Sweep

_SYMBOLS = {"tau": "τ"}


def plot_costs(
    sweeps: Sequence[Sweep], gradients: Sequence[GradientCost]
) -> tuple[Figure, Mapping[str, Any]]:
    """Time of a plan against N, tau and H; memory and time of gradients on K and on N."""
    figure, axes = plt.subplots(2, 2, figsize=(COLUMN_WIDTH_IN, 4.2))
    data: dict[str, dict[str, Any]] = {}
    labels = {"N": "samples N", "tau": "horizon τ (control steps)", "H": "context H (states)"}
    for ax, sweep in zip(axes.flat, sweeps, strict=False):
        ax.loglog(sweep.values, 1e3 * sweep.seconds, "o-", color=COLOURS["blue"], ms=4)
        linear = 1e3 * sweep.seconds[-1] * sweep.values / sweep.values[-1]
        ax.loglog(sweep.values, linear, ":", color="0.5", label="proportional")
        ax.set_xticks(sweep.values, [str(value) for value in sweep.values])
        # A few hundred milliseconds hold one power of ten at most: 1, 2 and 5 of each are named.
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.minorticks_off()
        ax.set(xlabel=labels[sweep.name], ylabel="one plan, C = 1 (ms)")
        ax.set_title(f"time ∝ {_SYMBOLS.get(sweep.name, sweep.name)}$^{{{sweep.exponent:.2f}}}$")
        ax.legend()
        data[f"plan against {sweep.name}"] = {"value": sweep.values, "seconds": sweep.seconds}
    ax, places = axes[1, 1], np.arange(len(gradients))
    memory = [item.memory_bytes / 1e6 for item in gradients]
    bars = ax.bar(places, memory, 0.55, color=COLOURS["blue"])
    times = [f"{item.seconds:.2g} s" for item in gradients]
    texts = [f"{size:.3g} MB\n{time}" for size, time in zip(memory, times, strict=True)]
    ax.bar_label(bars, texts, fontsize=7)
    ax.set_xticks(places, [f"{item.sequences} sequences" for item in gradients])
    ax.set(ylabel="memory held (MB)", title="one gradient of the return")
    ax.set_ylim(0.0, 1.25 * max(memory))  # room for the two lines over a bar
    data["gradient"] = {
        "sequences": [item.sequences for item in gradients],
        "memory_bytes": [item.memory_bytes for item in gradients],
        "seconds": [item.seconds for item in gradients],
    }
    return figure, data


__all__ = ["plot_costs"]
