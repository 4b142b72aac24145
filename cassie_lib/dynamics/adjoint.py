"""The cached rollout of a frozen causal model with its backward pass written by hand.

A planner differentiates a rollout of a few candidates many times in one control step.  At that
size automatic differentiation spends most of its time on bookkeeping, not on arithmetic; with the
weights fixed only the gradient in the actions is needed, and the chain rule through one layer is
short.  Same numbers as :meth:`CausalModel.rollout` (tested), a multiple of its speed.

Rows are candidates: R = E * N.  Keys and values of the candidates' own steps lie in buffers
``(T, E * heads * N, d)``, so that nothing is copied when a step is added; with so few keys the
products are faster element by element than as a thousand tiny matrices.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from cassie_lib.dynamics.model import complete_state, known_components
from cassie_lib.robot import schema

_aten = torch.ops.aten


class _Norm:
    """Layer normalisation that remembers what its gradient needs."""

    def __init__(self, norm: torch.nn.LayerNorm) -> None:
        self.arguments = (list(norm.normalized_shape), norm.weight, norm.bias)
        self.epsilon = norm.eps

    def forward(self, x: Tensor, saved: list) -> Tensor:
        y, mean, rstd = _aten.native_layer_norm(x, *self.arguments, self.epsilon)
        saved.append((x, mean, rstd))
        return y

    def backward(self, gradient: Tensor, saved: list) -> Tensor:
        x, mean, rstd = saved.pop()
        shape, weight, bias = self.arguments
        return _aten.native_layer_norm_backward(
            gradient, x, shape, mean, rstd, weight, bias, [True, False, False]
        )[0]


class _Layer:
    """One transformer block, a step at a time, over E * N rows.

    Args:
        block: Weights.
        keys, values: History ``(E, heads, M, d)``.
        candidates: N.
        steps: T.
    """

    def __init__(self, block, keys: Tensor, values: Tensor, candidates: int, steps: int) -> None:
        episodes, heads, past, size = keys.shape
        self.block, self.shape = block, (episodes, candidates, heads, size)
        self.keys, self.values = keys.flatten(0, 1), values.flatten(0, 1)
        rows = episodes * heads * candidates
        self.own_keys = keys.new_empty(steps, rows, size)
        self.own_values = keys.new_empty(steps, rows, size)
        self.past = past
        self.norms = _Norm(block.norm_attention), _Norm(block.norm_feedforward)
        ahead = torch.arange(past + steps, device=keys.device).flip(0)
        # Step s uses the entries from steps - 1 - s on: oldest key first, the query itself last.
        bias = block.bias(ahead).repeat(episodes, 1)[:, None]
        self.bias = bias
        self.steps = steps
        self.saved: list[Any] = []
        self.key_gradient = self.value_gradient = keys.new_empty(0)  # made by backward

    def _heads(self, rows: Tensor, parts: int = 1) -> Tensor:
        """Rows ``(R, parts * heads * d)`` to ``(parts, E * heads, N, d)``, contiguous."""
        episodes, candidates, heads, size = self.shape
        split = rows.view(episodes, candidates, parts, heads, size).permute(2, 0, 3, 1, 4)
        return split.contiguous().view(parts, episodes * heads, candidates, size)

    def _rows(self, split: Tensor, parts: int = 1) -> Tensor:
        """The inverse of :meth:`_heads`."""
        episodes, candidates, heads, size = self.shape
        split = split.view(parts, episodes, heads, candidates, size).permute(1, 3, 0, 2, 4)
        return split.reshape(episodes * candidates, parts * heads * size)

    def _recent(self, scores: Tensor) -> Tensor:
        """Own part of scores ``(E * heads, N, M + J)``, as ``(J, E * heads * N, 1)``."""
        return scores[..., self.past :].permute(2, 0, 1).reshape(-1, self.own_keys.shape[1], 1)

    def forward(self, x: Tensor, step: int) -> Tensor:
        """Rows ``(R, size)`` of one step."""
        block, saved = self.block, self.saved
        projected = block.projection(self.norms[0].forward(x, saved))
        q, k, v = self._heads(projected, 3).unbind(0)
        flat, first = q.view(-1, q.shape[-1]), self.steps - 1 - step
        self.own_keys[step], self.own_values[step] = k.view_as(flat), v.view_as(flat)
        past_bias, own_bias = self.bias[..., first:].split((self.past, step + 1), dim=-1)
        shared = torch.baddbmm(past_bias, q, self.keys.transpose(1, 2), alpha=block.scale)
        own = (self.own_keys[: step + 1] * (flat * block.scale)).sum(-1)
        own = own.view(step + 1, *q.shape[:2]).permute(1, 2, 0) + own_bias
        weights = torch.cat([shared, own], dim=-1).softmax(dim=-1)
        recent = self._recent(weights) * self.own_values[: step + 1]
        attended = torch.bmm(weights[..., : self.past], self.values)
        attended += recent.sum(0).view_as(attended)
        x = x + block.output(self._rows(attended))
        hidden = block.expand(self.norms[1].forward(x, saved))
        saved.append((q, weights, hidden))
        return x + block.contract(torch.nn.functional.gelu(hidden))

    def backward(self, gradient: Tensor, step: int) -> Tensor:
        """Gradient in the input rows from that in the output rows; steps in reverse order."""
        block = self.block
        q, weights, hidden = self.saved.pop()
        inner = _aten.gelu_backward(gradient @ block.contract.weight, hidden)
        gradient = gradient + self.norms[1].backward(inner @ block.expand.weight, self.saved)
        attended = self._heads(gradient @ block.output.weight)[0]
        projected = self._attention_backward(attended, q, weights, step) @ block.projection.weight
        return gradient + self.norms[0].backward(projected, self.saved)

    def _attention_backward(self, g: Tensor, q: Tensor, weights: Tensor, step: int) -> Tensor:
        """Gradient ``(R, 3 * size)`` in queries, keys and values of the step."""
        if not len(self.key_gradient):
            self.key_gradient = torch.zeros_like(self.own_keys)
            self.value_gradient = torch.zeros_like(self.own_values)
        scale, seen = self.block.scale, slice(0, step + 1)
        flat, incoming = q.view(-1, q.shape[-1]), g.view(-1, q.shape[-1])
        self.value_gradient[seen].addcmul_(self._recent(weights), incoming)
        own = (self.own_values[seen] * incoming).sum(-1).view(step + 1, *q.shape[:2])
        shared = torch.bmm(g, self.values.transpose(1, 2))
        scores = _aten._softmax_backward_data(
            torch.cat([shared, own.permute(1, 2, 0)], dim=-1), weights, -1, weights.dtype
        )
        own = self._recent(scores)
        self.key_gradient[seen].addcmul_(own, flat, value=scale)
        query = torch.bmm(scores[..., : self.past], self.keys)
        query = (query + (own * self.own_keys[seen]).sum(0).view_as(query)) * scale
        grown = [part[step].view_as(q) for part in (self.key_gradient, self.value_gradient)]
        return self._rows(torch.stack([query, *grown]), 3)


class _Tape:
    """Forward and backward pass of one rollout."""

    def __init__(self, model, encoded, candidates: int, steps: int) -> None:
        self.model, self.encoded = model, encoded
        self.candidates, self.steps = candidates, steps
        self.layers = [
            _Layer(block, keys, values, candidates, steps)
            for block, keys, values in zip(
                model.blocks, encoded.keys, encoded.values, strict=True
            )
        ]
        self.norm = _Norm(model.norm)
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
            direct, hidden = model.embed(pair).split(model.embed_split, dim=-1)
            x = direct + model.embed_output(torch.nn.functional.gelu(hidden))
            for layer in self.layers:
                x = layer.forward(x, step)
            difference = model.normalisation.to_differences(
                model.head(self.norm.forward(x, self.saved))
            )
            moved = state[:, schema.PELVIS_ORIENTATION] + difference[:, schema.PELVIS_ORIENTATION]
            state = complete_state(state, difference, known[:, step])
            self.saved.append((hidden, moved, state))
            states.append(state)
            if not keep:
                for saved in (self.saved, *(layer.saved for layer in self.layers)):
                    saved.clear()
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
