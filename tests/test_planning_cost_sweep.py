"""Sweeps of what a plan costs: what is varied, what stays, what grows."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cassie_lib.planning import cost_sweep
from cassie_lib.planning.cost import Uncached
from cassie_lib.presets import get_preset, replace

SMOKE = get_preset("smoke")


@pytest.fixture
def timed(monkeypatch):
    """Planners that would be timed, each taking as long as it has numbers to predict."""
    seen = []

    def pretend(planner, repeats=3):
        seen.append(planner)
        p = planner.parameters
        return 1e-3 * p.samples * p.horizon

    monkeypatch.setattr(cost_sweep, "plan_seconds", pretend)
    return seen


def test_sweeps_vary_one_size_and_keep_the_others(timed):
    sweeps = cost_sweep.plan_sweeps(SMOKE.cem, SMOKE.causal, (8, 16), (2, 4, 8), (4, 6), 1)
    assert [(sweep.name, sweep.values.tolist()) for sweep in sweeps] == [
        ("N", [8, 16]), ("tau", [2, 4, 8]), ("H", [4, 6]),
    ]  # fmt: skip
    assert [sweep.exponent for sweep in sweeps] == pytest.approx([1.0, 1.0, 0.0])
    sizes = [(p.parameters.samples, p.parameters.horizon, p.objective.model.context) for p in timed]
    assert sizes == [
        (8, 3, 6), (16, 3, 6), (8, 2, 6), (8, 4, 6), (8, 8, 6), (8, 3, 4), (8, 3, 6),
    ]  # fmt: skip
    assert {p.parameters.iterations for p in timed} == {1}


def test_elites_never_outnumber_the_samples(timed):
    many = replace(SMOKE.cem, elites=50, samples=100)
    cost_sweep.plan_sweeps(many, SMOKE.causal, (10, 100), (2,), (4,), 1)
    assert {planner.parameters.elites for planner in timed} == {10}


def test_untrained_models_are_equal_and_leave_the_random_numbers_alone():
    torch.manual_seed(5)
    before = torch.get_rng_state()
    first, second = (cost_sweep.untrained(SMOKE.causal, context=4) for _ in range(2))
    assert torch.equal(torch.get_rng_state(), before)
    assert first.context == 4
    for one, other in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.equal(one, other)
        assert not one.requires_grad


def test_gradients_on_more_sequences_hold_more_memory():
    few, many = cost_sweep.gradient_costs(SMOKE.causal, (2, 20), 3)
    assert (few.sequences, many.sequences) == (2, 20)
    assert many.memory_bytes > 5 * few.memory_bytes > 0
    assert min(few.seconds, many.seconds) > 0.0


def test_gain_of_the_cache_times_the_same_planner_with_and_without(timed):
    cached, naive = cost_sweep.cache_gain(SMOKE.cem, SMOKE.causal)
    assert cached == naive, "the clock of this test counts sizes only"
    with_cache, without = timed
    assert isinstance(without.objective.model, Uncached)
    assert not isinstance(with_cache.objective.model, Uncached)
    assert with_cache.parameters == without.parameters


def test_real_plans_are_timed():
    sweeps = cost_sweep.plan_sweeps(SMOKE.cem, SMOKE.causal, (8,), (2,), (4,), 1)
    assert all((sweep.seconds > 0.0).all() for sweep in sweeps)
    assert np.all(np.array(cost_sweep.cache_gain(SMOKE.cem, SMOKE.causal)) > 0.0)
