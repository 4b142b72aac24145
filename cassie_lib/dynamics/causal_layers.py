"""Layers of the causal model: attention by distance, over a window or over a shared history."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from cassie_lib.dynamics.attention import merge_heads, split_heads
from cassie_lib.presets import CausalParameters


class Block(nn.Module):
    """Pre-norm transformer layer whose attention is biased by distance in control steps.

    Args:
        parameters: Sizes.
        span: Distances 0..span-1 have a bias of their own; longer ones share the last.
    """

    def __init__(self, parameters: CausalParameters, span: int) -> None:
        super().__init__()
        size = parameters.model_size
        self.heads = parameters.heads
        self.scale = 1.0 / math.sqrt(size // parameters.heads)
        self.dropout = parameters.dropout
        self.norm_attention = nn.LayerNorm(size)
        self.projection = nn.Linear(size, 3 * size)
        self.output = nn.Linear(size, size)
        self.norm_feedforward = nn.LayerNorm(size)
        self.expand = nn.Linear(size, parameters.feedforward_size)
        self.contract = nn.Linear(parameters.feedforward_size, size)
        self.distance_bias = nn.Parameter(torch.zeros(parameters.heads, span))

    def project(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Queries (already scaled), keys and values ``(B, heads, L, d)`` of ``x`` (B, L, size)."""
        q, k, v = self.projection(self.norm_attention(x)).chunk(3, dim=-1)
        return (
            split_heads(q, self.heads) * self.scale,
            split_heads(k, self.heads),
            split_heads(v, self.heads),
        )

    def bias(self, distance: Tensor) -> Tensor:
        """Score bias ``(heads, *distance.shape)``; minus infinity where the distance is < 0."""
        index = distance.clamp(0, self.distance_bias.shape[1] - 1)
        return self.distance_bias[:, index].masked_fill(distance < 0, float("-inf"))

    def finish(self, x: Tensor, attended: Tensor) -> Tensor:
        """Residual and feed-forward half; ``attended`` is ``(B, heads, L, d)``."""
        mixed = self.output(merge_heads(attended))
        x = x + functional.dropout(mixed, self.dropout, self.training)
        hidden = functional.gelu(self.expand(self.norm_feedforward(x)))
        return x + functional.dropout(self.contract(hidden), self.dropout, self.training)


def attend_shared(
    q: Tensor, shared: tuple[Tensor, Tensor], own: tuple[Tensor, Tensor], bias: Tensor
) -> Tensor:
    """One new query per candidate over the shared history and the candidate's own steps.

    Args:
        q: ``(E, heads, N, d)``, scaled.
        shared: History keys and values ``(E, heads, M, d)``.
        own: The candidate's keys and values so far ``(E, heads, N, J, d)``.
        bias: ``(heads, M + J)`` by distance, history first.

    Returns:
        ``(E, heads, N, d)``.
    """
    own_scores = torch.matmul(own[0], q.unsqueeze(-1)).squeeze(-1)
    scores = torch.cat([torch.matmul(q, shared[0].transpose(-1, -2)), own_scores], dim=-1)
    weights = (scores + bias[:, None, :]).softmax(dim=-1)
    past, recent = weights.split((shared[0].shape[2], own[0].shape[3]), dim=-1)
    return torch.matmul(past, shared[1]) + torch.matmul(recent.unsqueeze(-2), own[1]).squeeze(-2)


__all__ = ["Block", "attend_shared"]
