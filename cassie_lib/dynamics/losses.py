"""Losses of section 3.1.3: Eqs 3.4, 3.5, 3.6 and the gradient penalty of Eq 3.9.

The penalty keeps the Lipschitz constant K of Eq 3.8 small.

The thesis does not say in which units its loss is taken.  Every function here takes errors that
are already in the units wanted: *raw* (m, rad, m/s, ...) or *normalised* (each component divided
by the spread of its one-step differences in the training data).  Training uses normalised units,
because in raw ones a few accelerations outweigh everything else; evaluation reports both.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from cassie_lib.errors import ParameterError, ShapeError
from cassie_lib.robot import schema


def component_weights(order_weights: tuple[float, float, float], size: int) -> Tensor:
    """Weights w ``(size,)`` of Eq 3.5 by derivative order (thesis: 1, 2 and 5).

    Args:
        order_weights: Weight of components of order 0, 1 and 2.
        size: The first this many components (49, or 46 without clock and speed).

    Raises:
        ParameterError: If there are not three non-negative weights.
    """
    if len(order_weights) != 3 or min(order_weights) < 0:
        raise ParameterError(f"order weights are {order_weights}: expected three, none negative")
    order = torch.as_tensor(schema.DERIVATIVE_ORDER[:size])
    return torch.tensor(order_weights, dtype=torch.float32)[order]


def state_prediction_loss(
    predicted: Tensor, target: Tensor, weights: Tensor | None = None, reduction: str = "mean"
) -> Tensor:
    """Squared error of differences: Eq 3.4, with ``weights`` Eq 3.5, over steps Eq 3.6.

    ``||w o (target - predicted)||^2`` averaged over all leading axes (windows, and predicted
    steps if there is such an axis).

    Args:
        predicted: Differences ``(..., K)``.
        target: Differences ``(..., K)``.
        weights: w ``(K,)``; None is 1 for all (Eq 3.4).
        reduction: Over components: ``"sum"``, the norm as the equation writes it, or ``"mean"``,
            which is the sum divided by K and what a library's mean squared error gives.

    Raises:
        ShapeError: If the shapes differ.
        ParameterError: If ``reduction`` is unknown.
    """
    if predicted.shape != target.shape:
        raise ShapeError(
            f"predicted has shape {tuple(predicted.shape)}, target {tuple(target.shape)}"
        )
    error = target - predicted
    if weights is not None:
        error = error * weights
    squared = error.square()
    if reduction == "mean":
        return squared.mean()
    if reduction == "sum":
        return squared.sum(dim=-1).mean()
    raise ParameterError(f"reduction is {reduction!r}: expected 'sum' or 'mean'")


def gradient_penalty(
    function: Callable[[Tensor, Tensor], Tensor],
    states: Tensor,
    actions: Tensor,
    projection: str = "random",
) -> tuple[Tensor, Tensor]:
    """Input-gradient penalty of Eq 3.9 and the output that it was taken at.

    The gradient of a vector function is its Jacobian J, and ``||J||^2`` would cost one backward
    pass per component.  ``"random"`` draws signs r and uses ``||J^T r||^2``, whose expectation is
    ``||J||^2`` exactly.  ``"ones"`` takes the gradient of the summed output, the usual code of
    gradient penalties, in which errors of opposite sign cancel.

    Args:
        function: Maps normalised states ``(B, H, 49)`` and actions ``(B, H, 10)`` to ``(B, K)``.
        states: Normalised states; the penalty is differentiable in them and in the weights.
        actions: Normalised actions.
        projection: ``"random"`` or ``"ones"``.

    Returns:
        The penalty, mean over the batch, and the output ``(B, K)``.

    Raises:
        ParameterError: If ``projection`` is unknown.
    """
    if not states.requires_grad:
        states = states.detach().requires_grad_(True)
    if not actions.requires_grad:
        actions = actions.detach().requires_grad_(True)
    output = function(states, actions)
    if projection == "random":
        direction = torch.randint_like(output, 2) * 2.0 - 1.0
    elif projection == "ones":
        direction = torch.ones_like(output)
    else:
        raise ParameterError(f"projection is {projection!r}: expected 'random' or 'ones'")
    gradients = torch.autograd.grad(output, (states, actions), direction, create_graph=True)
    penalty = sum(gradient.square().sum(dim=(-2, -1)) for gradient in gradients)
    return penalty.mean(), output


__all__ = ["component_weights", "gradient_penalty", "state_prediction_loss"]
