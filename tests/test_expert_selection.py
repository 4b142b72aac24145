"""The expert is the policy that does better in trials, whichever was trained last."""

from __future__ import annotations

import numpy as np
import pytest

from cassie_lib import expert_pipeline, gait, pipeline
from cassie_lib.controllers import ReferencePlayback, StandStill
from cassie_lib.errors import ParameterError
from cassie_lib.expert_selection import SEED, Score, score, select
from cassie_lib.presets import replace
from cassie_lib.simulator import S0_SPEED_MPS

COARSE = {"episodes": 2, "steps": 120, "timestep_s": 0.002}


def test_who_walks_at_the_thesis_speed_goes_before_who_passes_more_trials():
    assert select({"a": Score(1.0, 0.6), "b": Score(0.9, 1.0)}) == "a"
    assert select({"a": Score(1.0, 0.6), "b": Score(1.0, 0.7)}) == "b"
    assert select({"a": Score(1.0, 0.7), "b": Score(1.0, 0.6)}) == "a"


def test_of_equals_the_last_trained_is_the_expert():
    assert select({"a": Score(0.5, 0.5), "b": Score(0.5, 0.5)}) == "b"


def test_robots_that_fall_score_nothing():
    assert score(ReferencePlayback(gait.walk(S0_SPEED_MPS)), **COARSE) == (0.0, 0.0)




def test_trials_are_of_five_speeds_and_a_push_at_starts_of_their_own(monkeypatch):
    asked = []

    def episodes(policy, **options):
        asked.append(options)
        speed = options.get("speed_mps", 0.0)
        return type("Recording", (), {"fell": np.array([False, speed == 0.0]), "speed": speed})

    class Report(dict):
        walks = np.array([True, False])

    def report(recording, min_reward):
        # Too fast at 1 m/s in the first episode, to the side at 0.5 m/s in both.
        ahead = np.array([recording.speed < 1.0, True])
        side = np.array([recording.speed != 0.5] * 2)
        line = lambda passed: type("Measure", (), {"passed": passed})  # noqa: E731
        return Report({"mean forward": line(ahead), "mean sideways": line(side)})

    monkeypatch.setattr("cassie_lib.expert_selection.run_episodes", episodes)
    monkeypatch.setattr("cassie_lib.expert_selection.walking_report", report)
    found = score(StandStill(), **COARSE)
    assert [item.get("speed_mps") for item in asked] == [S0_SPEED_MPS, 0.25, 0.5, 0.75, 1.0, None]
    seeds = [item["seed"] for item in asked]
    assert len(set(seeds)) == 6
    assert min(seeds) >= SEED, "not the seeds of the trials that are reported"
    assert asked[-1]["push"].impulse[1] == 40.0
    # Speeds: 1, 1, 0, 1 and a half; half of the pushed robots fell.
    assert found == (0.5, pytest.approx((1 + 1 + 0 + 1 + 0.5 + 0.5) / 6))


def test_episodes_must_be_long_enough_for_a_report():
    with pytest.raises(ParameterError, match="expected at least 112"):
        score(StandStill(), **COARSE | {"steps": 60})


@pytest.mark.parametrize(("better", "name"), [(0, "first"), (1, "second")])
def test_the_expert_is_the_better_policy_and_both_are_tried_once(
    better, name, stages, tmp_path, monkeypatch
):
    trained = [
        pipeline.first_expert_artifact(stages), pipeline.continued_expert_artifact(stages)
    ]  # fmt: skip
    scores = iter([Score(0.9, 0.9), Score(0.1, 0.9)][:: -1 if better else 1])
    monkeypatch.setattr(expert_pipeline, "score", lambda policy, **protocol: next(scores))
    # Another protocol: a recipe that no other test has stored.
    sizes = replace(stages.evaluation, short_steps=120 + 1 + better)
    tried = replace(stages, evaluation=sizes)
    assert pipeline.expert_artifact(tried).identity == trained[better].identity
    lines = pipeline.expert_choice(tried).splitlines()
    assert lines[better].startswith(f"after the {name} training: 90% of the episodes walk, 90%")
    assert [line.endswith(": the expert") for line in lines] == [better == 0, better == 1]
    # Stored: nobody is tried again, as the scores above are used up.
    assert pipeline.expert_scores(tried)[trained[better].name] == (0.9, 0.9)
