"""What training descends on: the value of each loss, when it counts, and how sets are measured."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from dynamics_toys import CAUSAL, TRANSFORMER, oscillators

from cassie_lib.dynamics import train_causal as causal_training
from cassie_lib.dynamics import train_window
from cassie_lib.dynamics.losses import component_weights, gradient_penalty
from cassie_lib.dynamics.multi_step import multi_step
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.training import train_causal, train_transformer
from cassie_lib.dynamics.transformer import TransformerModel
from cassie_lib.presets import replace
from cassie_lib.robot import schema

PHYSICAL = schema.PHYSICAL.stop
WEIGHTS = component_weights((1.0, 2.0, 5.0), PHYSICAL)
#: Error of each component in units of its spread, divided by its weight: the loss is its square.
OFF = 0.3


@pytest.fixture(scope="module")
def data():
    return oscillators(4, 30)


class Known:
    """A model that is off by ``OFF`` in every component, in the unit of the loss."""

    context = 4

    def __init__(self, data, window):
        self.normalisation = Normalisation.from_transitions(data)
        self.window = window
        self.off = OFF * self.normalisation.state_std[:PHYSICAL] / WEIGHTS

    def __call__(self, states, actions):
        assert torch.equal(states, self.window.states[:, :-1])
        assert torch.equal(actions, self.window.actions[:, :-1])
        right = self.window.states.diff(dim=1)[..., :PHYSICAL] + self.off
        mean, std = self.normalisation.difference_mean, self.normalisation.difference_std
        return (right - mean[:PHYSICAL]) / std[:PHYSICAL]

    def encode(self, history):
        return history

    def rollout(self, history, actions):
        """The truth of the steps to come, and the error."""
        assert torch.equal(history.states, self.window.states[:, : self.context])
        predicted = self.window.states[:, self.context :].clone()
        predicted[..., :PHYSICAL] += self.off
        assert actions.shape[2] == predicted.shape[1]
        return predicted[:, None]


@pytest.mark.parametrize("loss", ["teacher_forced_loss", "rollout_loss"])
def test_loss_is_the_squared_weighted_error_in_units_of_the_spread(loss, data):
    window = data.gather(data.window_starts(7)[:5], 7)
    found = getattr(causal_training, loss)(Known(data, window), window, WEIGHTS)
    assert found.item() == pytest.approx(OFF**2, rel=1e-3)


def test_the_last_part_of_the_training_is_on_rollouts(data, monkeypatch):
    called = []
    for loss in (causal_training.teacher_forced_loss, causal_training.rollout_loss):

        def noted(*arguments, loss=loss):
            called.append(loss.__name__)
            return loss(*arguments)

        monkeypatch.setattr(causal_training, loss.__name__, noted)
    train_causal(data, replace(CAUSAL, steps=10, rollout_share=0.4), validation=data)
    assert called == ["teacher_forced_loss"] * 6 + ["rollout_loss"] * 4


def test_penalty_is_that_of_the_inputs_per_component(data):
    torch.manual_seed(0)
    model = TransformerModel(replace(TRANSFORMER, dropout=0.0))
    model.normalisation = Normalisation.from_transitions(data)
    window = data.gather(data.window_starts(6)[:3], 6)
    torch.manual_seed(1)
    found = multi_step(model, window, 1, torch.ones(schema.STATE_SIZE), penalised=True)
    torch.manual_seed(1)
    states = model.normalisation.states(window.states[:, : model.context])
    actions = model.normalisation.actions(window.actions[:, : model.context])
    penalty, _ = gradient_penalty(model.outputs, states, actions)
    assert found.penalty.item() == pytest.approx(penalty.item() / 49, rel=1e-5)


def test_what_is_descended_on_and_logged_is_loss_and_penalty(data):
    trained = {
        weight: train_transformer(
            data, replace(TRANSFORMER, dropout=0.0, epochs=1, horizon=1, gradient_penalty=weight),
            validation=data,
        )
        for weight in (0.0, 3.0)
    }  # fmt: skip
    log = trained[3.0].log
    total, loss, penalty = (
        log.series(f"train/{name}")[2][0]
        for name in ("penalised", "state_prediction", "gradient_penalty")
    )
    assert penalty > 0
    assert total == pytest.approx(loss + 3.0 * penalty, rel=1e-5)
    first, second = (trained[weight].model.state_dict() for weight in (0.0, 3.0))
    assert any(not torch.equal(first[name], second[name]) for name in first), "it is descended on"
    assert all(value == 0.0 for value in trained[0.0].log.series("train/gradient_penalty")[2])


def test_a_set_is_measured_window_by_window_however_it_is_cut():
    many = oscillators(17, 40)
    model = TransformerModel(replace(TRANSFORMER, dropout=0.0))
    model.normalisation = Normalisation.from_transitions(many)
    settings = train_window.EpochSettings(horizon=3, epochs=1, batch_size=8, seed=0)
    run = SimpleNamespace(model=model, counters=None)
    loop = train_window.EpochLoop(run, settings, SimpleNamespace(steps=2), None, {"test": many})
    starts = many.window_starts(model.context + 3)
    assert len(starts) > 512
    assert len(starts) % 2, "the parts differ in size"
    found = loop.measure("test")
    # The last windows are far harder: equal weights for the parts would show.
    with torch.no_grad():
        model.eval()
        whole = multi_step(model, many.gather(starts, model.context + 3), 2, loop.weights)
    expected = torch.cat([whole.steps, whole.raw]).numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-5)
