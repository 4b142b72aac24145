"""Bursts: between them the controller is untouched, inside them errors point the same way."""

from __future__ import annotations

import numpy as np
import pytest

from cassie_lib.controllers import Observation, StandStill
from cassie_lib.data import Bursts
from cassie_lib.errors import ParameterError
from cassie_lib.presets import BurstParameters

HELD = np.linspace(-0.2, 0.2, 10)
ROBOTS, STEPS = 64, 300


def disturbance(parameters: BurstParameters, seed: int = 0) -> np.ndarray:
    """What is added to a constant action: ``(steps, robots, 10)``."""
    controller = Bursts(StandStill(HELD), parameters)
    controller.reset(ROBOTS, seed)
    rows = []
    for step in range(STEPS):
        observation = Observation(
            np.zeros((ROBOTS, 49)), np.zeros((ROBOTS, 68)), np.zeros(ROBOTS, dtype=int),
            np.zeros((ROBOTS, 3)), step,
        )  # fmt: skip
        rows.append(controller.act(observation) - HELD)
    return np.array(rows)


def runs(flags: np.ndarray) -> tuple[list[int], list[int]]:
    """Lengths of the whole stretches of true and of false values in a row of flags."""
    edges = np.flatnonzero(np.diff(flags.astype(int))) + 1
    lengths = np.diff(edges)
    first = bool(flags[edges[0]]) if len(edges) else False
    return list(lengths[0 if first else 1 :: 2]), list(lengths[1 if first else 0 :: 2])


@pytest.fixture(scope="module")
def added():
    return disturbance(BurstParameters())


def test_bursts_and_pauses_last_as_long_as_they_may(added):
    parameters = BurstParameters()
    found: tuple[list[int], list[int]] = [], []
    for robot in range(ROBOTS):
        for lengths, more in zip(found, runs(np.any(added[:, robot] != 0.0, axis=-1)), strict=True):
            lengths.extend(more)
    bursts, pauses = found
    assert (min(bursts), max(bursts)) == (1, parameters.longest_steps)
    low, high = parameters.pause_steps
    assert low <= min(pauses) <= max(pauses) <= high
    assert np.mean(pauses) == pytest.approx((low + high) / 2, rel=0.1)


def test_robots_are_disturbed_at_their_own_times(added):
    bursting = np.any(added != 0.0, axis=-1)
    assert 0.05 < bursting.mean() < 0.3
    assert not bursting.all(axis=1).any()


def test_errors_of_a_burst_point_the_same_way_for_many_steps(added):
    before, after = added[:-1], added[1:]
    both = (before != 0.0) & (after != 0.0)
    correlation = np.corrcoef(before[both], after[both])[0, 1]
    # The mean of the four correlations that a burst may draw, weighted by nothing but chance.
    assert correlation == pytest.approx(0.64, abs=0.08)


def test_the_same_seed_gives_the_same_bits_and_another_one_others(added):
    assert disturbance(BurstParameters()).tobytes() == added.tobytes()
    assert disturbance(BurstParameters(), seed=1).tobytes() != added.tobytes()


def test_bursts_without_strength_leave_the_controller_alone():
    assert not disturbance(BurstParameters(strongest_rad=0.0)).any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"longest_steps": 0}, "last 0 steps"),
        ({"strongest_rad": -0.1}, "strongest_rad = -0.1: expected at least 0"),
        ({"strongest_rad": float("nan")}, "strongest_rad = nan"),
        ({"pause_steps": (0, 5)}, "0 to 5"),
        ({"pause_steps": (9, 5)}, "9 to 5"),
    ],
)
def test_impossible_bursts_are_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        Bursts(StandStill(), BurstParameters(**changes))
