"""Eqs 3.4, 3.5, 3.6, 3.9 and the curriculum's condition."""

from __future__ import annotations

import pytest
import torch
from dynamics_toys import MLP, TRANSFORMER, oscillators, randomise
from torch import nn

from cassie_lib.dynamics.curriculum import Curriculum
from cassie_lib.dynamics.losses import component_weights, gradient_penalty, state_prediction_loss
from cassie_lib.dynamics.mlp import MLPModel
from cassie_lib.dynamics.multi_step import multi_step
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.transformer import TransformerModel
from cassie_lib.errors import ParameterError, ShapeError
from cassie_lib.robot import schema


def test_weights_follow_the_derivative_order():
    weights = component_weights((1.0, 2.0, 5.0), 46)
    assert weights.shape == (46,)
    assert (weights[schema.MOTOR_POSITION] == 1).all()
    assert (weights[schema.JOINT_VELOCITY] == 2).all()
    assert (weights[schema.PELVIS_ACCELERATION] == 5).all()
    with pytest.raises(ParameterError, match="three"):
        component_weights((1.0, 2.0), 46)


def test_loss_is_the_weighted_squared_norm():
    predicted, target = torch.randn(6, 49), torch.randn(6, 49)
    weights = component_weights((1.0, 2.0, 5.0), 49)
    expected = ((weights * (target - predicted)) ** 2).sum(1).mean()
    total = state_prediction_loss(predicted, target, weights, "sum")
    assert torch.allclose(total, expected)
    assert torch.allclose(state_prediction_loss(predicted, target, weights), expected / 49)
    plain = state_prediction_loss(predicted, target, reduction="sum")
    assert torch.allclose(plain, (target - predicted).square().sum(1).mean())
    with pytest.raises(ShapeError, match="predicted has shape"):
        state_prediction_loss(predicted, target[:, :5])
    with pytest.raises(ParameterError, match="reduction"):
        state_prediction_loss(predicted, target, reduction="max")


def test_doubling_a_weight_quadruples_its_share():
    predicted, target = torch.zeros(4, 49), torch.zeros(4, 49)
    target[:, schema.PELVIS_ACCELERATION] = 0.3
    light = state_prediction_loss(predicted, target, component_weights((1, 1, 2), 49))
    heavy = state_prediction_loss(predicted, target, component_weights((1, 1, 4), 49))
    assert torch.allclose(heavy, 4 * light)


def test_penalty_of_a_linear_map_is_its_squared_norm():
    matrix = torch.randn(49, 59)

    def function(states, actions):
        return torch.cat([states, actions], -1)[:, -1] @ matrix.T

    states, actions = torch.randn(3, 2, 49), torch.randn(3, 2, 10)
    torch.manual_seed(0)
    draws = [gradient_penalty(function, states, actions)[0] for _ in range(400)]
    norm = matrix.square().sum()
    assert torch.allclose(torch.stack(draws).mean(), norm, rtol=0.03)
    ones = gradient_penalty(function, states, actions, "ones")[0]
    assert torch.allclose(ones, matrix.sum(0).square().sum(), rtol=1e-4)
    with pytest.raises(ParameterError, match="projection"):
        gradient_penalty(function, states, actions, "none")


@pytest.mark.parametrize("kind", ["mlp", "transformer"])
def test_penalty_can_be_differentiated_in_the_weights(kind):
    """Double backward against central differences, float64."""
    made = MLPModel(MLP) if kind == "mlp" else TransformerModel(TRANSFORMER)
    model = randomise(made).double().eval()
    states = torch.randn(2, model.context, 49, dtype=torch.float64)
    actions = torch.randn(2, model.context, 10, dtype=torch.float64)

    def penalty():
        return gradient_penalty(model.outputs, states, actions, "ones")[0]

    parameters = [p for p in model.parameters() if p.ndim == 2]
    gradients = torch.autograd.grad(penalty(), parameters, allow_unused=True)
    step = 1e-6
    for parameter, gradient in zip(parameters, gradients, strict=True):
        flat = parameter.data.view(-1)
        index = flat.numel() // 2
        before = flat[index].item()
        values = []
        for sign in (1, -1):
            flat[index] = before + sign * step
            values.append(penalty().item())
        flat[index] = before
        expected = 0.0 if gradient is None else gradient.view(-1)[index].item()
        assert (values[0] - values[1]) / (2 * step) == pytest.approx(expected, rel=1e-4, abs=1e-6)


def test_multi_step_loss_feeds_predictions_back():
    """Its steps are the differences of what ``predict`` returns for the same actions."""
    from cassie_lib.dynamics.evaluation import split_window

    data = oscillators()
    normalisation = Normalisation.from_transitions(data)
    model = randomise(MLPModel(MLP, normalisation)).eval()
    window = data.gather([0, 9, 50], MLP.context + 3)
    weights = component_weights((1.0, 2.0, 5.0), 49)
    losses = multi_step(model, window, 3, weights)
    history, actions, truth = split_window(window, MLP.context)
    predicted = model.predict(history, actions)[:, 0]
    now = history.states[:, -1:]
    made = torch.cat([now, predicted], 1).diff(dim=1)
    true = torch.cat([now, truth], 1).diff(dim=1)
    free = [i for i in range(46) if i not in range(1, 5)]  # the quaternion is brought to length 1
    error = ((made - true) * weights / normalisation.difference_std)[..., free].square()
    short = torch.zeros(49)
    short[free] = weights[free]
    expected = error.sum(-1).mean(0) / 49
    assert torch.allclose(multi_step(model, window, 3, short).steps, expected, rtol=1e-3)
    assert losses.steps.shape == (3,)
    assert losses.penalty == 0


def test_curriculum_by_percentage():
    rule = Curriculum(horizon=3, patience=2, threshold=5.0)
    falling = [1.0, 0.8, 0.6, 0.5]
    assert not any(rule.update(loss) for loss in falling)
    assert not rule.update(0.55)  # 8 % under two epochs ago
    assert rule.update(0.49)  # 2 %
    assert rule.steps == 2
    # Losses of fewer steps do not count: two epochs more are needed before the rule can hold.
    assert [rule.update(0.9) for _ in range(3)] == [False, False, True]
    assert not any(rule.update(0.9) for _ in range(10))
    assert rule.steps == 3


def test_curriculum_by_slope():
    rule = Curriculum(horizon=2, patience=4, threshold=0.05, rule="slope")
    assert [rule.update(loss) for loss in (2.0, 1.9, 1.8, 1.7)] == [False] * 4
    assert not rule.update(1.7)  # 0.075 per epoch
    assert rule.update(1.72)  # 0.045 per epoch


def test_curriculum_state_and_bad_values():
    rule = Curriculum(4, 2, 5.0)
    for loss in (1.0, 1.0, 1.0, 0.5):
        rule.update(loss)
    other = Curriculum(4, 2, 5.0)
    other.restore(rule.state())
    assert (other.steps, other.losses) == (2, [0.5])
    with pytest.raises(ParameterError, match="rule"):
        Curriculum(4, 2, 5.0, "guess")
    with pytest.raises(ParameterError, match="horizon"):
        Curriculum(0, 2, 5.0)


def test_xavier_initialisation():
    model = MLPModel(MLP)
    layer = next(part for part in model.modules() if isinstance(part, nn.Linear))
    bound = (6.0 / sum(layer.weight.shape)) ** 0.5
    assert layer.weight.abs().max() <= bound
    assert layer.weight.std().item() == pytest.approx(bound / 3**0.5, rel=0.1)
    assert (layer.bias == 0).all()
