"""Distributions over action sequences."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cassie_lib.errors import ParameterError, ShapeError
from cassie_lib.planning.sampling import (
    colour_factor,
    initial_distribution,
    refit,
    sample,
    shift,
)

VARIANCE = (0.01, 0.02, 0.01, 0.05, 0.01, 0.03, 0.02, 0.04, 0.01, 0.01)


def generators(*seeds):
    return [torch.Generator().manual_seed(seed) for seed in seeds]


def test_samples_have_the_tuned_diagonal():
    distribution = initial_distribution(torch.full((1, 3, 10), 0.2), VARIANCE)
    drawn = sample(distribution, 20_000, generators(0))[0]
    assert torch.allclose(drawn.mean(0), torch.full((3, 10), 0.2), atol=0.006)
    assert torch.allclose(drawn.var(0), torch.tensor(VARIANCE).expand(3, 10), rtol=0.05)
    # Motors and control steps are independent.
    correlation = np.corrcoef(drawn.flatten(1).numpy().T) - np.eye(30)
    assert np.abs(correlation).max() < 0.04


def test_full_refit_is_the_population_covariance():
    elites = 0.1 * torch.randn(2, 40, 3, 10, generator=generators(1)[0])
    floor = 1e-3
    found = refit(elites, "full", floor)
    for episode in range(2):
        flat = elites[episode].flatten(1).numpy()
        expected = np.cov(flat, rowvar=False, bias=True) + floor**2 * np.eye(30)
        factor = found.factor[episode].numpy()
        np.testing.assert_allclose(factor @ factor.T, expected, atol=1e-7)
        np.testing.assert_allclose(found.mean[episode].flatten(), flat.mean(0), atol=1e-7)
        np.testing.assert_allclose(
            found.std[episode].flatten(), flat.std(0), rtol=1e-5, atol=1e-7
        )


def test_full_covariance_is_sampled():
    elites = torch.zeros(1, 3, 2, 10)
    elites[0, :, 0, 0] = elites[0, :, 1, 4] = torch.tensor([-0.1, 0.0, 0.1])
    drawn = sample(refit(elites, "full", 1e-4), 5000, generators(2))[0].flatten(1)
    # The first motor now and the fifth one a step later only ever moved together.
    assert np.corrcoef(drawn[:, 0], drawn[:, 14])[0, 1] > 0.999
    assert drawn[:, 0].var().item() == pytest.approx(0.02 / 3, rel=0.1)


@pytest.mark.parametrize("covariance", ["diagonal", "full"])
def test_single_elite_leaves_the_floor(covariance):
    elites = torch.full((1, 1, 3, 10), 0.1)
    drawn = sample(refit(elites, covariance, 0.02), 4000, generators(3))[0]
    assert drawn.std(0).numpy() == pytest.approx(0.02, rel=0.1)
    assert torch.isfinite(sample(refit(elites, covariance, 0.0), 4, generators(3))).all()


def test_refit_does_not_depend_on_the_order_of_elites():
    elites = torch.randn(1, 9, 3, 10, generator=generators(4)[0])
    shuffled = elites[:, torch.randperm(9, generator=generators(5)[0])]
    for covariance in ("diagonal", "full"):
        for one, other in zip(refit(elites, covariance), refit(shuffled, covariance), strict=True):
            assert one is other is None or torch.allclose(one, other, atol=1e-6)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_coloured_noise_has_the_spectrum_it_is_asked_for(exponent):
    length = 256
    mean = torch.zeros(1, length, 10)
    drawn = sample(initial_distribution(mean, (1.0,) * 10), 200, generators(6), exponent)[0]
    assert drawn.var(dim=(0, 2)).mean().item() == pytest.approx(1.0, rel=0.06)
    window = torch.hann_window(length)[:, None]
    power = torch.fft.rfft(drawn * window, dim=1).abs().square().mean(dim=(0, 2))
    frequency = np.arange(len(power))
    inner = slice(4, 64)
    slope = np.polyfit(np.log(frequency[inner]), np.log(power[inner].numpy()), 1)[0]
    assert slope == pytest.approx(-exponent, abs=0.12)


def test_white_colour_is_the_identity():
    assert torch.allclose(colour_factor(7, 0.0), torch.eye(7), atol=1e-6)


def test_each_episode_draws_from_its_own_generator():
    distribution = initial_distribution(torch.zeros(3, 4, 10), VARIANCE)
    together = sample(distribution, 5, generators(7, 8, 9))
    alone = sample(initial_distribution(torch.zeros(1, 4, 10), VARIANCE), 5, generators(8))
    assert torch.equal(together[1], alone[0])
    with pytest.raises(ShapeError, match="2 generators"):
        sample(distribution, 5, generators(7, 8))


def test_shift_moves_a_plan_on():
    plan = torch.arange(4.0)[:, None].expand(4, 10)
    assert shift(plan)[:, 0].tolist() == [1, 2, 3, 3]
    assert shift(plan, fill="zero")[:, 0].tolist() == [1, 2, 3, 0]
    assert shift(plan, steps=3)[:, 0].tolist() == [3, 3, 3, 3]
    assert shift(plan, steps=9, fill="zero")[:, 0].tolist() == [0, 0, 0, 0]


def test_bad_variance_and_colour_are_refused():
    mean = torch.zeros(1, 2, 10)
    with pytest.raises(ShapeError, match="9 values"):
        initial_distribution(mean, VARIANCE[:9])
    for value in (-0.01, float("nan")):
        with pytest.raises(ParameterError, match="variance"):
            initial_distribution(mean, (value, *VARIANCE[1:]))
    with pytest.raises(ParameterError, match="colour"):
        colour_factor(5, -1.0)
