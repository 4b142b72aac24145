"""The thesis's transformer: size, masks, gradients."""

from __future__ import annotations

import pytest
import torch
from dynamics_toys import TRANSFORMER, make_actions, make_history, oscillators, randomise

from cassie_lib.dynamics.attention import causal_mask, sinusoidal_positions
from cassie_lib.dynamics.multi_step import multi_step
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.transformer import THESIS_PARAMETER_COUNT, TransformerModel
from cassie_lib.errors import ParameterError
from cassie_lib.presets import get_preset, replace


@pytest.fixture
def model():
    normalisation = Normalisation.from_transitions(oscillators())
    return randomise(TransformerModel(TRANSFORMER, normalisation)).eval()


def test_thesis_preset_has_the_thesis_parameter_count_and_trains_one_step():
    parameters = get_preset("thesis").transformer
    model = TransformerModel(parameters, Normalisation.from_transitions(oscillators()))
    assert sum(p.numel() for p in model.parameters()) == THESIS_PARAMETER_COUNT == 12_919_393
    window = oscillators(1, 45).gather([0, 3], 31)
    losses = multi_step(model, window, 1, torch.ones(49), penalised=True)
    before = model.output.weight.detach().clone()
    optimiser = torch.optim.AdamW(model.parameters(), lr=parameters.learning_rate)
    (losses.steps.mean() + parameters.gradient_penalty * losses.penalty).backward()
    assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in model.parameters())
    optimiser.step()
    assert not torch.equal(before, model.output.weight)


def test_decoder_is_causal_and_encoder_is_not(model):
    states, actions = torch.randn(2, 5, 49), torch.randn(2, 5, 10)
    memory, differences = model.encode(states, actions), torch.randn(2, 4, 49)
    before = model.decode(differences, memory)
    changed = differences.clone()
    changed[:, 2] += 1.0
    after = model.decode(changed, memory)
    assert torch.equal(before[:, :2], after[:, :2])
    assert not torch.allclose(before[:, 2:], after[:, 2:])
    later = states.clone()
    later[:, -1] += 1.0
    assert not torch.allclose(model.encode(later, actions)[:, 0], memory[:, 0])


def test_decoder_reads_the_known_differences(model):
    """Its input is s_2 - s_1 ... s_H - s_{H-1} in normalised units, and no more."""
    window = oscillators().gather([0], 5)
    normalisation = model.normalisation
    known = normalisation.differences(window.states.diff(dim=1))
    states, actions = normalisation.states(window.states), normalisation.actions(window.actions)
    expected = model.decode(known, model.encode(states, actions))[:, -1]
    assert torch.allclose(model(window.states, window.actions), expected, atol=1e-4)


def test_dropout_acts_in_training_only(model):
    window = oscillators().gather([0], 5)
    assert torch.equal(model(*window[:2]), model(*window[:2]))
    model.train()
    assert not torch.equal(model(*window[:2]), model(*window[:2]))


def test_positions_and_mask():
    table = sinusoidal_positions(7, 6)
    assert torch.allclose(table[0], torch.tensor([0.0, 1, 0, 1, 0, 1]))
    assert torch.allclose(table[:, 0], torch.arange(7.0).sin())
    mask = causal_mask(4)
    assert torch.equal(mask == 0, torch.ones(4, 4).tril().bool())


def test_gradient_in_the_actions_matches_finite_differences(model):
    model = model.double()
    history = make_history(1, 5, dtype=torch.float64)
    actions = make_actions(1, 1, 2, dtype=torch.float64).requires_grad_(True)
    assert torch.autograd.gradcheck(lambda a: model.predict(history, a), (actions,), atol=1e-6)


def test_heads_must_divide_the_size():
    with pytest.raises(ParameterError, match="model_size is 8"):
        TransformerModel(replace(TRANSFORMER, heads=3))
