"""Trials of planners and rounds as stages: on which model, for how long, stored under what."""

from __future__ import annotations

import time

import numpy as np
import pytest

from cassie_lib import gait, paths, pipeline
from cassie_lib import planner_pipeline as planners
from cassie_lib.artifacts import recompute
from cassie_lib.artifacts.side_by_side import PROCESSES
from cassie_lib.errors import ParameterError, UnknownNameError
from cassie_lib.expert.trials import SPEEDS_MPS, run_trials
from cassie_lib.packing import RELATIVE_ERROR
from cassie_lib.planning.cem import MEANS
from cassie_lib.planning.evaluate import Protocol, evaluate, run_protocol
from cassie_lib.planning.feedforward import feedforward_cycle
from cassie_lib.planning.oracle import OracleModel
from cassie_lib.presets import get_preset, replace
from cassie_lib.walking import run_episodes


def test_a_trial_runs_the_planner_on_the_stored_model_once(stages):
    trial = planners.planner_trial(stages, "cem")
    recording, log = trial.episodes
    assert recording.actions.shape == (2, 40, 10)
    assert log.handover_step == stages.causal.context
    for planned, length in zip(log.planned.T, recording.length, strict=True):
        driven = np.arange(len(planned)) >= log.handover_step
        np.testing.assert_array_equal(planned[: length + 1], driven[: length + 1])
    sources = [pipeline.expert_artifact(stages), pipeline.causal_artifact(stages)]
    assert trial.artifact.manifest["upstream"] == [item.identity for item in sources]
    again = planners.planner_trial(stages, "cem")
    assert again.artifact.from_cache
    np.testing.assert_array_equal(again.episodes.recording.length, recording.length)
    other = planners.planner_trial(stages, "cem", seed=5)
    assert other.artifact.key != trial.artifact.key


def test_trials_side_by_side_are_those_of_one_process_bit_for_bit(stages, monkeypatch):
    wanted = {f"{steps} steps": {"steps": steps, "seed": 3} for steps in (15, 16)}
    alone = {name: planners.planner_trial(stages, "cem", **how) for name, how in wanted.items()}
    monkeypatch.setenv("CASSIE_CACHE", str(paths.CACHE))
    monkeypatch.setenv(PROCESSES, "2")
    monkeypatch.setenv(recompute.REQUEST, "cem")
    monkeypatch.setenv(recompute.SINCE, repr(time.time()))
    found = planners.planner_trials(stages, "cem", wanted)
    assert list(found) == list(wanted)
    for name, trial in found.items():
        assert trial.artifact.manifest["seed"] == 3
        finished = [t.artifact.manifest["finished_unix_s"] for t in (alone[name], trial)]
        assert finished[1] > finished[0], "computed anew"
        assert trial.artifact.key == alone[name].artifact.key
        ours, theirs = (item.episodes for item in (trial, alone[name]))
        np.testing.assert_array_equal(ours.recording.states, theirs.recording.states)
        np.testing.assert_array_equal(ours.recording.actions, theirs.recording.actions)
        np.testing.assert_array_equal(ours.log.imagined_return, theirs.log.imagined_return)


def test_baselines_are_the_rewards_of_walking_and_of_standing(stages):
    found = planners.baselines(stages)
    assert list(found) == ["pi*", "standing still"]
    recording = run_episodes(pipeline.expert(stages), episodes=2, steps=112,
                             speed_mps=stages.simulation.speed_mps, timestep_s=0.002)  # fmt: skip
    assert found["pi*"] == pytest.approx(np.nanmean(recording.reward))
    assert planners.baselines_artifact(stages).from_cache


def test_unknown_planner_is_named(stages):
    for make in (planners.planner_parameters, planners.planner_trial, planners.oracle_trial):
        with pytest.raises(UnknownNameError, match="unknown planner 'mppi': expected one of cem"):
            make(stages, "mppi")


@pytest.mark.parametrize(("planner", "steps"), [("cem", 40), ("gradient_cem", 30)])
def test_each_planner_has_its_own_length(planner, steps, stages, asked):
    planners.planner_trial(stages, planner)
    planners.planner_trial(stages, planner, steps=12, push_Ns=30.0)
    whole, short = asked
    assert (whole.stage, whole.protocol.steps, whole.protocol.episodes) == (planner, steps, 2)
    assert whole.protocol.timestep_s == stages.simulation.timestep_s
    assert (short.protocol.steps, short.protocol.push_Ns) == (12, 30.0)
    assert whole.parameters == getattr(stages, planner)


