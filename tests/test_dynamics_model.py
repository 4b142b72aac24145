"""Histories, phase, completion of states: what all dynamics models share."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from dynamics_toys import MLP, make_actions, make_history, oscillators, randomise

from cassie_lib.dynamics import model as shared
from cassie_lib.dynamics import window_model
from cassie_lib.dynamics.mlp import MLPModel
from cassie_lib.errors import NonFiniteError, ParameterError, SchemaError, ShapeError
from cassie_lib.robot import schema


def test_phase_is_inferred_across_the_wrap():
    """27 and 0 have one clock; the step before tells them apart."""
    phases = np.arange(60) % schema.PERIOD
    states = torch.zeros(59, 2, schema.STATE_SIZE)
    states[:, 0, schema.CLOCK] = torch.from_numpy(schema.clock(phases[:-1])).float()
    states[:, 1, schema.CLOCK] = torch.from_numpy(schema.clock(phases[1:])).float()
    assert shared.infer_phase(states).tolist() == phases[1:].tolist()


@pytest.mark.parametrize("start", [25, 26, 27, 0])
def test_clock_is_exact_across_the_wrap(start):
    now = torch.zeros(1, schema.STATE_SIZE, dtype=torch.float64)
    now[:, schema.SPEED] = 0.3
    known = shared.known_components(now, torch.tensor([start]), 5)
    expected = schema.clock((start + np.arange(1, 6)) % schema.PERIOD)
    assert np.array_equal(known[0, :, :2].numpy(), expected)
    assert (known[..., 2] == 0.3).all()


def test_predicted_clock_equals_recorded_clock_over_two_cycles():
    data = oscillators(episodes=1, length=70)
    model = MLPModel(MLP)
    window = data.gather([0], 70)
    history = shared.History(window.states[:, :4], window.actions[:, :3])
    predicted = model.predict(history, window.actions[:, None, 3:-1])
    assert torch.equal(predicted[0, 0, :, schema.CLOCK], window.states[0, 4:, schema.CLOCK])
    assert (predicted[..., schema.SPEED] == window.states[0, 0, 48]).all()


def test_quaternion_stays_unit_and_keeps_its_sign():
    previous = make_history().states[:, -1]
    for sign in (1.0, -1.0):
        start = previous.clone()
        start[:, schema.PELVIS_ORIENTATION] *= sign
        difference = 0.1 * torch.randn(2, 46)
        following = shared.complete_state(start, difference, start[:, 46:])
        q = following[:, schema.PELVIS_ORIENTATION]
        assert torch.allclose(q.norm(dim=-1), torch.ones(2))
        assert ((q * start[:, schema.PELVIS_ORIENTATION]).sum(-1) > 0.9).all()


def test_completion_adds_differences_to_the_other_components():
    previous, difference = make_history().states[:, -1], torch.randn(2, 46)
    following = shared.complete_state(previous, difference, previous[:, 46:])
    others = [i for i in range(46) if i not in range(1, 5)]
    expected = (previous[:, :46] + difference)[:, others]
    assert torch.equal(following[:, others], expected)


def test_given_phase_is_used_and_checked():
    history = make_history()
    assert torch.equal(shared.phase_of(history), history.phase)
    assert torch.equal(shared.phase_of(history._replace(phase=None)), history.phase)
    with pytest.raises(ParameterError, match="outside 0..27"):
        shared.phase_of(history._replace(phase=torch.tensor([0, 28])))
    with pytest.raises(ShapeError, match="phase has shape"):
        shared.phase_of(history._replace(phase=torch.tensor([0])))


def test_bad_histories_are_named():
    good = make_history(2, 6)
    with pytest.raises(ShapeError, match="6 states: expected at least 7"):
        shared.check_history(good, 7)
    with pytest.raises(ShapeError, match=r"expected \(E, H, 49\)"):
        shared.check_history(good._replace(states=good.states[..., :48]), 4)
    with pytest.raises(ShapeError, match=r"history actions have shape"):
        shared.check_history(good._replace(actions=good.actions[:, 1:]), 4)
    broken = good.actions.clone()
    broken[0, 0, 0] = float("inf")
    with pytest.raises(NonFiniteError, match="history actions"):
        shared.check_history(good._replace(actions=broken), 4)
    with pytest.raises(SchemaError, match="component order"):
        shared.check_history(good._replace(states=good.states.flip(-1)), 4)
    with pytest.raises(ParameterError, match="one device"):
        shared.check_history(good._replace(actions=good.actions.to("meta")), 4)


def test_window_model_predicts_in_chunks_as_in_one_piece(monkeypatch):
    model = randomise(MLPModel(MLP)).eval().double()
    history, actions = make_history(2, 4), make_actions(2, 5, 3)
    whole = model.predict(history, actions)
    monkeypatch.setattr(window_model, "CHUNK", 3)
    with torch.no_grad():
        pieces = model.predict(history, actions)
    assert torch.allclose(whole, pieces)
    assert isinstance(model, shared.DynamicsModel)


def test_window_slides_over_predictions():
    """Predicting two steps equals predicting one, then one more from the longer history."""
    model = randomise(MLPModel(MLP)).eval()
    history, actions = make_history(2, 4), make_actions(2, 1, 2)
    both = model.predict(history, actions)[:, 0]
    longer = shared.History(
        torch.cat([history.states, both[:, :1]], 1),
        torch.cat([history.actions, actions[:, 0, :1]], 1),
        None,
        (history.phase + 1) % schema.PERIOD,
    )
    again = model.predict(longer, actions[:, :, 1:])[:, 0, 0]
    assert torch.allclose(both[:, 1], again, atol=1e-6)
