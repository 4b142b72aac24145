"""Three presets with the same fields; the thesis's values stand in the thesis preset."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, fields, is_dataclass

import pytest

from cassie_lib import presets
from cassie_lib.errors import UnknownNameError
from cassie_lib.files import canonical_json
from cassie_lib.robot import schema

SECTIONS = [field.name for field in fields(presets.Preset) if field.name != "name"]


@pytest.fixture(params=["smoke", "laptop", "thesis"])
def preset(request):
    return presets.get_preset(request.param)


def test_there_are_three():
    assert set(presets.PRESETS) == {"smoke", "laptop", "thesis"}
    assert all(name == preset.name for name, preset in presets.PRESETS.items())


def test_every_section_is_frozen_and_can_be_hashed_for_an_artifact(preset):
    for name in SECTIONS:
        section = getattr(preset, name)
        assert is_dataclass(section)
        assert canonical_json(section)
        with pytest.raises(FrozenInstanceError):
            setattr(section, fields(section)[0].name, None)


def test_sizes_fit_each_other(preset):
    for model in (preset.transformer, preset.causal):
        assert model.model_size % model.heads == 0
    for planner in (preset.cem, preset.gradient_cem):
        assert 0 < planner.elites <= planner.samples
        assert len(planner.variance) == schema.ACTION_SIZE
        assert planner.iterations >= 1
        assert 0 < planner.discount <= 1
    horizons = {preset.cem.horizon, preset.gradient_cem.horizon}
    assert max(horizons) <= max(preset.causal.horizon, preset.transformer.horizon)
    assert sum(preset.dagger.split) == pytest.approx(1.0)
    assert all(1 <= n <= preset.dagger.cycle_steps for n in preset.dagger.schedule)
    assert list(preset.dagger.schedule) == sorted(preset.dagger.schedule)
    for collection in (preset.data.train, preset.data.validation, preset.data.test):
        assert collection.episode_steps > preset.transformer.context
        assert collection.noise_std_rad >= 0
    seeds = [getattr(preset.data, field.name).seed for field in fields(preset.data)]
    assert len(set(seeds)) == len(seeds), "no two data sets share their noise"
    steps = schema.CONTROL_PERIOD_S / preset.simulation.timestep_s
    assert steps == pytest.approx(60), "an action is held for 60 physics steps"


def test_smoke_is_small_and_laptop_reports_ten_seeds():
    smoke, laptop = presets.get_preset("smoke"), presets.get_preset("laptop")
    assert smoke.data.train.transitions < 1000
    assert smoke.expert.total_steps < 1000
    assert laptop.evaluation.seeds >= 10
    for name in ("train", "validation", "test", "baseline", "baseline_test"):
        small, real = getattr(smoke.data, name), getattr(laptop.data, name)
        assert small.noise_std_rad == real.noise_std_rad


def test_thesis_preset_holds_the_values_of_the_text():
    thesis = presets.get_preset("thesis")
    data = thesis.data
    assert [data.train.transitions, data.validation.transitions, data.test.transitions] == [
        90_650, 41_650, 41_650,
    ]  # fmt: skip
    model = thesis.transformer
    assert (model.context, model.horizon, model.batch_size) == (30, 10, 128)
    assert (model.learning_rate, model.weight_decay, model.dropout) == (1e-4, 1e-2, 0.1)
    assert (model.gradient_penalty, model.patience, model.change_percent) == (1e-2, 75, 5.0)
    assert model.order_weights == (1.0, 2.0, 5.0)
    cem, gradient = thesis.cem, thesis.gradient_cem
    for planner in (cem, gradient):
        assert (planner.samples, planner.elites, planner.horizon) == (1000, 50, 10)
        assert planner.mean == "zero"
    assert (gradient.gradient_iterations, gradient.learning_rate, gradient.momentum) == (
        7, 7e-2, 0.8,
    )  # fmt: skip
    assert (thesis.dagger.cycle_steps, thesis.dagger.schedule) == (27, (1, 2))
    mlp = thesis.mlp
    assert (mlp.context, mlp.hidden_layers, mlp.hidden_size, mlp.epochs) == (100, 3, 5000, 25)


def test_unknown_presets_are_refused_with_the_known_ones(monkeypatch):
    with pytest.raises(UnknownNameError, match=r"'big': expected one of laptop, smoke, thesis"):
        presets.get_preset("big")
    monkeypatch.setenv("CASSIE_PRESET", "bigger")
    with pytest.raises(UnknownNameError, match="'bigger'"):
        presets.resolve("smoke")


def test_the_variable_overrides_the_cell(monkeypatch):
    monkeypatch.delenv("CASSIE_PRESET", raising=False)
    assert presets.resolve("laptop").name == "laptop"
    monkeypatch.setenv("CASSIE_PRESET", "")
    assert presets.resolve("laptop").name == "laptop"
    monkeypatch.setenv("CASSIE_PRESET", "smoke")
    assert presets.resolve("laptop").name == "smoke"
