"""What noise does to the motion, how much of the state space a set covers, how sets differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from cassie_lib.data.episodes import Episodes
from cassie_lib.errors import ParameterError
from cassie_lib.robot.schema import GROUPS, PELVIS_ORIENTATION, PERIOD, PHYSICAL

#: Control steps from s0 until the gait has settled: two cycles.
SETTLED = 2 * PERIOD
#: Components with less spread than this are constant.
_CONSTANT = 1e-6


def wilson_interval(hits: int, trials: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson score interval of a share, sound for 0 hits too.

    Raises:
        ParameterError: If there is no trial or the hits are not among them.
    """
    if not 0 <= hits <= trials or trials < 1:
        raise ParameterError(f"{hits} hits of {trials} trials: expected 0 <= hits <= trials >= 1")
    found = stats.binomtest(hits, trials).proportion_ci(level, method="wilson")
    return float(found.low), float(found.high)


def settled(episodes: Episodes) -> np.ndarray:
    """Samples of steady gait ``(T,)`` bool: two cycles after s0, not before a fall.

    Where there is none, as in data of an untrained expert, all samples count.
    """
    step = np.arange(len(episodes)) - np.repeat(episodes.episode_starts, episodes.episode_lengths)
    mask = (step >= SETTLED) & ~np.asarray(episodes.falling)
    return mask if mask.any() else np.ones(len(episodes), dtype=bool)


@dataclass(frozen=True)
class NoiseLevel:
    """What one noise level did to whole episodes.

    Attributes:
        noise_std_rad: Standard deviation of the action noise.
        episodes: How many were run.
        falls: How many ended in a fall.
        interval: 95 % Wilson interval of the share that fell.
        median_steps: Median episode length in control steps.
        foot_spread_m: Root mean square distance of the feet (relative to the pelvis) from their
            mean path at the same phase, over settled samples.
    """

    noise_std_rad: float
    episodes: int
    falls: int
    interval: tuple[float, float]
    median_steps: float
    foot_spread_m: float


def noise_levels(study: Episodes) -> list[NoiseLevel]:
    """Summarise a noise study level by level, least noise first."""
    steady, paths = settled(study), foot_paths(study)
    level_of_sample = np.repeat(study.noise_std_rad, study.episode_lengths)
    result = []
    for level in np.unique(study.noise_std_rad):
        chosen = np.asarray(study.noise_std_rad) == level
        falls, count = int(study.fell[chosen].sum()), int(chosen.sum())
        rows = np.flatnonzero((level_of_sample == level) & steady)
        spread = path_spread(paths[rows], study.phase[rows]) if len(rows) else float("nan")
        result.append(
            NoiseLevel(float(level), count, falls, wilson_interval(falls, count),
                       float(np.median(study.episode_lengths[chosen])), spread)
        )  # fmt: skip
    return result


def foot_paths(episodes: Episodes) -> np.ndarray:
    """Feet ahead and to the left of the pelvis and sole height over the floor, (T, 2, 3) m.

    The axes turn with the pelvis' heading, so that a slow turn does not count as spread.
    """
    w, x, y, z = np.asarray(episodes.states[:, PELVIS_ORIENTATION], dtype=float).T
    heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))[:, None]
    offset = np.asarray(episodes.foot_position - episodes.pelvis_position[:, None, :], dtype=float)
    ahead = np.cos(heading) * offset[..., 0] + np.sin(heading) * offset[..., 1]
    left = np.cos(heading) * offset[..., 1] - np.sin(heading) * offset[..., 0]
    return np.stack([ahead, left, np.asarray(episodes.foot_height, dtype=float)], axis=-1)


def path_spread(paths: np.ndarray, phase: np.ndarray) -> float:
    """Root mean square distance (m) of ``paths`` (n, 2, 3) from their mean at each phase."""
    flat = paths.reshape(len(paths), -1).astype(float)
    residual = flat - phase_means(flat, phase)[phase]
    return float(np.sqrt(np.square(residual.reshape(-1, 2, 3)).sum(-1).mean()))


