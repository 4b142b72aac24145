"""Scored action sequences, and the objective bound to one planning problem."""

from __future__ import annotations

from typing import NamedTuple

import torch

from cassie_lib.errors import NonFiniteError, ParameterError
from cassie_lib.planning.objective import Objective
from cassie_lib.planning.planner import Plan


class Candidates(NamedTuple):
    """Scored sequences: ``actions (E, N, T, 10)``, ``value (E, N)``, ``states (E, N, T, 49)``."""

    actions: torch.Tensor
    value: torch.Tensor
    states: torch.Tensor

    def top(self, count: int) -> Candidates:
        """The ``count`` best of each episode, best first.

        Where fewer than ``count`` have a finite prediction the best one fills up, so that a
        sequence that the model cannot predict never enters the next distribution.
        """
        value, order = self.value.topk(count, dim=1)
        order = torch.where(torch.isfinite(value), order, order[:, :1])
        row = torch.arange(order.shape[0], device=order.device)[:, None]
        return Candidates(self.actions[row, order], self.value[row, order], self.states[row, order])


class Scorer:
    """The objective bound to one planning problem; counts and remembers the best it has seen.

    Raises:
        SchemaError, ShapeError: If the history does not fit the model.
    """

    def __init__(self, objective: Objective, history, phase, lateral_m):
        self._objective = objective.bind(history, phase, lateral_m)
        self.non_finite = torch.zeros(len(phase), dtype=torch.long, device=phase.device)
        self.rollouts = 0
        self.best: Candidates | None = None

    def __call__(self, actions: torch.Tensor) -> Candidates:
        """Score ``actions (E, N, T, 10)``; differentiable in them.

        Raises:
            NonFiniteError: If an episode has had no finite prediction so far.
        """
        score = self._objective(actions)
        self.rollouts += actions.shape[1]
        with torch.no_grad():
            self.non_finite = self.non_finite + (~score.finite).sum(dim=1)
            self._keep(Candidates(actions.detach(), score.value.detach(), score.states.detach()))
        return Candidates(actions, score.value, score.states)

    def plan(self) -> Plan:
        """The best sequence scored so far, as a plan of one sampling round.

        Raises:
            ParameterError: If nothing has been scored yet.
        """
        if self.best is None:
            raise ParameterError("no candidates have been scored: expected some before the plan")
        actions, value, states = self.best
        return Plan(
            actions[:, 0], value[:, 0], self.non_finite, self.rollouts, value.T, states[:, 0]
        )

    def _keep(self, candidates: Candidates) -> None:
        best = candidates.top(1)
        if self.best is not None:
            pairs = zip(self.best, best, strict=True)
            best = Candidates(*(torch.cat(pair, dim=1) for pair in pairs)).top(1)
        lost = torch.nonzero(~torch.isfinite(best.value[:, 0])).flatten().tolist()
        if lost:
            raise NonFiniteError(
                f"every candidate of episodes {lost} has a non-finite prediction: expected at "
                f"least one finite one"
            )
        self.best = best
