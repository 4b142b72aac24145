"""The thesis's encoder-decoder dynamics model (sections 3.1.2 and 5.1.2).

Settled here as its parameter count, 12,919,393, demands: sin and cos of pi x and 2 pi x of the 59
inputs go through two hidden layers to 64 numbers and on to the model size; encoder and decoder
have four post-norm layers each and no final norm.  The encoder sees all H pairs unmasked; the
decoder reads the H - 1 known differences under a causal mask, and its last output is delta_H.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from cassie_lib.dynamics.attention import Attention, causal_mask, sinusoidal_positions
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.window_model import WindowModel, initialise_xavier
from cassie_lib.errors import ParameterError
from cassie_lib.presets import TransformerParameters
from cassie_lib.robot import schema

#: Of the ``thesis`` preset (section 5.1.2).
THESIS_PARAMETER_COUNT = 12_919_393
#: The features have period 2, so inputs are scaled to reach 1 at this many standard deviations;
#: unscaled, everything beyond one standard deviation would be folded back.
FEATURE_SPAN = 4.0


class Representation(nn.Module):
    """Periodic features and a ReLU network for one pair: ``(..., 59)`` to ``(..., embedding)``."""

    def __init__(self, parameters: TransformerParameters) -> None:
        super().__init__()
        width = 4 * (schema.STATE_SIZE + schema.ACTION_SIZE)
        layers: list[nn.Module] = []
        for _ in range(parameters.representation_layers):
            layers += [
                nn.Linear(width, parameters.representation_size),
                nn.ReLU(),
                nn.Dropout(parameters.dropout),
            ]
            width = parameters.representation_size
        self.network = nn.Sequential(*layers, nn.Linear(width, parameters.embedding_size))

    def forward(self, pairs: Tensor) -> Tensor:
        """Embed normalised pairs."""
        angle = pairs * (torch.pi / FEATURE_SPAN)
        features = [angle.sin(), angle.cos(), (2 * angle).sin(), (2 * angle).cos()]
        return self.network(torch.cat(features, dim=-1))


class Layer(nn.Module):
    """Post-norm transformer layer; with ``cross`` it also attends to the encoder's output."""

    def __init__(self, parameters: TransformerParameters, cross: bool) -> None:
        super().__init__()
        size, dropout = parameters.model_size, parameters.dropout
        self.attention = Attention(size, parameters.heads, dropout)
        self.attention_norm = nn.LayerNorm(size)
        self.cross = Attention(size, parameters.heads, dropout) if cross else None
        self.cross_norm = nn.LayerNorm(size) if cross else None
        self.expand = nn.Linear(size, parameters.feedforward_size)
        self.contract = nn.Linear(parameters.feedforward_size, size)
        self.feedforward_norm = nn.LayerNorm(size)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, mask: Tensor | None = None, memory: Tensor | None = None):
        """``x`` ``(B, L, size)`` to the same shape."""
        x = self.attention_norm(x + self.dropout(self.attention(x, x, mask)))
        if self.cross is not None and self.cross_norm is not None:
            x = self.cross_norm(x + self.dropout(self.cross(x, memory)))
        hidden = self.dropout(functional.relu(self.expand(x)))
        return self.feedforward_norm(x + self.dropout(self.contract(hidden)))


class TransformerModel(WindowModel):
    """Encoder-decoder over H pairs and H - 1 differences.

    Attention is written as matrix products, so that the gradient penalty of Eq 3.9 can be
    differentiated again on any device.

    Args:
        parameters: Sizes; the defaults are the thesis's.
        normalisation: Statistics of the training data.

    Raises:
        ParameterError: If ``model_size`` is not a multiple of ``heads``.
    """

    kind = "transformer"

    def __init__(
        self, parameters: TransformerParameters, normalisation: Normalisation | None = None
    ) -> None:
        super().__init__(parameters, normalisation)
        size = parameters.model_size
        if size % parameters.heads:
            raise ParameterError(
                f"model_size is {size}: expected a multiple of heads = {parameters.heads}"
            )
        self.representation = Representation(parameters)
        self.encoder_input = nn.Linear(parameters.embedding_size, size)
        self.encoder = nn.ModuleList(
            Layer(parameters, cross=False) for _ in range(parameters.encoder_layers)
        )
        self.decoder_input = nn.Linear(schema.STATE_SIZE, size)
        self.decoder = nn.ModuleList(
            Layer(parameters, cross=True) for _ in range(parameters.decoder_layers)
        )
        self.output = nn.Linear(size, schema.STATE_SIZE)
        self.dropout = nn.Dropout(parameters.dropout)
        length = parameters.context
        self.register_buffer("positions", sinusoidal_positions(length, size), persistent=False)
        self.register_buffer("mask", causal_mask(length - 1), persistent=False)
        initialise_xavier(self)

    def encode(self, states: Tensor, actions: Tensor) -> Tensor:
        """Encoder output ``(B, H, size)`` of normalised pairs; every position sees all."""
        pairs = torch.cat([states, actions], dim=-1)
        x = self.encoder_input(self.representation(pairs)) + self.positions
        x = self.dropout(x)
        for layer in self.encoder:
            x = layer(x)
        return x

    def decode(self, differences: Tensor, memory: Tensor) -> Tensor:
        """Normalised differences ``(B, H - 1, 49)``, each from those before it and ``memory``.

        Output i is the difference that follows input i.
        """
        x = self.decoder_input(differences) + self.positions[: differences.shape[1]]
        x = self.dropout(x)
        for layer in self.decoder:
            x = layer(x, self.mask, memory)
        return self.output(x)

    def outputs(self, states: Tensor, actions: Tensor) -> Tensor:
        """See :meth:`WindowModel.outputs`: the decoder's last output, delta_H."""
        scale = self.normalisation.state_std / self.normalisation.difference_std
        shift = self.normalisation.difference_mean / self.normalisation.difference_std
        known = states.diff(dim=1) * scale - shift
        return self.decode(known, self.encode(states, actions))[:, -1]


__all__ = ["FEATURE_SPAN", "THESIS_PARAMETER_COUNT", "TransformerModel"]
