"""Stages of the notebooks, computed once at toy sizes: what each holds and what it depends on."""

from __future__ import annotations

import json

import matplotlib as mpl
import numpy as np
import pytest
import torch

from cassie_lib import grid_search, paths, pipeline, planner_pipeline
from cassie_lib import transformer_claims as claims
from cassie_lib.artifacts import recompute
from cassie_lib.controllers import Observation
from cassie_lib.data import open_dataset
from cassie_lib.dynamics.store import load_model
from cassie_lib.errors import ArtifactError, ParameterError, UnknownNameError
from cassie_lib.planning import evaluate
from cassie_lib.plots import expert as expert_plots
from cassie_lib.plots import transformer as curves
from cassie_lib.presets import replace

mpl.use("agg")


def test_policies_are_stored_with_card_and_log_and_the_expert_acts(stages):
    artifact = pipeline.continued_expert_artifact(stages)
    assert pipeline.continued_expert_artifact(stages).from_cache
    assert set(artifact.manifest["files"]) == {
        "card.json", "expert.safetensors", "timing.json", "timing_log.csv",
    }  # fmt: skip
    card = json.loads(artifact.file("card.json").read_text())
    assert card["parameters"]["hidden_size"] == 16
    assert "second" not in json.dumps({k: v for k, v in card.items() if k != "parameters"})
    log = expert_plots.read_log(artifact.file("timing_log.csv"))
    assert log["step"][-1] == card["steps"] >= 112
    assert {"plain_reward", "falls", "seconds"} <= set(log)
    names = {item.name for item in (pipeline.first_expert_artifact(stages), artifact)}
    assert pipeline.expert_artifact(stages).name in names
    expert = pipeline.expert(stages)
    expert.reset(3)
    actions = expert.act(Observation(np.zeros((3, 49)), None, np.zeros(3), np.zeros((3, 3)), 0))
    assert actions.shape == (3, 10)


def test_policy_of_the_reward_alone_is_another_one(stages):
    alone, whole = pipeline.reward_only_artifact(stages), pipeline.expert_artifact(stages)
    assert alone.key != whole.key
    found = json.loads(alone.file("card.json").read_text())["parameters"]
    assert (found["guidance_weight"], found["push_limit_Ns"]) == (0.0, 0.0)
    assert found["min_speed_mps"] == found["max_speed_mps"] == 0.0509


def test_every_data_set_is_what_its_preset_says(stages):
    assert set(pipeline.DATASETS) == {
        "train", "validation", "test", "baseline", "baseline_test", "wide", "wide_test",
    }  # fmt: skip
    expert = pipeline.expert_artifact(stages)
    for name in pipeline.DATASETS:
        wanted = getattr(stages.data, name)
        artifact = pipeline.dataset_artifact(stages, name)
        found = pipeline.dataset(stages, name)
        assert len(found) == wanted.transitions
        np.testing.assert_allclose(found.noise_std_rad, wanted.noise_std_rad)
        assert artifact.manifest["upstream"] == [expert.identity]
        assert artifact.manifest["seed"] == wanted.seed
    with pytest.raises(UnknownNameError, match="unknown data set 'tests': expected one of base"):
        pipeline.dataset(stages, "tests")


def test_transitions_are_the_data_set_and_no_copy(stages):
    episodes = pipeline.dataset(stages, "train")
    found = pipeline.as_transitions(episodes)
    for name in ("states", "actions", "phase"):
        assert np.shares_memory(getattr(found, name), getattr(episodes, name))
    np.testing.assert_array_equal(pipeline.transitions(stages, "train").states, found.states)


def test_a_damaged_data_set_is_refused(stages, monkeypatch, tmp_path):
    monkeypatch.setattr(paths, "CACHE", tmp_path / "other")
    small = replace(stages.data.test, transitions=30, episode_steps=10, robots=2)
    stages = replace(stages, data=replace(stages.data, test=small))
    file = pipeline.dataset_artifact(stages, "test").file("actions.npy")
    file.write_bytes(file.read_bytes()[:-4])
    with pytest.raises(ArtifactError, match=r"actions\.npy has .* bytes"):
        pipeline.dataset(stages, "test")


