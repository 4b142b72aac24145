"""Models that read a window of H pairs and predict one difference: the thesis's two models.

Such a model slides its window over its own predictions and reads all H pairs again for every
candidate and step, which is what the causal model avoids.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from cassie_lib.dynamics.model import (
    History,
    check_actions,
    check_history,
    complete_state,
    known_components,
    phase_of,
)
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.errors import ParameterError

#: Windows per forward pass when nothing is differentiated, to bound memory.
CHUNK = 256


class WindowModel(nn.Module):
    """Base of models f((s_1, a_1), ..., (s_H, a_H)) = delta_H (Eq 3.3).

    A subclass gives ``kind`` and :meth:`outputs`.

    Args:
        parameters: Its section of a preset; ``context`` is H.
        normalisation: Statistics of the training data.
    """

    kind = "window"

    def __init__(self, parameters, normalisation: Normalisation | None = None) -> None:
        super().__init__()
        if parameters.context < 2:
            raise ParameterError(f"context is {parameters.context}: expected at least 2")
        self.parameters_ = parameters
        self.context = parameters.context
        self.normalisation = normalisation or Normalisation()

    def outputs(self, states: Tensor, actions: Tensor) -> Tensor:
        """Normalised difference ``(B, 49)`` of normalised windows ``(B, H, 49)``, ``(B, H, 10)``.

        All three in units of the training data's spread; this is the f whose input gradient
        Eq 3.9 penalises.
        """
        raise NotImplementedError

    def forward(self, states: Tensor, actions: Tensor) -> Tensor:
        """Normalised difference ``(B, 49)`` of windows in physical units."""
        return self.outputs(self.normalisation.states(states), self.normalisation.actions(actions))

    def difference(self, states: Tensor, actions: Tensor) -> Tensor:
        """Difference ``(B, 49)`` to the next state, physical units in and out."""
        return self.normalisation.to_differences(self(states, actions))

    def prepare(self, history: History) -> History:
        """Check a history; there is nothing to encode beforehand.

        Raises:
            ShapeError, NonFiniteError, SchemaError, ParameterError: On a bad history.
        """
        check_history(history, self.context, self.normalisation.state_mean.device)
        return history

    def predict(self, history: History, actions: Tensor) -> Tensor:
        """See :class:`~cassie_lib.dynamics.model.DynamicsModel`."""
        history = self.prepare(history)
        check_actions(actions, history.states.shape[0], history.states.device)
        episodes, candidates, steps = actions.shape[:3]
        dtype = next(self.parameters()).dtype
        known = known_components(history.states[:, -1].to(dtype), phase_of(history), steps)
        parts = [
            value.to(dtype).repeat_interleave(candidates, dim=0)
            for value in (
                history.states[:, -self.context :],
                history.actions[:, history.actions.shape[1] - self.context + 1 :],
                known,
            )
        ]
        parts.append(actions.to(dtype).flatten(0, 1))
        if torch.is_grad_enabled():
            predicted = self._slide(*parts)
        else:
            chunks = [self._slide(*c) for c in zip(*(p.split(CHUNK) for p in parts), strict=True)]
            predicted = torch.cat(chunks)
        return predicted.unflatten(0, (episodes, candidates))

    def _slide(self, states: Tensor, past: Tensor, known: Tensor, future: Tensor) -> Tensor:
        """Predict ``(B, T, 49)`` from windows ``(B, H, 49)`` and ``(B, H - 1, 10)``."""
        steps = future.shape[1]
        actions = torch.cat([past, future], dim=1)
        for step in range(steps):
            window = states[:, step:], actions[:, step : step + self.context]
            following = complete_state(states[:, -1], self.difference(*window), known[:, step])
            states = torch.cat([states, following[:, None]], dim=1)
        return states[:, -steps:]


def initialise_xavier(module: nn.Module) -> None:
    """Xavier-uniform weights and zero biases in every linear layer (thesis, both models)."""
    for part in module.modules():
        if isinstance(part, nn.Linear):
            nn.init.xavier_uniform_(part.weight)
            nn.init.zeros_(part.bias)


__all__ = ["WindowModel", "initialise_xavier"]
