"""Decoder-only dynamics model with a key-value cache: this project's extension.

One token is one (state, action) pair, and its output is the difference to the next state.  The
history of H - 1 complete pairs is encoded once per control step; after that every candidate costs
one token per predicted step.  The N candidates of an episode share its history keys and values
``(E, heads, H - 1, d)``: the candidates act as so many queries on them, and nothing of the size
N x H is ever laid out.

Time enters as a learned bias on the attention score by distance in control steps.  A distance is
the same number whether the keys come from the cache or are computed afresh, so that both ways give
the same prediction, and a horizon longer than the one trained on needs no new positions.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from cassie_lib.dynamics.adjoint import adjoint_rollout
from cassie_lib.dynamics.causal_layers import Block, attend_shared
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
from cassie_lib.presets import CausalParameters
from cassie_lib.robot import schema

PHYSICAL_SIZE = schema.PHYSICAL.stop


class EncodedHistory(NamedTuple):
    """What :meth:`CausalModel.prepare` keeps of a history.

    Attributes:
        now: Present states ``(E, 49)``.
        phase: Their phases ``(E,)``.
        keys, values: Per layer ``(E, heads, H - 1, d)``.
    """

    now: Tensor
    phase: Tensor
    keys: tuple[Tensor, ...]
    values: tuple[Tensor, ...]


class CausalModel(nn.Module):
    """Causal transformer over (state, action) tokens; physical units in and out.

    The equations of motion hold neither the gait clock nor the commanded speed, so by default
    neither is an input: what a model learns to read from the clock is the expert's habit, and it
    is wrong as soon as a planner drives.

    Args:
        parameters: Sizes; ``context`` is H.
        normalisation: Statistics of the training data.

    Raises:
        ParameterError: If ``model_size`` is not a multiple of ``heads``.
    """

    kind = "causal"

    def __init__(
        self, parameters: CausalParameters, normalisation: Normalisation | None = None
    ) -> None:
        super().__init__()
        if parameters.model_size % parameters.heads:
            raise ParameterError(
                f"model_size is {parameters.model_size}: expected a multiple of {parameters.heads}"
            )
        self.parameters_ = parameters
        self.context = parameters.context
        self.normalisation = normalisation or Normalisation()
        size = parameters.model_size
        states = schema.STATE_SIZE if parameters.clock_input else PHYSICAL_SIZE
        self.state_inputs = states
        self.embed_split = (size, parameters.feedforward_size)
        # A linear path and a hidden layer beside it, whose two first layers are one product.
        self.embed = nn.Linear(states + schema.ACTION_SIZE, size + parameters.feedforward_size)
        self.embed_output = nn.Linear(parameters.feedforward_size, size)
        span = parameters.context + parameters.horizon
        self.blocks = nn.ModuleList(Block(parameters, span) for _ in range(parameters.layers))
        self.norm = nn.LayerNorm(size)
        self.head = nn.Linear(size, PHYSICAL_SIZE)
        self._initialise()

    def _initialise(self) -> None:
        for block in self.blocks:
            # The residual stream starts as the embedding alone: steady first steps.
            nn.init.zeros_(block.output.weight)
            nn.init.zeros_(block.contract.weight)
        nn.init.normal_(self.head.weight, std=1e-3)
        nn.init.zeros_(self.head.bias)

    def tokens(self, states: Tensor, actions: Tensor) -> Tensor:
        """Embed pairs: ``(..., 49)`` and ``(..., 10)`` to ``(..., model_size)``."""
        scaled = self.normalisation.states(states)[..., : self.state_inputs]
        pair = torch.cat([scaled, self.normalisation.actions(actions)], dim=-1)
        direct, hidden = self.embed(pair).split(self.embed_split, dim=-1)
        return direct + self.embed_output(functional.gelu(hidden))

    def forward(self, states: Tensor, actions: Tensor) -> Tensor:
        """Normalised differences after every pair of a window, each from the pairs up to it.

        Args:
            states: ``(B, L, 49)``.
            actions: ``(B, L, 10)``.

        Returns:
            ``(B, L, 46)`` in units of the training differences' spread.
        """
        return self._run(self.tokens(states, actions))[0]

    def _run(self, x: Tensor) -> tuple[Tensor, tuple[Tensor, ...], tuple[Tensor, ...]]:
        steps = torch.arange(x.shape[1], device=x.device)
        distance = steps[:, None] - steps[None, :]
        keys, values = [], []
        for block in self.blocks:
            q, k, v = block.project(x)
            scores = torch.matmul(q, k.transpose(-1, -2)) + block.bias(distance)
            x = block.finish(x, torch.matmul(scores.softmax(dim=-1), v))
            keys.append(k)
            values.append(v)
        return self.head(self.norm(x)), tuple(keys), tuple(values)

    def prepare(self, history: History) -> EncodedHistory:
        """Encode the last H states and H - 1 actions of a history, once per control step.

        Raises:
            ShapeError, NonFiniteError, SchemaError, ParameterError: On a bad history.
        """
        check_history(history, self.context, self.head.weight.device)
        return self.encode(history)

    def encode(self, history: History) -> EncodedHistory:
        """:meth:`prepare` without the checks, for training."""
        dtype = self.head.weight.dtype
        states = history.states[:, -self.context :].to(dtype)
        actions = history.actions[:, states.shape[1] * -1 + 1 :].to(dtype)
        _, keys, values = self._run(self.tokens(states[:, :-1], actions))
        return EncodedHistory(states[:, -1], phase_of(history), keys, values)

    def predict(self, history: History | EncodedHistory, actions: Tensor) -> Tensor:
        """See :class:`~cassie_lib.dynamics.model.DynamicsModel`."""
        if isinstance(history, History):
            history = self.prepare(history)
        check_actions(actions, history.now.shape[0], history.now.device)
        if self.training or any(parameter.requires_grad for parameter in self.parameters()):
            return self.rollout(history, actions)
        return adjoint_rollout(self, history, actions)

    def rollout(self, encoded: EncodedHistory, actions: Tensor) -> Tensor:
        """Predict ``(E, N, T, 49)`` from an encoded history, one token per candidate and step."""
        episodes, candidates, steps = actions.shape[:3]
        known = known_components(encoded.now, encoded.phase, steps)[:, None]
        state = encoded.now[:, None].expand(episodes, candidates, -1)
        biases = self._step_biases(encoded.keys[0].shape[2], steps)
        own: list[list[tuple[Tensor, Tensor]]] = [[] for _ in self.blocks]
        predicted = []
        for step in range(steps):
            x = self.tokens(state, actions[:, :, step].to(state.dtype))
            for index, block in enumerate(self.blocks):
                q, k, v = block.project(x)
                own[index].append((k, v))
                recent = (
                    torch.stack([pair[0] for pair in own[index]], dim=3),
                    torch.stack([pair[1] for pair in own[index]], dim=3),
                )
                shared = (encoded.keys[index], encoded.values[index])
                x = block.finish(x, attend_shared(q, shared, recent, biases[index][step]))
            difference = self.normalisation.to_differences(self.head(self.norm(x)))
            state = complete_state(state, difference, known[:, :, step])
            predicted.append(state)
        return torch.stack(predicted, dim=2)

    def _step_biases(self, past: int, steps: int) -> list[list[Tensor]]:
        """Score biases ``(heads, past + step + 1)`` of every layer and step."""
        position = torch.arange(past + steps, device=self.head.weight.device)
        return [
            [block.bias((past + s) - position[: past + s + 1]) for s in range(steps)]
            for block in self.blocks
        ]

    def predict_uncached(self, history: History, actions: Tensor) -> Tensor:
        """The same predictions by encoding the whole window anew at every step.

        The reference that the cache is tested and timed against; never needed otherwise.
        """
        check_history(history, self.context)
        episodes, candidates, steps = actions.shape[:3]
        flat = [
            part[:, -size:].repeat_interleave(candidates, dim=0)
            for part, size in ((history.states, self.context), (history.actions, self.context - 1))
        ]
        states, past = flat
        known = known_components(history.states[:, -1], phase_of(history), steps)
        known = known.repeat_interleave(candidates, dim=0)
        future = actions.flatten(0, 1)
        for step in range(steps):
            window = torch.cat([past, future[:, : step + 1]], dim=1)
            outputs = self.forward(states, window)[:, -1]
            difference = self.normalisation.to_differences(outputs)
            following = complete_state(states[:, -1], difference, known[:, step])
            states = torch.cat([states, following[:, None]], dim=1)
        return states[:, -steps:].unflatten(0, (episodes, candidates))


__all__ = ["CausalModel", "EncodedHistory"]
