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


def test_rounds_are_tried_with_their_own_model_and_the_last_one_longest(stages, asked, rounds):
    dagger_pipeline.round_trials(stages, rounds)
    before, first, last = asked
    assert (before.stage, first.stage, last.stage) == ("gradient_cem", "dagger", "dagger")
    assert (first.model, last.model) == ("model 1", "model 2")
    assert last.upstream[1] == "round 2"
    assert before.upstream[1].stage == "causal"
    assert [item.protocol.steps for item in asked] == [30, 30, 100]
    asked.clear()
    dagger_pipeline.round_trials(stages, rounds[:1])
    assert asked[-1].protocol.steps == 30, "the schedule is not finished"


def test_rounds_of_the_narrow_model_are_tried_for_the_same_length(stages, asked, rounds):
    dagger_pipeline.narrow_round_trials(stages, rounds)
    assert [item.model for item in asked[1:]] == ["model 1", "model 2"]
    assert asked[0].upstream[1].key == pipeline.causal_artifact(stages, wide=False).key
    assert asked[0].upstream[1].key != pipeline.causal_artifact(stages).key
    assert {item.protocol.steps for item in asked} == {stages.evaluation.planner_steps}


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
