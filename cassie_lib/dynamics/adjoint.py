"""The cached rollout of a frozen causal model with its backward pass written by hand.

A planner differentiates a rollout of a few candidates many times in one control step.  At that
size automatic differentiation spends most of its time on bookkeeping, not on arithmetic; with the
weights fixed only the gradient in the actions is needed, and the chain rule through one layer is
short.  Same numbers as :meth:`CausalModel.rollout` (tested), a multiple of its speed.
Rows are candidates: R = E * N.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from cassie_lib.dynamics.adjoint_layers import Layer, Norm, Workspace
from cassie_lib.dynamics.model import complete_state, known_components
from cassie_lib.robot import schema

_aten = torch.ops.aten


class _Tape:
    """Forward and backward pass of one rollout."""

    def __init__(self, model, encoded, candidates: int, steps: int) -> None:
        self.model, self.encoded = model, encoded
        self.candidates, self.steps = candidates, steps
        self.space = Workspace(encoded.now)
        self.layers = [
            Layer(block, keys, values, candidates, steps, self.space)
            for block, keys, values in zip(
                model.blocks, encoded.keys, encoded.values, strict=True
            )
        ]
        self.norm = Norm(model.norm, self.space)
        self.saved: list[Any] = []

    def forward(self, actions: Tensor, keep: bool) -> Tensor:
        """States ``(R, T, 49)`` from actions ``(R, T, 10)``; ``keep`` what a gradient needs."""
        model, encoded = self.model, self.encoded
        known = known_components(encoded.now, encoded.phase, self.steps)
        known = known.repeat_interleave(self.candidates, dim=0)
        state = encoded.now.repeat_interleave(self.candidates, dim=0)
        scaled = model.normalisation.actions(actions)
        states = []
        for step in range(self.steps):
            inputs = model.normalisation.states(state)[:, : model.state_inputs]
            pair = torch.cat([inputs, scaled[:, step]], dim=-1)
            embedded = model.embed(pair) if keep else self.space.linear(model.embed, pair, "hidden")
            direct, hidden = embedded.split(model.embed_split, dim=-1)
            x = direct + self.space.feedforward(hidden, model.embed_output)
            for layer in self.layers:
                x = layer.forward(x, step, keep)
            normed = self.norm.forward(x, self.saved if keep else None)
            difference = model.normalisation.to_differences(model.head(normed))
            moved = state[:, schema.PELVIS_ORIENTATION] + difference[:, schema.PELVIS_ORIENTATION]
            state = complete_state(state, difference, known[:, step])
            states.append(state)
            if keep:
                self.saved.append((hidden, moved, state))
        return torch.stack(states, dim=1)

    def backward(self, gradient: Tensor) -> Tensor:
        """Gradient in the actions ``(R, T, 10)`` from that in the states ``(R, T, 49)``."""
        model, normalisation = self.model, self.model.normalisation
        count = model.head.out_features
        actions = gradient.new_empty(*gradient.shape[:2], schema.ACTION_SIZE)
        carried = torch.zeros_like(gradient[:, 0])
        for step in reversed(range(self.steps)):
            hidden, moved, state = self.saved.pop()
            total = carried + gradient[:, step]
            physical = self._through_quaternion(total, moved, state)[:, :count]
            inner = (physical * normalisation.difference_std[:count]) @ model.head.weight
            x = self.norm.backward(inner, self.saved)
            for layer in reversed(self.layers):
                x = layer.backward(x, step)
            inner = _aten.gelu_backward(x @ model.embed_output.weight, hidden)
            pair = torch.cat([x, inner], dim=-1) @ model.embed.weight
            size = model.state_inputs
            actions[:, step] = pair[:, size:] / normalisation.action_std
            carried = torch.zeros_like(total)
            carried[:, :size] = pair[:, :size] / normalisation.state_std[:size]
            carried[:, :count] += physical
            # The clock is computed from the phase and the speed is a constant of the history:
            # neither carries a gradient from step to step.
        return actions

    @staticmethod
    def _through_quaternion(gradient: Tensor, moved: Tensor, state: Tensor) -> Tensor:
        """Chain rule of q = m / |m|: only the part across q passes, divided by |m|."""
        part = schema.PELVIS_ORIENTATION
        unit, incoming = state[:, part], gradient[:, part]
        across = incoming - unit * (unit * incoming).sum(dim=-1, keepdim=True)
        result = gradient.clone()
        result[:, part] = across / moved.norm(dim=-1, keepdim=True)
        return result


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(ctx, actions: Tensor, model, encoded) -> Tensor:
        episodes, candidates, steps = actions.shape[:3]
        tape = _Tape(model, encoded, candidates, steps)
        rows = actions.to(encoded.now.dtype).reshape(episodes * candidates, steps, -1)
        states = tape.forward(rows, ctx.needs_input_grad[0])
        if ctx.needs_input_grad[0]:
            ctx.tape = tape
        return states.view(episodes, candidates, steps, -1)

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient: Tensor):
        shape = gradient.shape
        rows = ctx.tape.backward(gradient.reshape(-1, *shape[2:]))
        ctx.tape = None
        return rows.view(*shape[:3], -1), None, None


def adjoint_rollout(model, encoded, actions: Tensor) -> Tensor:
    """Roll a frozen causal model out; differentiable once, in the actions only.

    Args:
        model: :class:`~cassie_lib.dynamics.causal.CausalModel` in evaluation mode.
        encoded: Its encoded history.
        actions: ``(E, N, T, 10)``.

    Returns:
        States ``(E, N, T, 49)``.
    """
    return _Rollout.apply(actions, model, encoded)


__all__ = ["adjoint_rollout"]
