"""The fully connected baseline of section 5.1.1: H stacked pairs in, one difference out."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.window_model import WindowModel, initialise_xavier
from cassie_lib.presets import MLPParameters
from cassie_lib.robot import schema


class MLPModel(WindowModel):
    """ReLU network with equal hidden layers on H * 59 inputs, Xavier initialisation.

    Args:
        parameters: ``context``, ``hidden_layers``, ``hidden_size``.
        normalisation: Statistics of the training data.
    """

    kind = "mlp"

    def __init__(
        self, parameters: MLPParameters, normalisation: Normalisation | None = None
    ) -> None:
        super().__init__(parameters, normalisation)
        width = parameters.context * (schema.STATE_SIZE + schema.ACTION_SIZE)
        layers: list[nn.Module] = []
        for _ in range(parameters.hidden_layers):
            layers += [nn.Linear(width, parameters.hidden_size), nn.ReLU()]
            width = parameters.hidden_size
        layers.append(nn.Linear(width, schema.STATE_SIZE))
        self.network = nn.Sequential(*layers)
        initialise_xavier(self.network)

    def outputs(self, states: Tensor, actions: Tensor) -> Tensor:
        """See :meth:`WindowModel.outputs`."""
        return self.network(torch.cat([states, actions], dim=-1).flatten(1))


__all__ = ["MLPModel"]