def test_baseline_sets_are_the_first_seventy_percent_and_the_rest(stages):
    train, validation, test = pipeline.baseline_sets(stages)
    whole = pipeline.dataset(stages, "baseline")
    assert len(train) == round(0.7 * len(whole))
    np.testing.assert_array_equal(np.concatenate([train.states, validation.states]), whole.states)
    np.testing.assert_array_equal(test.states, pipeline.dataset(stages, "baseline_test").states)


def test_held_out_sets_by_noise_come_from_recordings_not_trained_on(stages):
    sets = pipeline.held_out_sets(stages)
    assert list(sets) == ["σ = 0.01", "σ = 0.03", "σ = 0.06", "σ = 0.15"]
    artifacts = pipeline.held_out_artifacts(stages)
    study = open_dataset(artifacts[2].path)
    own = np.isclose(study.noise_std_rad, 0.06)
    assert own.sum() == stages.data.noise_study.robots
    rows = np.repeat(own, study.episode_lengths)
    np.testing.assert_array_equal(sets["σ = 0.06"].states, study.states[rows])
    # The same noise as in the training set, but other draws of it.
    train = np.asarray(pipeline.dataset(stages, "train").actions)
    assert not (sets["σ = 0.06"].actions[:, None] == train).all(axis=2).any()
    names = ("test", "validation", None, "wide_test")
    for name, found in zip(names, sets.values(), strict=True):
        if name:
            np.testing.assert_array_equal(found.states, pipeline.dataset(stages, name).states)


MODELS = {
    "mlp": (pipeline.mlp_artifact, ("baseline", "baseline_test")),
    "transformer": (pipeline.transformer_artifact, ("train", "validation", "test")),
    "causal": (pipeline.causal_artifact, ("train", "wide", "validation")),
}


@pytest.mark.parametrize("kind", MODELS)
def test_models_depend_on_their_data_and_load_as_their_kind(kind, stages):
    make, names = MODELS[kind]
    artifact = make(stages)
    upstream = [pipeline.dataset_artifact(stages, name).identity for name in names]
    assert artifact.manifest["upstream"] == upstream
    assert load_model(artifact.path, kind).context == getattr(stages, kind).context
    assert make(stages).from_cache
    assert (artifact.path / "work").exists() is False, "checkpoints are no part of the result"


def test_other_seed_or_curriculum_is_another_baseline(stages):
    keys = {
        pipeline.mlp_artifact(stages).key,
        pipeline.mlp_artifact(stages, seed=7).key,
        pipeline.mlp_artifact(stages, curriculum=True).key,
    }
    assert len(keys) == 3
    assert pipeline.mlp_artifact(stages, seed=stages.mlp.seed).from_cache


def test_logs_of_real_trainings_carry_figures_and_claims(stages, monkeypatch, tmp_path):
    monkeypatch.setattr(paths, "FIGURES", tmp_path / "figures")
    artifacts = pipeline.transformer_artifact(stages), pipeline.causal_artifact(stages)
    thesis, causal = (curves.read_log(a.file(pipeline.TRAINING_LOG)) for a in artifacts)
    for other in ("test", "validation"):
        _, data = curves.plot_state_prediction(thesis, causal, other, claims.THESIS_LOSSES)
        assert len(data) == 4
    _, data = curves.plot_penalised(thesis)
    parts = data["penalised"]["value"], data["state_prediction"]["value"]
    assert (parts[0] >= parts[1]).all(), "the penalty is added"
    for name in ("train", "validation"):
        _, data = curves.plot_steps(thesis, causal, name)
        assert f"{curves.CAUSAL_LABEL}, step {stages.causal.horizon}" in data
    assert claims.epochs_per_step(thesis).sum() == stages.transformer.epochs
    losses = dict.fromkeys(claims.THESIS_LOSSES, 0.5)
    records = claims.record_training(stages, thesis, artifacts[0], losses)
    records += claims.record_losses(stages, thesis, artifacts[0], 7, losses)
    assert [record["preset"] for record in records] == ["smoke"] * 5
    assert "0.0013" in claims.losses_beside_the_thesis({"a": losses}, thesis)
    mpl.pyplot.close("all")


class ReachedError(Exception):
    """A training would begin."""


def one_point(preset):
    return grid_search.score_table(preset, grid_search.grid_points(preset)[:1])