def phase_means(values: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Mean of ``values`` (n, K) at each phase, (28, K); NaN where a phase does not occur."""
    count = np.bincount(phase, minlength=PERIOD)[:, None]
    sums = np.zeros((PERIOD, values.shape[1]))
    np.add.at(sums, phase, values)
    with np.errstate(invalid="ignore"):
        return sums / count


@dataclass(frozen=True)
class Projection:
    """Principal components of states, standardised component by component.

    Attributes:
        mean, std: ``(46,)`` of the states that it was fitted on.
        axes: ``(K, 46)`` unit vectors, most variance first.
        explained: Share of the variance along each axis, ``(K,)``.
    """

    mean: np.ndarray
    std: np.ndarray
    axes: np.ndarray
    explained: np.ndarray

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Coordinates ``(n, K)`` of states ``(n, 49)``."""
        return (np.asarray(states[:, PHYSICAL], dtype=float) - self.mean) / self.std @ self.axes.T


def fit_projection(states: np.ndarray, count: int = 3) -> Projection:
    """Fit principal components on states ``(n, 49)``; clock and speed do not count."""
    values = np.asarray(states[:, PHYSICAL], dtype=float)
    mean, std = values.mean(axis=0), values.std(axis=0)
    std = np.where(std < _CONSTANT, 1.0, std)
    _, singular, axes = np.linalg.svd((values - mean) / std, full_matrices=False)
    return Projection(mean, std, axes[:count], (singular**2 / np.sum(singular**2))[:count])


def occupied_cells(coordinates: np.ndarray, samples: int, cell: float = 0.5) -> int:
    """Cells of a grid that ``samples`` evenly chosen points of ``coordinates`` (n, K) fall into.

    Args:
        coordinates: Points.
        samples: Equal for all sets that are compared; at most n.
        cell: Edge of a cell, in units of the coordinates.
    """
    chosen = np.linspace(0, len(coordinates) - 1, samples).astype(int)
    return len(np.unique(np.floor(coordinates[chosen] / cell), axis=0))


class GaitCloud:
    """How far states are from the mean gait of a data set, in units of that set's own spread."""

    def __init__(self, episodes: Episodes) -> None:
        """Measure the mean state at each phase and the spread around it, on settled samples."""
        rows = settled(episodes)
        values = np.asarray(episodes.states[rows][:, PHYSICAL], dtype=float)
        phase = np.asarray(episodes.phase[rows])
        self.means = phase_means(values, phase)
        spread = (values - self.means[phase]).std(axis=0)
        self.spread = np.where(spread < _CONSTANT, np.inf, spread)

    def _residual(self, episodes: Episodes) -> np.ndarray:
        """Standardised residuals ``(n, 46)`` of settled samples at phases that the set holds."""
        rows = settled(episodes)
        values = np.asarray(episodes.states[rows][:, PHYSICAL], dtype=float)
        residual = (values - self.means[np.asarray(episodes.phase[rows])]) / self.spread
        return residual[np.isfinite(residual).all(axis=1)]

    def distance(self, episodes: Episodes) -> np.ndarray:
        """Root mean square distance of each settled sample ``(n,)``; 1 is typical of the set."""
        return np.sqrt(np.mean(np.square(self._residual(episodes)), axis=1))

    def group_distance(self, episodes: Episodes) -> dict[str, float]:
        """Root mean square distance per row of Table 4.1, over samples and components."""
        square = np.mean(np.square(self._residual(episodes)), axis=0)
        chosen = [group for group in GROUPS if group.slice.start < PHYSICAL.stop]
        return {group.name: float(np.sqrt(square[group.slice].mean())) for group in chosen}

    def outside(self, episodes: Episodes, own: np.ndarray, quantile: float = 0.99) -> float:
        """Share of samples farther off than ``quantile`` of the set's ``own`` distances."""
        return float(np.mean(self.distance(episodes) > np.quantile(own, quantile)))


__all__ = [
    "GaitCloud",
    "NoiseLevel",
    "Projection",
    "fit_projection",
    "foot_paths",
    "noise_levels",
    "occupied_cells",
    "path_spread",
    "phase_means",
    "settled",
    "wilson_interval",
]
