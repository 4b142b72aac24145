"""Value beyond the horizon: the expert's critic, and how well a cycle keeps its speed."""

from __future__ import annotations

from collections.abc import Callable

import torch

from cassie_lib.dynamics.model import History
from cassie_lib.errors import ParameterError
from cassie_lib.robot.schema import PELVIS_VELOCITY, PERIOD, SPEED

#: The critic was trained on rewards divided by this (``expert.ppo``), so that values are of order
#: one; here they are added to rewards that were not.
CRITIC_UNIT = 10.0
#: How sharply a wrong speed costs, s/m: as in the expert's training.
SPEED_SHARPNESS = 4.0

TerminalValue = Callable[[History, torch.Tensor, torch.Tensor], torch.Tensor]


class CriticValue:
    """Terminal value for :class:`cassie_lib.planning.objective.Objective`.

    The critic is recurrent: its memory is filled with the history from a cleared start, once per
    planning problem, and then carried along the predicted states of each candidate.  Its reward is
    that of the expert's training, which holds a gait term besides Eq 3.10, and its discount is the
    training's: a hundred steps by what the expert makes of a state.  It hardly tells a walk from
    one that drifts, so in full it drowns what Eq 3.11 says of velocities.

    Args:
        policy: :class:`cassie_lib.expert.policy.ExpertPolicy`.
        weight: Factor of the value.

    Raises:
        ParameterError: If the weight is negative or not finite.
    """

    def __init__(self, policy, weight: float = 1.0):
        _check("terminal_weight", weight)
        self._policy, self._unit = policy, weight * CRITIC_UNIT
        self._filled: tuple[torch.Tensor, torch.Tensor] | None = None

    def __call__(self, history: History, states: torch.Tensor, phase: torch.Tensor):
        """Value ``(E, N)`` of the last of the states ``(E, N, T, 49)``; differentiable in them."""
        episodes, count, horizon = states.shape[:3]
        memory = self._memory(history).repeat_interleave(count, dim=2)
        sequence = self._policy.normalise(states.flatten(0, 1)).transpose(0, 1)
        starts = torch.zeros(horizon, episodes * count)
        value, _ = self._policy.critic(sequence, memory, starts)
        return self._unit * value[-1, :, 0].view(episodes, count)

    def _memory(self, history: History) -> torch.Tensor:
        """Memory ``(layers, 2, E, hidden)`` after the history; kept for the same history."""
        if self._filled is None or self._filled[0] is not history.states:
            # A plain tensor, not one of inference mode: the gradient loop reads it, too.
            with torch.inference_mode(False), torch.no_grad():
                past = self._policy.normalise(history.states.clone()).transpose(0, 1)
                memory = self._policy.critic.initial_memory(past.shape[1])
                _, memory = self._policy.critic(past, memory, torch.zeros(past.shape[:2]))
            self._filled = history.states, memory
        return self._filled[1]


class CycleSpeed:
    """Terminal value for speeds that a whole cycle keeps, forwards and to the side.

    Eq 3.10 scores the velocity of one moment, which the sway of a walk moves by more than a drift
    does, and its position term is flat a few metres away: a planner that adds the critic to it may
    walk off to the side.  The mean of the last cycle, what is known of it and what is predicted,
    tells the two apart.  The expert's training scores the same
    (:func:`cassie_lib.expert.guidance.velocity_term`).

    Args:
        weight: Value of a cycle at exactly the commanded speed.

    Raises:
        ParameterError: If the weight is negative or not finite.
    """

    def __init__(self, weight: float = 1.0):
        _check("speed_weight", weight)
        self._weight = weight

    def __call__(self, history: History, states: torch.Tensor, phase: torch.Tensor):
        """Value ``(E, N)`` of states ``(E, N, T, 49)`` after a history; differentiable in them."""
        velocity = states[..., PELVIS_VELOCITY][..., -PERIOD:, :2]
        # Shorter where less than a cycle is known.
        known = history.states[:, max(0, history.states.shape[1] + velocity.shape[2] - PERIOD) :]
        past = known[..., PELVIS_VELOCITY][..., :2].sum(dim=1)[:, None]
        mean = (past + velocity.sum(dim=2)) / (known.shape[1] + velocity.shape[2])
        command = history.states[:, -1, SPEED.start, None]
        error = (mean[..., 0] - command).abs() + mean[..., 1].abs()
        return self._weight * torch.exp(-SPEED_SHARPNESS * error)


class TerminalSum:
    """Several terminal values added up.

    Args:
        values: At least one.
    """

    def __init__(self, *values: TerminalValue):
        self._values = values

    def __call__(self, history: History, states: torch.Tensor, phase: torch.Tensor):
        """Their sum ``(E, N)``."""
        return torch.stack([value(history, states, phase) for value in self._values]).sum(dim=0)


def _check(name: str, weight: float) -> None:
    if not 0.0 <= weight < float("inf"):
        raise ParameterError(f"{name} is {weight}: expected a finite number >= 0")