def test_a_push_comes_within_the_trial(stages, asked):
    # The usual step 200 is past the end of a short trial, and such a push would push nobody.
    for steps, chosen in ((12, 6), (300, 150), (400, 200), (3030, 200)):
        planners.planner_trial(stages, "cem", steps=steps, push_Ns=20.0)
        assert asked[-1].protocol.push_step == chosen
    planners.planner_trial(stages, "cem", steps=30, push_Ns=20.0, push_step=29)
    assert asked[-1].protocol.push_step == 29
    planners.planner_trial(stages, "cem", steps=30)
    assert asked[-1].protocol.push_Ns == 0.0
    with pytest.raises(ParameterError, match="push_step = 30: expected 0 to 29, within the trial"):
        planners.planner_trial(stages, "cem", steps=30, push_Ns=20.0, push_step=30)


def test_other_means_get_shorter_trials_than_the_own_one(stages, asked):
    planners.mean_trials(stages, "cem")
    lengths = {item.parameters.mean: item.protocol.steps for item in asked}
    # Own mean: the whole trial, which begins with the same steps.
    assert lengths == {"zero": 60, "warm": 40, "reference": 60, "feedforward": 60}
    asked.clear()
    planners.mean_trials(replace(stages, name="laptop"), "cem")
    assert [item.parameters.mean for item in asked] == list(MEANS), "an expert that walks"


def test_parts_of_the_reward_are_added_one_by_one(stages, asked):
    whole = replace(
        stages.gradient_cem, terminal_weight=0.2, foot_weight=0.1, speed_weight=3.0
    )
    stages = replace(stages, gradient_cem=whole)
    planners.reward_trials(stages, "gradient_cem")
    used = [item.parameters for item in asked]
    weights = [(p.terminal_weight, p.foot_weight, p.speed_weight) for p in used]
    assert weights == [(0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.2, 0.1, 0.0), (0.2, 0.1, 3.0)]
    assert used[-1] == stages.gradient_cem
    assert [item.protocol.steps for item in asked] == [60, 60, 60, 30]


def test_playback_is_the_feedforward_cycle_and_nothing_else(stages):
    (recording, log), _ = planners.playback_trial(stages)
    cycle = feedforward_cycle(gait.walk(stages.simulation.speed_mps))
    for episode, length in enumerate(recording.length):
        driven = slice(log.handover_step, length)
        wanted = cycle[recording.phase[episode, driven]]
        np.testing.assert_allclose(recording.actions[episode, driven], wanted.clip(-0.5, 0.5),
                                   rtol=1.1 * RELATIVE_ERROR, atol=1e-6)  # fmt: skip


def test_oracle_trials_are_smaller_and_depend_on_no_model(stages, asked):
    for planner in planners.PLANNERS:
        planners.oracle_trial(stages, planner)
    cem, gradient = asked
    assert (cem.protocol.steps, gradient.protocol.steps) == (12, 9)
    for item in asked:
        assert isinstance(item.model, OracleModel)
        assert item.model.context == stages.causal.context
        assert [source.stage for source in item.upstream] == ["expert"]


SMOKE = get_preset("smoke")


def test_bad_protocols_are_refused():
    model = OracleModel(2, 0.002)
    with pytest.raises(UnknownNameError, match="unknown start 'cold': expected one of handover"):
        run_protocol(Protocol(start="cold"), model, SMOKE.cem)
    with pytest.raises(ParameterError, match="expert is None: expected one"):
        run_protocol(Protocol(), model, SMOKE.cem)


def test_padded_start_needs_no_expert_and_a_push_moves_the_robot(artifact_folders):
    calm = Protocol(1, 6, "padded", timestep_s=0.002)
    parameters = replace(SMOKE.cem, samples=4, elites=2)
    pushed = replace(calm, push_Ns=60.0, push_step=2)
    paths = [run_protocol(item, OracleModel(2, 0.002), parameters).recording.qpos[0, :, 1]
             for item in (calm, pushed)]  # fmt: skip
    np.testing.assert_array_equal(paths[0][:3], paths[1][:3])
    assert paths[1][5] - paths[0][5] > 0.02
    found, artifact = evaluate("cem", calm, OracleModel(2, 0.002), parameters)
    np.testing.assert_allclose(found.recording.qpos[0, :, 1], paths[0], atol=1e-6)
    assert found.log.handover_step == 0
    # What the oracle simulates is part of the recipe.
    _, other = evaluate("cem", calm, OracleModel(2, 0.001), parameters)
    assert other.key != artifact.key


def test_trials_of_the_expert_cover_noise_pushes_and_speeds(stages):
    found = run_trials(pipeline.expert(stages), replace(stages.evaluation, short_steps=112), 0.002)
    assert tuple(found.reports) == SPEEDS_MPS
    assert "action noise 0.06" in found.noisy.protocol
    assert "push" in found.pushed.protocol
    assert "push" not in found.quiet.protocol
    for speed, report in found.reports.items():
        measure = report["mean forward"]
        assert (measure.low, measure.high) == pytest.approx((speed - 0.05, speed + 0.05))
    rows = {row["trial"]: row["episodes"] for row in found.rows()}
    assert rows["no fall, no noise"] == f"{(~found.quiet.fell).sum()}/2"
    assert len(rows) == 4 + 2 * len(SPEEDS_MPS)
