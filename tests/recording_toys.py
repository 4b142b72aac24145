"""Synthetic recordings and planner episodes whose every number is known."""

from __future__ import annotations

import csv

import numpy as np

from cassie_lib.planning.control import PlanLog
from cassie_lib.planning.episodes import PlannedEpisodes
from cassie_lib.recording import Recording
from cassie_lib.reward import WEIGHTS
from cassie_lib.robot.schema import ACTION_SIZE, CLOCK, PERIOD, SPEED, STATE_SIZE, clock


def toy_recording(lengths, steps: int, reward=None, lift_m: float = 0.1, seed: int = 0):
    """N episodes; ``reward`` ``(N, T)`` is Eq 3.10, spread over its terms by their weights.

    Both feet rise to ``lift_m`` once per cycle; the states are white noise around one gait.
    """
    lengths = np.asarray(lengths)
    count, random = len(lengths), np.random.default_rng(seed)
    values = random.uniform(0.2, 0.9, (count, steps)) if reward is None else np.asarray(reward)
    phase = np.tile(np.arange(steps + 1) % PERIOD, (count, 1))
    states = np.random.default_rng(99).normal(size=(PERIOD, STATE_SIZE))[phase]
    states = states + 0.1 * random.normal(size=states.shape)
    states[..., 1:5] = [1.0, 0.0, 0.0, 0.0]
    states[..., CLOCK], states[..., SPEED] = clock(phase), 0.05
    height = np.stack([phase == 7, phase == 21], axis=-1) * lift_m
    qpos = np.zeros((count, steps + 1, 35))
    # Episode and row can be read from a configuration.
    qpos[..., 0], qpos[..., 1] = np.arange(count)[:, None], np.arange(steps + 1)
    long = (count, steps + 1, 2, 3)
    return Recording(
        states, 0.1 * random.normal(size=(count, steps, ACTION_SIZE)), qpos, np.zeros(long),
        height, random.normal(size=long), phase, {k: w * values for k, w in WEIGHTS.items()},
        lengths, 0.05, "a toy",
    )  # fmt: skip


def toy_trial(lengths, steps: int, handover: int = 0, horizon: int = 3, optimism: float = 0.0,
              **recording) -> PlannedEpisodes:  # fmt: skip
    """Planner episodes whose plans promise ``optimism`` more than what followed."""
    made = toy_recording(lengths, steps, **recording)
    rows = np.arange(steps)[:, None]
    planned = (rows >= handover) & (rows <= made.length)
    realised = np.where(planned & (rows < steps - horizon), 0.01 * rows + made.length, np.nan)
    known = np.where(planned, 0.01 * rows + made.length, np.nan)
    log = PlanLog(
        handover, np.where(planned.any(axis=1), 0.02, np.nan), planned, known + optimism, realised,
        np.zeros(planned.shape), np.zeros(planned.shape, int),
    )  # fmt: skip
    return PlannedEpisodes(made, log)


def lines(axes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What is drawn: x and y of every line with a label."""
    return {
        line.get_label(): (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in axes.get_lines()
    }


def band(axes, index: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge of a filled band, one value per place along x."""
    x, y = axes.collections[index].get_paths()[0].vertices.T
    places = np.unique(x)
    return (np.array([y[x == place].min() for place in places]),
            np.array([y[x == place].max() for place in places]))  # fmt: skip


def saved(path) -> dict[str, dict[str, list[float]]]:
    """Numbers of a plotted-data CSV by series and column."""
    found: dict[str, dict[str, list[float]]] = {}
    with path.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            series = found.setdefault(row.pop("series", ""), {})
            for name, value in row.items():
                if value:
                    series.setdefault(name, []).append(float(value))
    return found
