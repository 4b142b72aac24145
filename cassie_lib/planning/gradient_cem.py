"""Gradient-CEM: momentum gradient ascent on the K elites of every CEM iteration (Algorithm 2).

Gradients on all N samples, as in reference [3] of the thesis, are the baseline: each sample is
improved, then the K best are refitted.  The memory that back-propagation holds grows with the
number of sequences that are improved, which is what taking the elites alone saves.
"""

from __future__ import annotations

import torch

from cassie_lib.errors import ParameterError
from cassie_lib.planning.candidates import Candidates, Scorer
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.objective import Objective
from cassie_lib.presets import GradientCEMParameters


def momentum_step(
    actions: torch.Tensor,
    velocity: torch.Tensor,
    gradient: torch.Tensor,
    learning_rate: float,
    momentum: float,
) -> tuple[torch.Tensor, torch.Tensor]:
    """One step of stochastic gradient descent with momentum, as ``torch.optim.SGD`` takes it.

    ``v <- momentum v + g`` and ``a <- a - learning_rate v``, elementwise on any shape; ``v``
    starts at zero.  Written out so that it can be clipped and run on many episodes at once.

    Returns:
        The new actions and velocity.
    """
    velocity = momentum * velocity + gradient
    return actions - learning_rate * velocity, velocity


def normalise(gradient: torch.Tensor) -> torch.Tensor:
    """Give the gradient of each sequence unit Euclidean norm over ``(T, 10)``; zero stays zero.

    Args:
        gradient: ``(E, N, T, 10)``.
    """
    norm = gradient.flatten(2).norm(dim=-1)[..., None, None]
    return gradient / norm.clamp_min(torch.finfo(gradient.dtype).tiny)


class GradientCEM(CEM):
    """Gradient-CEM planner.

    Args:
        objective: Model and reward; the model must be differentiable in the actions.
        parameters: :class:`cassie_lib.presets.GradientCEMParameters`.
        action_cycle: As for :class:`cassie_lib.planning.cem.CEM`.

    Raises:
        ParameterError: If G < 1, the learning rate is not positive or momentum is outside [0, 1),
            besides what :class:`~cassie_lib.planning.cem.CEM` refuses.
    """

    parameters: GradientCEMParameters

    def __init__(self, objective: Objective, parameters: GradientCEMParameters, action_cycle=None):
        if parameters.gradient_iterations < 1:
            raise ParameterError(
                f"gradient_iterations is {parameters.gradient_iterations}: expected at least 1"
            )
        if not 0.0 < parameters.learning_rate < float("inf"):
            raise ParameterError(f"learning_rate is {parameters.learning_rate}: expected > 0")
        if not 0.0 <= parameters.momentum < 1.0:
            raise ParameterError(f"momentum is {parameters.momentum}: expected 0 <= momentum < 1")
        super().__init__(objective, parameters, action_cycle)

    def _improve(self, scorer: Scorer, candidates: Candidates) -> Candidates:
        """Lines 4-7 of Algorithm 2: the elites after G gradient steps, with their new returns."""
        p = self.parameters
        chosen = candidates if p.gradient_on_all else candidates.top(p.elites)
        # A clone made outside inference mode may be differentiated; the drawn samples may not.
        actions = chosen.actions.clone()
        velocity = torch.zeros_like(actions)
        count = p.gradient_iterations
        for done in range(count):
            gradient = self._gradient(scorer, actions)
            # Normalised gradients do not shrink near an optimum: a constant rate is too small at
            # the beginning or too large at the end.
            rate = p.learning_rate * (1.0 - done / count if p.anneal else 1.0)
            actions, velocity = momentum_step(actions, velocity, gradient, rate, p.momentum)
            actions = self._clip(actions)
        with torch.inference_mode():
            return scorer(actions).top(p.elites)

    def _gradient(self, scorer: Scorer, actions: torch.Tensor) -> torch.Tensor:
        """Gradient of the negative sum of returns (line 7) in ``actions (E, K, T, 10)``.

        The returns of different sequences do not share actions, so the gradient of their sum is
        each sequence's own.  Where a prediction or its gradient is not finite it is zero.
        """
        leaf = actions.detach().requires_grad_(True)
        with torch.enable_grad():
            value = scorer(leaf).value
            loss = -value[torch.isfinite(value)].sum()
        (gradient,) = torch.autograd.grad(loss, leaf)
        usable = torch.isfinite(gradient).flatten(2).all(dim=-1)[..., None, None]
        gradient = torch.where(usable, gradient, 0.0)
        return normalise(gradient) if self.parameters.normalise_gradient else gradient
