"""The causal model: cache against recomputation, causality, gradients, positions."""

from __future__ import annotations

import pytest
import torch
from dynamics_toys import CAUSAL, make_actions, make_history, oscillators, randomise

from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.dynamics.model import DynamicsModel
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.errors import NonFiniteError, ParameterError, ShapeError
from cassie_lib.presets import replace


@pytest.fixture
def model():
    normalisation = Normalisation.from_transitions(oscillators())
    return randomise(CausalModel(CAUSAL, normalisation)).eval()


def test_cached_and_uncached_predictions_agree(model):
    history, actions = make_history(2, 6), make_actions(2, 3, 7)
    cached, uncached = model.predict(history, actions), model.predict_uncached(history, actions)
    assert cached.shape == (2, 3, 7, 49)
    assert torch.allclose(cached, uncached, atol=1e-5)


def test_prepared_history_gives_the_same_prediction(model):
    history, actions = make_history(), make_actions()
    prepared = model.prepare(history)
    assert torch.equal(model.predict(prepared, actions), model.predict(history, actions))
    assert isinstance(model, DynamicsModel)


def test_a_longer_history_is_cut_to_the_context(model):
    history, actions = make_history(2, 9), make_actions()
    cut = history._replace(states=history.states[:, -6:], actions=history.actions[:, -5:])
    assert torch.equal(model.predict(history, actions), model.predict(cut, actions))


def test_outputs_do_not_depend_on_later_pairs(model):
    window = oscillators().gather([0, 5], 8)
    before = model(window.states, window.actions)
    window.states[:, 5] += 0.1
    window.actions[:, 5] += 0.1
    after = model(window.states, window.actions)
    assert torch.equal(before[:, :5], after[:, :5])
    assert not torch.allclose(before[:, 5:], after[:, 5:])


def test_predictions_do_not_depend_on_later_actions_or_other_candidates(model):
    history, actions = make_history(), make_actions()
    before = model.predict(history, actions)
    changed = actions.clone()
    changed[:, 1, 2:] += 0.3
    after = model.predict(history, changed)
    assert torch.allclose(before[:, [0, 2]], after[:, [0, 2]], atol=1e-6)
    assert torch.allclose(before[:, 1, :2], after[:, 1, :2], atol=1e-6)
    assert not torch.allclose(before[:, 1, 2:], after[:, 1, 2:])


def test_a_step_looks_back_by_distance_not_by_position(model):
    """The same pairs one step later in a window give the same outputs: time invariance."""
    window = oscillators().gather([0], 8)
    late = model(window.states[:, 1:], window.actions[:, 1:])[:, 0]
    first = model(window.states[:, 1:2], window.actions[:, 1:2])[:, 0]
    assert torch.allclose(late, first, atol=1e-6)


def test_clock_input_is_an_option(model):
    window = oscillators().gather([0], 5)
    shifted = window.states.clone()
    shifted[..., 46:] = shifted[..., 46:].roll(1, -1)
    assert torch.equal(model(window.states, window.actions), model(shifted, window.actions))
    seeing = randomise(CausalModel(replace(CAUSAL, clock_input=True)))
    outputs = seeing(window.states, window.actions), seeing(shifted, window.actions)
    assert not torch.allclose(*outputs)


@pytest.mark.parametrize("frozen", [False, True])
def test_gradient_in_the_actions_matches_finite_differences(model, frozen):
    model = model.double().requires_grad_(not frozen)
    history = make_history(2, 6, dtype=torch.float64)
    actions = make_actions(2, 2, 3, dtype=torch.float64).requires_grad_(True)
    weights = torch.randn(2, 2, 3, 49, dtype=torch.float64)
    weights[..., 46:] = 0.0

    def objective(a):
        return (weights * model.predict(history, a)).sum()

    (gradient,) = torch.autograd.grad(objective(actions), actions)
    numeric = torch.zeros_like(gradient)
    step = 1e-6
    with torch.no_grad():
        for index in torch.cartesian_prod(*(torch.arange(n) for n in (2, 2, 3))):
            for k in (0, 4, 9):
                delta = torch.zeros_like(actions)
                delta[(*index, k)] = step
                change = objective(actions + delta) - objective(actions - delta)
                numeric[(*index, k)] = change / (2 * step)
    chosen = [0, 4, 9]
    assert torch.allclose(gradient[..., chosen], numeric[..., chosen], rtol=1e-5, atol=1e-7)


def test_bad_sizes_and_inputs(model):
    with pytest.raises(ParameterError, match="model_size is 15"):
        CausalModel(replace(CAUSAL, model_size=15))
    history, actions = make_history(), make_actions()
    with pytest.raises(ShapeError, match="expected at least 6"):
        model.predict(make_history(2, 5), actions)
    with pytest.raises(ShapeError, match="actions have shape"):
        model.predict(history, actions[:1])
    with pytest.raises(NonFiniteError):
        model.predict(history, actions * float("nan"))
    with pytest.raises(ParameterError, match="actions are on meta"):
        model.predict(history, actions.to("meta"))
    with pytest.raises(ParameterError, match="history is on cpu, the model on meta"):
        model.to("meta").predict(history, actions)
