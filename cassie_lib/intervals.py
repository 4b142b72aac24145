"""Intervals for numbers from few seeds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from cassie_lib.errors import NonFiniteError, ParameterError, ShapeError

RESAMPLES = 10_000


def bootstrap_interval(
    values: Any,
    statistic: Callable[..., np.ndarray] = np.median,
    level: float = 0.95,
    seed: int = 0,
) -> tuple[float, float]:
    """Percentile bootstrap interval of a statistic.

    Args:
        values: One number per seed, ``(n,)``.
        statistic: Reduces the last axis; called as ``statistic(samples, axis=-1)``.
        level: Coverage, between 0 and 1.
        seed: Of the resampling; the same seed gives the same interval.

    Returns:
        Lower and upper end, in the unit of ``values``.

    Raises:
        ShapeError: If there is no value or more than one axis.
        NonFiniteError: If a value is NaN or infinite.
        ParameterError: If the level is not between 0 and 1.
    """
    sample = np.asarray(values, dtype=float)
    if sample.ndim != 1 or sample.size == 0:
        raise ShapeError(f"values have shape {sample.shape}: expected (n,) with n >= 1")
    if not np.isfinite(sample).all():
        bad = int(np.flatnonzero(~np.isfinite(sample))[0])
        raise NonFiniteError(f"values[{bad}] is {sample[bad]}: expected a finite number")
    if not 0.0 < level < 1.0:
        raise ParameterError(f"level is {level}: expected a number between 0 and 1")
    draws = np.random.default_rng(seed).integers(sample.size, size=(RESAMPLES, sample.size))
    found = statistic(sample[draws], axis=-1)
    tail = 50.0 * (1.0 - level)
    low, high = np.percentile(found, [tail, 100.0 - tail])
    return float(low), float(high)
