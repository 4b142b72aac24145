"""Rounds of DAgger: they learn, survive a kill and do not depend on the machine."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from planning_toys import DoubleIntegrator

from cassie_lib import paths
from cassie_lib.dagger import (
    Start,
    dagger_rounds,
    rounds,
    to_transitions,
)
from cassie_lib.data import collect
from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.errors import ParameterError
from cassie_lib.expert.policy import Expert, ExpertPolicy
from cassie_lib.planning.mixed import MixedController
from cassie_lib.presets import CollectionParameters, SimulationParameters, get_preset, replace

SMOKE = get_preset("smoke")
COARSE = SimulationParameters(timestep_s=0.002)


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    torch.manual_seed(0)
    expert = Expert(ExpertPolicy(hidden_size=8, layers=1))
    found = [
        to_transitions(collect(
            expert, CollectionParameters("first", 120, 0.1, seed, 30, 4), COARSE,
            tmp_path_factory.mktemp("data"), progress=False,
        ))
        for seed in (1, 2)
    ]
    model = CausalModel(SMOKE.causal, Normalisation.from_transitions(found[0]))
    frozen = model.eval().requires_grad_(False)
    return Start(expert, frozen, lambda: (found[0],), lambda: found[1])


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "CACHE", tmp_path / "cache")
    monkeypatch.setattr(paths, "DATA", tmp_path / "data")
    return tmp_path


PARAMETERS = replace(
    SMOKE.dagger, transitions=100, episode_steps=25, minutes_per_round=0.0, pad_starts=True
)
PLANNER = replace(SMOKE.cem, samples=3, elites=2)


def run(start, parameters=PARAMETERS, **options):
    return dagger_rounds(start, parameters, PLANNER, COARSE, preset="smoke", **options)


def test_rounds_retrain_and_are_loaded_again(start, cache):
    made = run(start)
    assert [item.planner_steps for item in made] == [1, 27]
    first, second = made
    weights = [model.head.weight for model in (start.model, first.model, second.model)]
    assert not torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[1], weights[2])
    # Normalisation is the first model's: its weights mean nothing under another one.
    assert second.model.normalisation.digest() == start.model.normalisation.digest()
    assert first.report["counts"]["transitions"] == 100
    assert sum(len(part) for part in (first.train, first.validation, first.test)) == 100
    stored = set(first.artifact.manifest["files"])
    assert "transitions.npz" in stored
    with np.load(first.artifact.file("transitions.npz")) as arrays:
        learned_from = {"states", "actions", "phase", "episode_starts"}
        names = {name.removeprefix("packed_").removeprefix("shape_") for name in arrays}
        assert names == learned_from, "nobody learns from forces"
    errors = second.report["relative_error"]
    found = [errors[on][when] for on in ("expert", "round") for when in ("before", "after")]
    assert np.isfinite(found).all()
    again = run(start)
    assert all(item.artifact.from_cache for item in again)
    assert torch.equal(again[1].model.head.weight, second.model.head.weight)
    # One more round leaves those that have been run as they are.
    longer = run(start, replace(PARAMETERS, schedule=(1, 27, 27)), rounds=2)
    assert all(item.artifact.from_cache for item in longer)


def test_retraining_has_its_own_budget_rate_and_share_of_rollouts(start, cache, monkeypatch):
    train, asked, shares = rounds.train_causal, [], []

    def noted(sources, settings, **options):
        asked.append((settings, options["initial"]))
        shares.append((sources, options["shares"]))
        return train(sources, settings, **options)

    monkeypatch.setattr(rounds, "train_causal", noted)
    changes = {"training_steps": 4, "learning_rate": 2e-4, "rollout_share": 1.0}
    first = run(start, replace(PARAMETERS, decay=0.25, **changes))[0]
    for settings, _ in asked:
        found = (settings.steps, settings.learning_rate, settings.rollout_share)
        assert found == tuple(changes.values())
    assert asked[0][1] is start.model
    assert torch.equal(asked[1][1].head.weight, first.model.head.weight)
    # beta: a recording counts with its windows times 0.25 for each round since.
    for (sources, found), ages in zip(shares, ([1, 0], [2, 1, 0]), strict=True):
        length = settings.context + settings.horizon
        weights = [len(s.window_starts(length)) * 0.25**age
                   for s, age in zip(sources, ages, strict=True)]  # fmt: skip
        np.testing.assert_allclose(found, np.array(weights) / sum(weights))
    assert sources[1] is not sources[2]
    assert len(sources[0]) == len(start.load_train()[0]), "the oldest is the first model's data"


def test_a_control_learns_from_what_the_first_model_was_trained_on_alone(start, cache):
    """Whatever its rounds have collected, the weights come out the same."""
    made = [
        run(start, replace(PARAMETERS, rounds_share=0.0, transitions=count), rounds=1)[0]
        for count in (100, 75)
    ]
    assert torch.equal(made[0].model.head.weight, made[1].model.head.weight)
    assert not torch.equal(made[0].model.head.weight, start.model.head.weight)
    learned = run(start, rounds=1)[0]
    assert not torch.equal(learned.model.head.weight, made[0].model.head.weight)


def test_killed_round_goes_on_where_it_was(start, cache, monkeypatch):
    whole = run(start, rounds=1)[0]
    monkeypatch.setattr(paths, "CACHE", cache / "other")
    monkeypatch.setattr(paths, "DATA", cache / "other-data")
    train = rounds.train_causal

    def killed(*arguments, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr(rounds, "train_causal", killed)
    with pytest.raises(KeyboardInterrupt):
        run(start, rounds=1)
    monkeypatch.setattr(rounds, "train_causal", train)

    def never(*arguments, **options):
        raise AssertionError("the planner was asked again")

    monkeypatch.setattr(MixedController, "act", never)
    resumed = run(start, rounds=1)[0]
    assert torch.equal(resumed.model.head.weight, whole.model.head.weight)
    assert resumed.artifact.digest == whole.artifact.digest


def test_rounds_do_not_depend_on_the_number_of_cores(start, cache, monkeypatch):
    threads, real = [], rounds.collect

    def collect(*arguments, **options):
        threads.append(torch.get_num_threads())
        return real(*arguments, **options)

    def train(*arguments, **options):
        threads.append(torch.get_num_threads())
        raise KeyboardInterrupt

    monkeypatch.setattr(rounds, "collect", collect)
    monkeypatch.setattr(rounds, "train_causal", train)
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        with pytest.raises(KeyboardInterrupt):
            run(start)
    finally:
        torch.set_num_threads(before)
    assert threads == [1, 1]


def test_bad_rounds_are_refused(start, cache):
    with pytest.raises(ParameterError, match="n = 28"):
        run(start, replace(PARAMETERS, schedule=(1, 28)))
    with pytest.raises(ParameterError, match="schedule is empty"):
        run(start, replace(PARAMETERS, schedule=()))
    with pytest.raises(ParameterError, match="rounds_share is 2"):
        run(start, replace(PARAMETERS, rounds_share=2.0))
    with pytest.raises(ParameterError, match="expected a CausalModel"):
        run(Start(start.expert, DoubleIntegrator(), start.load_train, start.load_test))
