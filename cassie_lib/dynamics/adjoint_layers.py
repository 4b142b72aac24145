"""One layer of the causal model, a step at a time, with its backward pass written by hand.

Rows are candidates: R = E * N.  Keys and values of the candidates' own steps lie in buffers
``(T, E * heads * N, d)``, so that nothing is copied when a step is added; with so few keys the
products are faster element by element than as a thousand tiny matrices.

What no gradient needs lies in a :class:`Workspace` that all layers and steps share: fresh memory
for every product of a thousand rows costs as much as the arithmetic on it.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

_aten = torch.ops.aten


class Workspace:
    """Buffers by name, overwritten by the next use of the same name.

    Args:
        like: Their type and device.
    """

    def __init__(self, like: Tensor) -> None:
        self.like = like
        self.buffers: dict[tuple, Tensor] = {}

    def buffer(self, name: str, *shape: int) -> Tensor:
        """A buffer of that shape, with whatever was left in it."""
        if (name, *shape) not in self.buffers:
            self.buffers[name, *shape] = self.like.new_empty(shape)
        return self.buffers[name, *shape]

    def linear(self, layer: nn.Linear, x: Tensor, name: str) -> Tensor:
        """``layer(x)`` of rows ``x``, in the buffer of that name."""
        out = self.buffer(name, len(x), layer.out_features)
        return torch.addmm(layer.bias, x, layer.weight.t(), out=out)

    def feedforward(self, hidden: Tensor, layer: nn.Linear) -> Tensor:
        """``layer(gelu(hidden))``, in a buffer."""
        active = _aten.gelu.out(hidden, out=self.buffer("active", *hidden.shape))
        return self.linear(layer, active, "mixed")


class Norm:
    """Layer normalisation that remembers what its gradient needs.

    Args:
        norm: Weights.
        space: Where the result is put.
    """

    def __init__(self, norm: nn.LayerNorm, space: Workspace) -> None:
        self.arguments = (list(norm.normalized_shape), norm.weight, norm.bias)
        self.epsilon = norm.eps
        self.space = space

    def forward(self, x: Tensor, saved: list | None) -> Tensor:
        """Normalised rows ``(R, size)``; ``saved`` is None where no gradient follows."""
        y, mean, rstd = _aten.native_layer_norm.out(
            x, *self.arguments, self.epsilon, out0=self.space.buffer("normed", *x.shape),
            out1=x.new_empty(len(x), 1), out2=x.new_empty(len(x), 1),
        )  # fmt: skip
        if saved is not None:
            saved.append((x, mean, rstd))
        return y

    def backward(self, gradient: Tensor, saved: list) -> Tensor:
        """Gradient in the rows that :meth:`forward` was given last."""
        x, mean, rstd = saved.pop()
        shape, weight, bias = self.arguments
        return _aten.native_layer_norm_backward(
            gradient, x, shape, mean, rstd, weight, bias, [True, False, False]
        )[0]


class Layer:
    """One transformer block, a step at a time, over E * N rows.

    Args:
        block: Weights.
        keys, values: History ``(E, heads, M, d)``.
        candidates: N.
        steps: T.
        space: Buffers for what no gradient needs.
    """

    def __init__(
        self, block, keys: Tensor, values: Tensor, candidates: int, steps: int, space: Workspace
    ) -> None:
        episodes, heads, past, size = keys.shape
        self.block, self.shape, self.space = block, (episodes, candidates, heads, size), space
        self.keys, self.values = keys.flatten(0, 1), values.flatten(0, 1)
        rows = episodes * heads * candidates
        self.own = keys.new_empty(2, steps, rows, size)
        self.own_keys, self.own_values = self.own
        self.past = past
        self.norms = Norm(block.norm_attention, space), Norm(block.norm_feedforward, space)
        ahead = torch.arange(past + steps, device=keys.device).flip(0)
        # Step s uses the entries from steps - 1 - s on: oldest key first, the query itself last.
        bias = block.bias(ahead).repeat(episodes, 1)[:, None]
        self.bias = bias
        self.steps = steps
        self.saved: list[Any] = []
        self.own_gradient = keys.new_empty(0)  # made by backward

    def _heads(self, rows: Tensor, parts: int = 1) -> Tensor:
        """Rows ``(R, parts * heads * d)`` as ``(parts, E, heads, N, d)``: a view."""
        episodes, candidates, heads, size = self.shape
        return rows.view(episodes, candidates, parts, heads, size).permute(2, 0, 3, 1, 4)

    def _rows(self, split: Tensor, parts: int = 1) -> Tensor:
        """The inverse of :meth:`_heads`, contiguous."""
        episodes, candidates, heads, size = self.shape
        split = split.view(parts, episodes, heads, candidates, size).permute(1, 3, 0, 2, 4)
        return split.reshape(episodes * candidates, parts * heads * size)

    def _recent(self, scores: Tensor) -> Tensor:
        """Own part of scores ``(E * heads, N, M + J)``, as ``(J, E * heads * N, 1)``."""
        return scores[..., self.past :].permute(2, 0, 1).reshape(-1, self.own.shape[2], 1)

    def _products(self, a: Tensor, b: Tensor) -> Tensor:
        """Element by element ``(J, E * heads * N, d)``, in a buffer."""
        whole = self.space.buffer("products", *self.own.shape[1:])
        return torch.mul(a, b, out=whole[: len(a)])

    def forward(self, x: Tensor, step: int, keep: bool) -> Tensor:
        """Rows ``(R, size)`` of one step; ``x`` is overwritten unless it is kept.

        Args:
            x: ``(R, size)``.
            step: 0 to T - 1, in that order.
            keep: Keep what :meth:`backward` needs, ``x`` among it.

        Returns:
            ``(R, size)``.
        """
        block, space, saved = self.block, self.space, self.saved if keep else None
        projected = space.linear(block.projection, self.norms[0].forward(x, saved), "projected")
        split = self._heads(projected, 3)
        self.own[:, step].view(split[1:].shape).copy_(split[1:])
        q = torch.mul(split[0], block.scale, out=x.new_empty(split[0].shape)).flatten(0, 1)
        flat, seen, first = q.view(-1, q.shape[-1]), slice(0, step + 1), self.steps - 1 - step
        past_bias, own_bias = self.bias[..., first:].split((self.past, step + 1), dim=-1)
        shared = torch.baddbmm(past_bias, q, self.keys.transpose(1, 2))
        own = self._products(self.own_keys[seen], flat).sum(-1)
        own = own.view(step + 1, *q.shape[:2]).permute(1, 2, 0) + own_bias
        weights = torch.cat([shared, own], dim=-1).softmax(dim=-1)
        attended = torch.bmm(weights[..., : self.past], self.values)
        recent = self._products(self.own_values[seen], self._recent(weights))
        attended += recent.sum(0).view_as(attended)
        mixed = space.linear(block.output, self._rows(attended), "mixed")
        x = x + mixed if keep else x.add_(mixed)
        normed = self.norms[1].forward(x, saved)
        hidden = block.expand(normed) if keep else space.linear(block.expand, normed, "hidden")
        if keep:
            self.saved.append((q, weights, hidden))
        mixed = space.feedforward(hidden, block.contract)
        return x + mixed if keep else x.add_(mixed)

    def backward(self, gradient: Tensor, step: int) -> Tensor:
        """Gradient in the input rows from that in the output rows; steps in reverse order."""
        block = self.block
        q, weights, hidden = self.saved.pop()
        inner = _aten.gelu_backward(gradient @ block.contract.weight, hidden)
        gradient = gradient + self.norms[1].backward(inner @ block.expand.weight, self.saved)
        attended = self._heads(gradient @ block.output.weight)[0].flatten(0, 1).contiguous()
        projected = self._attention_backward(attended, q, weights, step) @ block.projection.weight
        return gradient + self.norms[0].backward(projected, self.saved)

    def _attention_backward(self, g: Tensor, q: Tensor, weights: Tensor, step: int) -> Tensor:
        """Gradient ``(R, 3 * size)`` in queries, keys and values of the step."""
        if not len(self.own_gradient):
            self.own_gradient = torch.zeros_like(self.own)
        key_gradient, value_gradient = self.own_gradient
        seen = slice(0, step + 1)
        flat, incoming = q.view(-1, q.shape[-1]), g.view(-1, q.shape[-1])
        value_gradient[seen].addcmul_(self._recent(weights), incoming)
        own = self._products(self.own_values[seen], incoming).sum(-1).view(step + 1, *q.shape[:2])
        shared = torch.bmm(g, self.values.transpose(1, 2))
        scores = _aten._softmax_backward_data(
            torch.cat([shared, own.permute(1, 2, 0)], dim=-1), weights, -1, weights.dtype
        )
        own = self._recent(scores)
        key_gradient[seen].addcmul_(own, flat)
        query = torch.bmm(scores[..., : self.past], self.keys)
        query += self._products(self.own_keys[seen], own).sum(0).view_as(query)
        query *= self.block.scale
        grown = [part[step].view_as(q) for part in (key_gradient, value_gradient)]
        return self._rows(torch.stack([query, *grown]), 3)


__all__ = ["Layer", "Norm", "Workspace"]
