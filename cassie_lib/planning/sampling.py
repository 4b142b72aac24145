"""Distributions over action sequences: initial, sampled, refitted.

A sequence is ``(T, 10)`` motor-position offsets in radians.  Two covariances are offered:

* ``diagonal``: one standard deviation per control step and motor (the thesis's tuned diagonal);
* ``full``: the covariance of the flattened sequence, ``(10 T, 10 T)``, as line 8 of Algorithm 2
  writes it.  With fewer elites than ``10 T`` it is singular, so the floor is added to its
  diagonal.

Every episode draws from its own generator: a plan does not depend on which other episodes happen
to be planned in the same batch.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import torch

from cassie_lib.errors import ParameterError, ShapeError
from cassie_lib.robot.schema import ACTION_SIZE


class Distribution(NamedTuple):
    """A Gaussian over action sequences, one per episode.

    Attributes:
        mean: ``(E, T, 10)`` rad.
        std: ``(E, T, 10)`` rad, square roots of the diagonal of the covariance.
        factor: Lower Cholesky factor ``(E, 10 T, 10 T)`` of the full covariance, or ``None`` when
            the covariance is diagonal.
    """

    mean: torch.Tensor
    std: torch.Tensor
    factor: torch.Tensor | None = None


def initial_distribution(
    mean: torch.Tensor, variance: Sequence[float], std_floor: float = 0.0
) -> Distribution:
    """Gaussian around ``mean`` with the same variance per motor at every control step.

    Args:
        mean: ``(E, T, 10)`` rad.
        variance: 10 variances in rad^2, diag(Sigma_0) of thesis section 5.2.1.
        std_floor: Least standard deviation, rad.

    Raises:
        ShapeError: If there are not 10 variances.
        ParameterError: If a variance is negative or not finite.
    """
    values = torch.as_tensor(tuple(variance), dtype=mean.dtype, device=mean.device)
    if values.shape != (ACTION_SIZE,):
        raise ShapeError(f"variance has {values.numel()} values: expected {ACTION_SIZE}")
    if not bool(torch.isfinite(values).all()) or bool((values < 0).any()):
        raise ParameterError(f"variance is {tuple(variance)}: expected finite values >= 0 rad^2")
    std = values.sqrt().clamp_min(std_floor).expand_as(mean)
    return Distribution(mean, std)


def refit(elites: torch.Tensor, covariance: str = "diagonal", std_floor: float = 0.0):
    """Mean and population covariance of the elites: line 8 of Algorithm 2.

    The population form (division by K, not K - 1) also exists for a single elite.

    Args:
        elites: ``(E, K, T, 10)`` rad.
        covariance: ``"diagonal"`` or ``"full"``.
        std_floor: Least standard deviation in rad, so that sampling never collapses.

    Returns:
        :class:`Distribution`; ``std_floor**2`` is added to the diagonal of a full covariance.
    """
    mean = elites.mean(dim=1)
    std = elites.std(dim=1, correction=0).clamp_min(std_floor)
    if covariance == "diagonal":
        return Distribution(mean, std)
    deviations = (elites - mean[:, None]).flatten(2).double()
    matrix = deviations.mT @ deviations / elites.shape[1]
    # The jitter keeps the Cholesky factorisation possible even without a floor.
    ridge = max(std_floor, 1e-6) ** 2
    matrix = matrix + ridge * torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)
    return Distribution(mean, std, torch.linalg.cholesky(matrix).to(elites.dtype))


@lru_cache(maxsize=16)
def colour_factor(horizon: int, exponent: float) -> torch.Tensor:
    """Matrix that turns white noise over the horizon into noise with spectrum ``1/f**exponent``.

    The result has unit variance at every step.  The constant part gets the power of the lowest
    frequency, as in iCEM.  The autocovariance is taken over twice the horizon and cut, so that the
    last step is not correlated with the first one, as it would be with a transform of length T.

    Args:
        horizon: T, control steps.
        exponent: 0 is white, 1 pink, 2 red.

    Returns:
        Lower triangular ``(T, T)`` float32; ``factor @ white`` is coloured.

    Raises:
        ParameterError: If the exponent is negative or not finite.
    """
    if not 0.0 <= exponent < float("inf"):
        raise ParameterError(f"noise colour is {exponent}: expected a finite exponent >= 0")
    length = 2 * horizon
    frequency = torch.arange(length // 2 + 1, dtype=torch.float64).clamp_min(1.0)
    autocovariance = torch.fft.irfft((frequency**-exponent).to(torch.complex128), n=length)
    autocovariance = autocovariance[:horizon] / autocovariance[0]
    lag = (torch.arange(horizon)[:, None] - torch.arange(horizon)[None, :]).abs()
    matrix = autocovariance[lag] + 1e-9 * torch.eye(horizon, dtype=torch.float64)
    return torch.linalg.cholesky(matrix).float()


def sample(
    distribution: Distribution,
    count: int,
    generators: Sequence[torch.Generator],
    colour: float = 0.0,
) -> torch.Tensor:
    """Draw action sequences; they may lie outside the bounds and are clipped by the caller.

    Args:
        distribution: Of E episodes.
        count: N, sequences per episode.
        generators: One per episode.
        colour: Exponent of the noise over the horizon.  It shapes diagonal distributions only: a
            full covariance that was fitted to coloured samples already carries the correlation.

    Returns:
        ``(E, N, T, 10)`` rad.

    Raises:
        ShapeError: If there is not one generator per episode.
    """
    mean = distribution.mean
    episodes, horizon, size = mean.shape
    if len(generators) != episodes:
        raise ShapeError(f"{len(generators)} generators: expected one per episode, {episodes}")
    # Drawn on the CPU so that a seed means the same plan on every device.
    noise = torch.stack([torch.randn(count, horizon, size, generator=g) for g in generators])
    noise = noise.to(mean)
    if distribution.factor is not None:
        noise = (noise.flatten(2) @ distribution.factor.mT).view_as(noise)
        return mean[:, None] + noise
    if colour:
        noise = torch.einsum("ts,ensa->enta", colour_factor(horizon, float(colour)).to(mean), noise)
    return mean[:, None] + distribution.std[:, None] * noise


def shift(actions: torch.Tensor, steps: int = 1, fill: str = "repeat") -> torch.Tensor:
    """Move sequences on by executed control steps: the warm start of the next plan.

    Args:
        actions: ``(..., T, 10)`` rad.
        steps: Control steps that have been executed since.
        fill: What the freed end holds: ``"repeat"`` the last action or ``"zero"``.

    Returns:
        Tensor of the same shape.
    """
    horizon = actions.shape[-2]
    steps = min(steps, horizon)
    end = actions[..., -1:, :] if fill == "repeat" else torch.zeros_like(actions[..., -1:, :])
    tail = end.expand(*actions.shape[:-2], steps, actions.shape[-1])
    return torch.cat([actions[..., steps:, :], tail], dim=-2)
