"""What planner-driven steps are measured by in notebooks 06 to 08, the expert's share left out."""

from __future__ import annotations

import numpy as np

from cassie_lib.planning.episodes import PlannedEpisodes
from cassie_lib.robot.schema import CONTROL_PERIOD_S, PERIOD
from cassie_lib.walking_report import WalkingReport, walking_report

#: A cycle counts as stepping when both feet were lifted so high in it.
STEP_LIFT_M = 0.05


def planner_report(found: PlannedEpisodes) -> WalkingReport:
    """Walking report of the steps that the planner drove.

    With a padded start the first two cycles are left out, as for the expert.
    """
    return walking_report(found.recording, begin=found.log.handover_step or 2 * PERIOD)


def stepping_share(found: PlannedEpisodes) -> np.ndarray:
    """Share of each episode's planner-driven cycles with both feet lifted 5 cm, ``(N,)``.

    NaN for an episode without a whole cycle.
    """
    recording, begin = found.recording, found.log.handover_step
    shares = np.full(len(recording.length), np.nan)
    for episode, length in enumerate(recording.length):
        height = recording.foot_height[episode, begin : int(length) + 1]
        cycles = len(height) // PERIOD
        if cycles:
            lift = height[: cycles * PERIOD].reshape(cycles, PERIOD, 2).max(axis=1)
            shares[episode] = np.mean((lift >= STEP_LIFT_M).all(axis=1))
    return shares


def side_speed(found: PlannedEpisodes, limit: int = 0) -> np.ndarray:
    """Mean sideways speed of each episode's planner-driven cycles, ``(N,)`` m/s, left positive.

    Whole cycles only, which leaves the sway out; NaN where fewer than two were completed.

    Args:
        found: Episodes of a planner.
        limit: Control steps, hand-over included, that count at most; 0 for all.
    """
    recording, begin = found.recording, found.log.handover_step
    cycles = (np.minimum(recording.length, limit or recording.length) - begin) // PERIOD
    position = recording.qpos[:, begin:, 1]
    whole = np.maximum(cycles, 0) * PERIOD
    travelled = position[np.arange(len(whole)), whole] - position[:, 0]
    speed = travelled / np.maximum(whole, 1) / CONTROL_PERIOD_S
    return np.where(cycles >= 2, speed, np.nan)


def median_episode(found: PlannedEpisodes) -> int:
    """Episode whose length is the median (the upper one of two)."""
    return int(np.argsort(found.recording.length, kind="stable")[len(found.planner_steps) // 2])
