"""Rounds of DAgger as stages, and the trials after them: on which model, for how long."""

from __future__ import annotations

import time
from types import SimpleNamespace

import numpy as np
import pytest

from cassie_lib import dagger_pipeline, figures, paths, pipeline
from cassie_lib.artifacts import recompute
from cassie_lib.artifacts.side_by_side import PROCESSES
from cassie_lib.errors import ParameterError
from cassie_lib.presets import replace


@pytest.fixture
def tried(stages, asked, monkeypatch):
    """The runs of the notebook, untrained, and what their trials ask for, by model and push."""

    def rounds(preset, *, rounds, wide=True, decay=None, rounds_share=None, training_steps=0):
        # The control trains for as long as the two rounds together.
        assert rounds_share is None or training_steps == 2 * preset.narrow_dagger.training_steps
        name = "faded" if decay else "wide" if wide else "thin" if rounds_share is None else "alone"
        return [
            SimpleNamespace(index=i, model=f"{name} {i}", artifact=f"{name} {i}")
            for i in range(1, rounds + 1)
        ]

    monkeypatch.setattr(dagger_pipeline, "dagger", rounds)
    found = runs(stages, narrow_rounds=2)
    usual = stages.gradient_cem.mean
    return found, {
        (item.upstream[1] if item.stage == "dagger" else item.upstream[1].key,
         item.protocol.start if item.parameters.mean == usual else item.parameters.mean,
         item.protocol.push_Ns): item for item in asked
    }  # fmt: skip


def runs(preset, narrow_rounds=1):
    return dagger_pipeline.dagger_runs(
        preset, narrow_rounds=narrow_rounds, decayed_rounds=1, decay=0.5, push_Ns=20.0
    )


def test_rounds_are_tried_with_their_own_model_and_the_last_one_longest_on_its_own(stages, tried):
    found, trials = tried
    wide = pipeline.causal_artifact(stages).key
    walks = [trials[key, "handover", 0.0] for key in (wide, "wide 1")]
    assert [item.protocol.steps for item in walks] == [30, 30]
    assert walks[1].model == "wide 1"
    assert [item.index for item in found.wide] == [1, 2], "the whole schedule"
    assert len(found.trials.wide) == 2
    assert ("wide 2", "handover", 0.0) not in trials, "its trial is the padded one"
    padded = trials["wide 2", "padded", 0.0]
    assert (padded.model, padded.protocol.steps) == ("wide 2", stages.evaluation.last_round_steps)
    pushed = trials["wide 2", "handover", 20.0]
    assert (pushed.model, pushed.protocol.steps) == ("wide 2", stages.evaluation.steps)


def test_rounds_of_the_narrow_model_are_tried_for_the_same_length(stages, tried):
    found, trials = tried
    before = pipeline.causal_artifact(stages, wide=False).key
    assert before != pipeline.causal_artifact(stages).key
    after = ["thin 1", "thin 2", "faded 1", "alone 1"]
    compared = [trials[key, "handover", 0.0] for key in (before, *after)]
    assert {item.protocol.steps for item in compared} == {stages.evaluation.planner_steps}
    assert [item.model for item in compared[1:]] == after
    made = found.trials
    assert [len(tried) for tried in (made.narrow, made.decayed)] == [3, 2]
    assert made.narrow[0] is made.decayed[0]
    assert [len(chain) for chain in (found.narrow, found.decayed, found.control)] == [2, 1, 1]


def test_more_seeds_begin_at_the_zero_mean_before_and_after_the_rounds_and_in_the_control(
    stages, tried
):
    found, trials = tried
    before = pipeline.causal_artifact(stages, wide=False).key
    zero = [trials[key, "zero", 0.0] for key in (before, "thin 2", "alone 1")]
    assert sum(key[1] == "zero" for key in trials) == len(zero)
    sizes = stages.evaluation
    assert {item.protocol.steps for item in zero} == {sizes.ablation_steps}
    assert {item.protocol.episodes for item in zero} == {sizes.zero_seeds}
    assert {item.protocol.start for item in zero} == {"handover"}
    assert [item.model for item in zero[1:]] == ["thin 2", "alone 1"]
    assert len(found.trials.narrow_zero) == 2


