"""What a planner is: a history in, an action sequence out.  CEM and Gradient-CEM are two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import torch

from cassie_lib.dynamics.model import History
from cassie_lib.planning.objective import Objective


class Plan(NamedTuple):
    """Result of planning for E episodes.

    Attributes:
        actions: ``(E, T, 10)`` rad; the first one is executed.
        imagined_return: ``(E,)`` Eq 3.11 of that sequence on the dynamics model, without what a
            terminal value adds.
        non_finite: ``(E,)`` candidates whose prediction was not finite.
        rollouts: Candidates rolled out per episode, with and without gradients.
        best_by_round: ``(R, E)`` best return of each sampling round, the last one included.
        states: ``(E, T, 49)`` predicted states of the chosen sequence.
    """

    actions: torch.Tensor
    imagined_return: torch.Tensor
    non_finite: torch.Tensor
    rollouts: int
    best_by_round: torch.Tensor
    states: torch.Tensor


class Planner(Protocol):
    """What :class:`~cassie_lib.planning.control.PlannerController` puts in closed loop.

    Attributes:
        objective: Model and reward that it plans with; the controller keeps as many past states
            as the model needs and logs the reward.
    """

    objective: Objective

    @property
    def horizon(self) -> int:
        """T, control steps of a plan."""
        ...

    def reset(self, seeds: Sequence[int]) -> None:
        """Start as many episodes as there are seeds."""

    def plan(
        self, history: History, phase: torch.Tensor, lateral_m: torch.Tensor, episodes: Any = None
    ) -> Plan:
        """Plan for E episodes at once.

        Args:
            history: Of E episodes.
            phase: ``(E,)`` integer phases now, 0..27.
            lateral_m: ``(E,)`` y of the pelvis now, metres.
            episodes: Which of the episodes of :meth:`reset` these are, ``(E,)``.
        """
        ...


__all__ = ["Plan", "Planner"]
