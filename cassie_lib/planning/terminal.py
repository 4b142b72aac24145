"""Value beyond the horizon: the expert's critic at the last predicted state."""

from __future__ import annotations

import torch

from cassie_lib.dynamics.model import History
from cassie_lib.errors import ParameterError

#: The critic was trained on rewards divided by this (``expert.ppo``), so that values are of order
#: one; here they are added to rewards that were not.
CRITIC_UNIT = 10.0


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
        if not 0.0 <= weight < float("inf"):
            raise ParameterError(f"terminal_weight is {weight}: expected a finite number >= 0")
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