def test_dagger_begins_with_what_the_model_was_made_of(stages):
    start = dagger_pipeline.dagger_start(stages)
    kinds = [item.stage for item in start.artifacts]
    assert kinds == ["expert", "causal", "data", "data", "data"]
    for found, name in zip((*start.train, start.test), ("train", "wide", "test"), strict=True):
        np.testing.assert_array_equal(found.states, pipeline.dataset(stages, name).states)


def test_the_narrow_start_leaves_the_wide_data_out(stages):
    start = dagger_pipeline.dagger_start(stages, wide=False)
    assert [item.stage for item in start.artifacts] == ["expert", "causal", "data", "data"]
    (train,) = start.train
    np.testing.assert_array_equal(train.states, pipeline.dataset(stages, "train").states)


def test_one_round_is_run_and_found_again(stages):
    (found,) = dagger_pipeline.dagger(stages, rounds=1)
    assert (found.index, found.planner_steps) == (1, 1)
    assert found.report["counts"]["transitions"] == stages.dagger.transitions
    (again,) = dagger_pipeline.dagger(stages, rounds=1)
    assert again.artifact.from_cache
    (decayed,) = dagger_pipeline.dagger(stages, rounds=1, decay=0.5)
    assert decayed.artifact.key != found.artifact.key


@pytest.mark.parametrize("count", [0, 3])
def test_more_rounds_than_the_schedule_has_are_refused_before_any_work(stages, asked, count):
    with pytest.raises(ParameterError, match=f"narrow_rounds is {count}: expected 1 to 2"):
        runs(stages, narrow_rounds=count)
    assert not asked


@pytest.mark.parametrize("count", [-1, 0, 3])
def test_rounds_that_the_schedule_does_not_have_are_refused(stages, count):
    with pytest.raises(ParameterError, match=f"rounds is {count}: expected 1 to 2"):
        dagger_pipeline.dagger(stages, rounds=count)


def test_runs_of_the_notebook_are_those_asked_for_one_by_one(stages, asked):
    found = runs(stages)
    assert [item.index for item in found.wide] == [1, 2]
    keys = {
        dagger_pipeline.dagger(stages, rounds=1)[0].artifact.key,
        dagger_pipeline.dagger(stages, rounds=1, wide=False)[0].artifact.key,
        dagger_pipeline.dagger(stages, rounds=1, wide=False, decay=0.5)[0].artifact.key,
        dagger_pipeline.dagger(
            stages, rounds=1, wide=False, rounds_share=0.0,
            training_steps=stages.narrow_dagger.training_steps,
        )[0].artifact.key,
    }
    assert keys == {made[0].artifact.key for made in found[:4]}
    assert len(keys) == 4
    longest = max(asked, key=lambda item: item.protocol.steps)
    assert longest.upstream[1].key == found.wide[-1].artifact.key


def test_rounds_models_and_trials_of_two_processes_are_those_of_one_bit_for_bit(
    stages, monkeypatch
):
    """Each process waits for what the other one trains; nothing is made twice."""
    short = dict.fromkeys(("planner_steps", "last_round_steps", "steps"), 16)
    preset = replace(stages, evaluation=replace(stages.evaluation, **short))

    def artifacts():
        transformer, causal = pipeline.transformer_and_causal(preset)
        found = runs(preset)
        rounds = [item for chain in found[:4] for item in chain]
        trials = [*found.trials.wide, *found.trials.decayed, found.trials.padded]
        return [transformer, causal, *(item.artifact for item in (*rounds, *trials))]

    alone = {item.name: item for item in artifacts()}
    monkeypatch.setenv("CASSIE_CACHE", str(paths.CACHE))
    monkeypatch.setenv(PROCESSES, "2")
    monkeypatch.setenv(recompute.REQUEST, "transformer,causal,dagger,gradient_cem")
    monkeypatch.setenv(recompute.SINCE, repr(time.time()))
    again = artifacts()
    assert {item.name for item in again} == set(alone)
    for item in again:
        before = alone[item.name].manifest["finished_unix_s"]
        assert item.manifest["finished_unix_s"] > before, item.name
        assert item.digest == alone[item.name].digest, item.name
    assert "from cache" not in figures.Provenance.of("smoke", 0, again).line()