#: What decides a result's bits on the way: module, function, who calls it.
DECIDING = {
    "mlp": (pipeline, "train_mlp", pipeline.mlp_artifact),
    "transformer": (pipeline, "train_transformer", pipeline.transformer_artifact),
    "causal": (pipeline, "train_causal", pipeline.causal_artifact),
    "grid: training": (grid_search, "train_transformer", one_point),
    "grid: score": (grid_search, "open_loop", one_point),
    "trial": (evaluate, "run_protocol", lambda p: planner_pipeline.planner_trial(p, "cem")),
    "baselines": (planner_pipeline, "run_episodes", planner_pipeline.baselines_artifact),
}


@pytest.mark.parametrize("kind", DECIDING)
def test_results_do_not_depend_on_the_number_of_cores(kind, stages, monkeypatch):
    module, name, make = DECIDING[kind]

    def reached(*arguments, **options):
        raise ReachedError(torch.get_num_threads())

    for data in pipeline.DATASETS:
        pipeline.dataset_artifact(stages, data)
    pipeline.causal_artifact(stages)
    pipeline.reward_only_artifact(stages)
    monkeypatch.setattr(module, name, reached)
    monkeypatch.setenv(recompute.REQUEST, "mlp,transformer,causal,prediction,cem,walking")
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        with pytest.raises(ReachedError, match="^1$"):
            make(stages)
        assert torch.get_num_threads() == 3, "whoever asked has them back"
    finally:
        torch.set_num_threads(before)


def test_models_of_a_notebook_are_those_asked_for_one_by_one(stages):
    single, several = pipeline.mlp_artifacts(stages, range(2))
    alone = [pipeline.mlp_artifact(stages, seed=seed) for seed in range(2)]
    assert [item.key for item in single] == [item.key for item in alone]
    assert several.key == pipeline.mlp_artifact(stages, curriculum=True).key
    point = grid_search.base_point(stages)
    beside = grid_search.point_calls(stages, [point])
    pair = pipeline.transformer_and_causal(stages, beside)
    assert [item.stage for item in pair] == ["transformer", "causal"]
    assert pair[1].key == pipeline.causal_artifact(stages).key
    assert grid_search.point_artifact(stages, point).from_cache, "made beside them"


def test_grid_scores_its_points_on_the_same_windows(stages, capsys, monkeypatch):
    points = grid_search.one_factor_points(stages)
    longer = next(p for p in points if "context" in p.changed(points[0]))
    rows, artifacts = grid_search.score_table(stages, [points[0], points[1], longer])
    assert [row["changed"] for row in rows] == ["", "", "context 8"]
    assert [row["seed"] for row in rows] == [0, 1, 0]
    assert rows[0]["one_step_loss"] != rows[1]["one_step_loss"]
    for row, artifact in zip(rows, artifacts, strict=True):
        score = json.loads(artifact.file(grid_search.SCORE).read_text())
        assert row["one_step_loss"] == score["one_step_loss"] > 0.0
        assert score["windows"] == rows_of(stages)
        assert row["minutes"] == artifact.wall_time_s / 60
    monkeypatch.setattr(grid_search, "resolve", lambda name: stages)
    assert grid_search.main(["point", str(longer.number)]) == 0
    assert json.loads(capsys.readouterr().out) == rows[2]


def rows_of(preset):
    """Windows of the longest history of the grid in the validation set, as far as wanted."""
    length = max(preset.grid.context) + grid_search.HORIZON
    found = len(pipeline.transitions(preset, "validation").window_starts(length))
    return min(found, preset.grid.evaluation_windows)


def test_grid_command_lists_points_and_data(stages, capsys, monkeypatch):
    monkeypatch.setattr(grid_search, "resolve", lambda name: stages)
    assert grid_search.main(["list", "--subset", "all"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert len(listed) == 2**5
    assert listed[0].startswith("0 0 {'batch_size': 16")
    assert grid_search.main(["data"]) == 0
    names = [pipeline.dataset_artifact(stages, name).name for name in ("train", "validation")]
    assert capsys.readouterr().out.split() == names
    assert grid_search.main(["point"]) == 1
    assert "point needs a number" in capsys.readouterr().err
    with pytest.raises(ParameterError, match="expected all or one_factor"):
        grid_search.select_points(stages, "half")
