"""Actions by phase: what a plan of notebook 07 may begin at, joint by joint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from cassie_lib.errors import ShapeError
from cassie_lib.figures import COLUMN_WIDTH_IN
from cassie_lib.gait import GaitReference
from cassie_lib.plots.planning import TONES
from cassie_lib.robot.schema import ACTION_SIZE, MOTOR_NAMES, PERIOD

#: Hip roll, hip pitch, knee and foot of the left leg; the yaw hardly moves.
SHOWN_JOINTS = (0, 2, 3, 4)


def plot_action_cycles(
    cycles: Mapping[str, np.ndarray], reference: GaitReference
) -> tuple[Figure, Mapping[str, Any]]:
    """Actions of the left leg over one cycle; grey where the reference's left foot swings.

    Args:
        cycles: Actions by phase, ``(28, 10)`` rad, by label.
        reference: Gait that decides when the foot swings.

    Raises:
        ShapeError: If a cycle has another shape.
    """
    for label, cycle in cycles.items():
        if cycle.shape != (PERIOD, ACTION_SIZE):
            expected = (PERIOD, ACTION_SIZE)
            raise ShapeError(f"cycle {label!r} is {cycle.shape}: expected {expected}")
    figure, axes = plt.subplots(2, 2, figsize=(COLUMN_WIDTH_IN, 3.6), sharex=True)
    phase = np.arange(PERIOD)
    swing = np.flatnonzero(~reference.in_contact[:, 0])
    data: dict[str, Any] = {}
    for ax, joint in zip(axes.flat, SHOWN_JOINTS, strict=True):
        ax.axvspan(swing[0] - 0.5, swing[-1] + 0.5, color="0.9", lw=0, label="left foot swings")
        for label, cycle in cycles.items():
            ax.plot(phase, cycle[:, joint], label=label, color=TONES.get(label))
            data.setdefault(label, {"phase": phase})[MOTOR_NAMES[joint]] = cycle[:, joint]
        ax.set(title=MOTOR_NAMES[joint], xlim=(0, PERIOD - 1))
    for ax in axes[-1]:
        ax.set_xlabel("phase (control steps of 0.03 s)")
    for ax in axes[:, 0]:
        ax.set_ylabel("action (rad)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure, data


__all__ = ["SHOWN_JOINTS", "plot_action_cycles"]
