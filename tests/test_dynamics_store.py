"""Stored models and open-loop evaluation."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from dynamics_toys import CAUSAL, MLP, TRANSFORMER, make_actions, make_history, oscillators
from safetensors.torch import load_file, save_file

from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.dynamics.evaluation import open_loop
from cassie_lib.dynamics.mlp import MLPModel
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.store import load_model, save_model
from cassie_lib.dynamics.transformer import TransformerModel
from cassie_lib.errors import (
    ArtifactError,
    CheckpointError,
    ParameterError,
    SchemaError,
    UnknownNameError,
)
from cassie_lib.robot import schema

MAKERS = {
    "mlp": (MLPModel, MLP),
    "transformer": (TransformerModel, TRANSFORMER),
    "causal": (CausalModel, CAUSAL),
}


def stored(kind, folder):
    constructor, parameters = MAKERS[kind]
    model = constructor(parameters, Normalisation.from_transitions(oscillators()))
    save_model(folder, model, {"minutes": 1.5})
    return model.eval()


@pytest.mark.parametrize("kind", MAKERS)
def test_model_comes_back_the_same(kind, tmp_path):
    model = stored(kind, tmp_path)
    loaded = load_model(tmp_path, kind)
    history, actions = make_history(2, 6), make_actions(2, 2, 3)
    assert torch.allclose(model.predict(history, actions), loaded.predict(history, actions))
    assert not any(p.requires_grad for p in loaded.parameters())
    assert loaded.parameters_ == model.parameters_
    assert {path.name for path in tmp_path.iterdir()} == {"model.safetensors", "card.json"}


def edit_card(folder, **changes):
    card = json.loads((folder / "card.json").read_text())
    card.update(changes)
    (folder / "card.json").write_text(json.dumps(card))


def test_wrong_cards_and_weights_are_told_apart(tmp_path):
    def fresh(name):
        stored("causal", tmp_path / name)
        return tmp_path / name

    with pytest.raises(ArtifactError, match="missing"):
        load_model(tmp_path / "nowhere")
    with pytest.raises(CheckpointError, match="holds a causal model: expected mlp"):
        load_model(fresh("kind"), "mlp")
    edit_card(fresh("schema"), schema="0")
    with pytest.raises(SchemaError, match="state schema"):
        load_model(tmp_path / "schema")
    edit_card(fresh("norm"), normalisation="0")
    with pytest.raises(SchemaError, match="normalisation"):
        load_model(tmp_path / "norm")
    edit_card(fresh("unknown"), kind="oracle")
    with pytest.raises(UnknownNameError, match="causal, mlp, transformer"):
        load_model(tmp_path / "unknown")
    edit_card(fresh("fields"), parameters={"colour": 1})
    with pytest.raises(CheckpointError, match="unknown parameters"):
        load_model(tmp_path / "fields")
    card = json.loads((fresh("size") / "card.json").read_text())
    edit_card(tmp_path / "size", parameters=card["parameters"] | {"layers": 1})
    with pytest.raises(CheckpointError, match="another architecture"):
        load_model(tmp_path / "size")
    (fresh("text") / "card.json").write_text("{")
    with pytest.raises(ArtifactError, match="not JSON"):
        load_model(tmp_path / "text")


def test_damaged_weights(tmp_path):
    stored("causal", tmp_path)
    path = tmp_path / "model.safetensors"
    tensors = load_file(str(path))
    tensors["head.bias"][0] += 1e-3
    save_file(tensors, str(path))
    with pytest.raises(CheckpointError, match="SHA-256"):
        load_model(tmp_path)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match="damaged"):
        load_model(tmp_path)
    path.unlink()
    with pytest.raises(ArtifactError, match="missing"):
        load_model(tmp_path)


class Truth:
    """Knows the recording: its predictions have no error except the one asked for."""

    context = 6

    def __init__(self, data, error=0.0):
        self.data, self.error = data, error

    def predict(self, history, actions):
        steps = actions.shape[2]
        found = []
        for now in history.states[:, -1]:
            index = int(np.abs(self.data.states - now.numpy()).sum(1).argmin())
            found.append(self.data.states[index + 1 : index + 1 + steps])
        return torch.from_numpy(np.stack(found))[:, None] + self.error


def test_open_loop_of_the_truth_is_zero_and_of_no_change_is_known():
    data = oscillators(3, 30)
    result = open_loop(Truth(data), data, horizon=4, windows=10_000)
    assert result.windows == 3 * 21
    assert np.allclose(result.relative, 0)
    assert result.thesis_loss() == pytest.approx(0, abs=1e-12)
    starts = data.window_starts(10) + 5
    moved = (data.states[starts + 2] - data.states[starts]).astype(float)[:, :46] ** 2
    variance = data.states[:, :46].astype(float).var(0)
    expected = (moved.mean(0) / variance).mean()
    assert result.relative_no_change[1] == pytest.approx(expected, rel=1e-5)


def test_open_loop_of_a_known_error():
    """A constant offset of the states: squared error everywhere, difference error at step 1."""
    data = oscillators(2, 30)
    result = open_loop(Truth(data, 0.1), data, horizon=3)
    assert np.allclose(result.model, 0.01, rtol=1e-3)
    assert np.allclose(result.relative, (0.01 / result.variance).mean(), rtol=1e-3)
    assert np.allclose(result.difference[0], 0.01, rtol=1e-3)
    assert np.allclose(result.difference[1:], 0, atol=1e-10)
    order = schema.DERIVATIVE_ORDER[:46]
    weights = np.array([1.0, 2.0, 5.0])[order]
    expected = 0.01 * (weights**2).sum() / 3
    assert result.thesis_loss(reduction="sum") == pytest.approx(expected, rel=1e-3)
    assert result.thesis_loss() == pytest.approx(expected / 49, rel=1e-3)
    assert result.summary()["relative_step_3"] == result.relative[2]
    with pytest.raises(ParameterError, match="units"):
        result.thesis_loss(units="feet")


@pytest.mark.parametrize("wrong", [{"windows": 0}, {"horizon": 0}, {"batch": -1}])
def test_nothing_to_measure_is_refused(wrong):
    data = oscillators(2, 30)
    ((name, value),) = wrong.items()
    with pytest.raises(ParameterError, match=f"{name} = {value}: expected at least 1"):
        open_loop(Truth(data), data, **wrong)


def test_models_of_different_context_see_the_same_windows():
    data = oscillators(2, 30)
    short = open_loop(Truth(data), data, horizon=4, context=10)
    assert short.windows == 2 * (30 - 14 + 1)
