"""Rounds of DAgger as stages, and the trials after them: on which model, for how long."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cassie_lib import dagger_pipeline, pipeline


@pytest.fixture
def rounds():
    """Two rounds, the whole schedule of the preset."""
    return [SimpleNamespace(index=i, model=f"model {i}", artifact=f"round {i}") for i in (1, 2)]


def tried(stages, asked, rounds, narrow=(), decayed=()):
    """What was asked for, by the model and the push."""
    asked.clear()
    pushes = {"push_Ns": 20.0, "hard_push_Ns": 40.0}
    found = dagger_pipeline.round_trials(stages, rounds, narrow, decayed, **pushes)
    return found, {
        (item.upstream[1] if item.stage == "dagger" else item.upstream[1].key,
         item.protocol.start, item.protocol.push_Ns): item for item in asked
    }  # fmt: skip


def test_rounds_are_tried_with_their_own_model_and_the_last_one_longest(stages, asked, rounds):
    found, trials = tried(stages, asked, rounds)
    wide = pipeline.causal_artifact(stages).key
    walks = [trials[key, "handover", 0.0] for key in (wide, "round 1", "round 2")]
    assert [item.protocol.steps for item in walks] == [30, 30, 100]
    assert [item.model for item in walks[1:]] == ["model 1", "model 2"]
    assert len(found.wide) == 3
    padded = trials["round 2", "padded", 0.0]
    assert (padded.model, padded.protocol.steps) == ("model 2", 100)
    pushed = trials["round 2", "handover", 20.0]
    assert (pushed.model, pushed.protocol.steps) == ("model 2", stages.evaluation.steps)
    hard = {key for key, _, push in trials if push == 40.0}
    assert hard == {wide, "round 2"}, "the first round is not pushed"
    assert set(found.harder) == {0, 2}
    _, trials = tried(stages, asked, rounds[:1])
    assert trials["round 1", "handover", 0.0].protocol.steps == 30, "the schedule is not finished"


def test_rounds_of_the_narrow_model_are_tried_for_the_same_length(stages, asked, rounds):
    narrow = [SimpleNamespace(index=i, model=f"thin {i}", artifact=f"thin {i}") for i in (1, 2)]
    faded = [SimpleNamespace(index=1, model="faded", artifact="faded")]
    found, trials = tried(stages, asked, rounds, narrow, faded)
    before = pipeline.causal_artifact(stages, wide=False).key
    assert before != pipeline.causal_artifact(stages).key
    compared = [trials[key, "handover", 0.0] for key in (before, "thin 1", "thin 2", "faded")]
    assert {item.protocol.steps for item in compared} == {stages.evaluation.planner_steps}
    assert [item.model for item in compared[1:]] == ["thin 1", "thin 2", "faded"]
    assert (len(found.narrow), len(found.decayed)) == (3, 2)


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


def test_runs_of_the_notebook_are_those_asked_for_one_by_one(stages):
    wide, narrow, decayed = dagger_pipeline.dagger_runs(stages, 1, 1, decay=0.5)
    assert [item.index for item in wide] == [1, 2]
    keys = {
        dagger_pipeline.dagger(stages, rounds=1)[0].artifact.key,
        dagger_pipeline.dagger(stages, rounds=1, wide=False)[0].artifact.key,
        dagger_pipeline.dagger(stages, rounds=1, wide=False, decay=0.5)[0].artifact.key,
    }
    assert keys == {found[0].artifact.key for found in (wide, narrow, decayed)}
    assert len(keys) == 3
