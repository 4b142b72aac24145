"""Eqs 3.6 and 3.9 over the steps of a window, with the model's own states fed back (Eq 3.7)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from cassie_lib.dynamics.losses import gradient_penalty, state_prediction_loss
from cassie_lib.dynamics.model import complete_state, known_components
from cassie_lib.dynamics.window_model import WindowModel
from cassie_lib.dynamics.windows import Window
from cassie_lib.robot import schema

_PHYSICAL = schema.PHYSICAL.stop


class MultiStep(NamedTuple):
    """Losses of one batch.

    Attributes:
        steps: State prediction loss of each step ``(t,)``; their mean is Eq 3.6.
        raw: The same in raw units, detached.
        penalty: Mean gradient penalty over the steps, without lambda; 0 if not asked for.
    """

    steps: Tensor
    raw: Tensor
    penalty: Tensor


def multi_step(
    model: WindowModel, window: Window, steps: int, weights: Tensor, penalised: bool = False
) -> MultiStep:
    """Predict ``steps`` differences from a window, each from the states predicted before.

    Errors are normalised differences, weighted and averaged over the 49 components; clock and
    speed are known, hence without error.  The penalty is divided by 49 likewise, so that loss and
    penalty keep the proportion of Eq 3.9.

    Args:
        model: Model of context H.
        window: At least H + ``steps`` states; of more, the last ones are not used.
        steps: t.
        weights: w ``(49,)``.
        penalised: Whether to compute the gradient penalty.
    """
    context, normalisation = model.context, model.normalisation
    states = window.states[:, :context]
    known = known_components(states[:, -1], window.phase[:, context - 1], steps)
    actions = normalisation.actions(window.actions)
    truth = window.states[:, context - 1 : context + steps].diff(dim=1)
    losses, raw, penalties = [], [], []
    for step in range(steps):
        inputs = normalisation.states(states[:, step:]), actions[:, step : step + context]
        if penalised:
            penalty, output = gradient_penalty(model.outputs, *inputs)
            penalties.append(penalty / schema.STATE_SIZE)
        else:
            output = model.outputs(*inputs)
        target = normalisation.differences(truth[:, step])
        target = torch.cat([target[:, :_PHYSICAL], output[:, _PHYSICAL:].detach()], dim=1)
        output = torch.cat([output[:, :_PHYSICAL], output[:, _PHYSICAL:].detach()], dim=1)
        losses.append(state_prediction_loss(output, target, weights))
        with torch.no_grad():
            spread = normalisation.difference_std
            raw.append(state_prediction_loss(output * spread, target * spread, weights))
        difference = normalisation.to_differences(output)
        following = complete_state(states[:, -1], difference, known[:, step])
        states = torch.cat([states, following[:, None]], dim=1)
    penalty = torch.stack(penalties).mean() if penalties else losses[0].new_zeros(())
    return MultiStep(torch.stack(losses), torch.stack(raw), penalty)


__all__ = ["MultiStep", "multi_step"]
