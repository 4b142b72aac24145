"""What one update of recurrent PPO learns from: a rollout, its advantages, its sequences."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor


@dataclass
class Rollout:
    """What the robots saw and did in one update; every tensor is ``(T, N, ...)``, time first.

    Attributes:
        inputs, actions: Normalised states ``(T, N, 49)`` and actions ``(T, N, 10)`` in rad.
        log_probability, values: Of the actions when taken, and by the critic.
        rewards: Training reward; at a time limit with the value of what would have come.
        starts, ends: 1 where an episode starts with the step or ends after it.
        std: Exploration noise of each robot, ``(N, 1)`` rad.
        memories: Actor and critic memories at the start of each sequence.
        last_value: Critic after the last step, ``(N,)``.
        advantages, targets: For policy and critic, see :meth:`judge`.
    """

    inputs: Tensor
    actions: Tensor
    log_probability: Tensor
    values: Tensor
    rewards: Tensor
    starts: Tensor
    ends: Tensor
    std: Tensor
    memories: list[tuple[Tensor, Tensor]] = field(default_factory=list)
    last_value: Tensor | None = None
    advantages: Tensor | None = None
    targets: Tensor | None = None

    def judge(self, discount: float, gae_lambda: float) -> None:
        """Compute the critic's targets and the advantages, the latter normalised."""
        advantages = generalised_advantages(
            self.rewards, self.values, self.last_value, self.ends, discount, gae_lambda
        )
        self.targets = advantages + self.values
        self.advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)

    def all_sequences(self, length: int) -> Tensor:
        """First step and robot of every sequence of a length, ``(S, 2)``."""
        steps, robots = self.rewards.shape
        return torch.cartesian_prod(torch.arange(0, steps, length), torch.arange(robots))

    def sequences(self, chosen: Tensor, length: int) -> Sequences:
        """Cut out sequences.

        Args:
            chosen: First step and robot of each, ``(B, 2)``, from :meth:`all_sequences`.
            length: Control steps of a sequence.
        """
        rows = chosen[:, 0] + torch.arange(length).unsqueeze(1)
        columns = chosen[:, 1].expand_as(rows)
        order, robots = (chosen[:, 0] // length).tolist(), chosen[:, 1].tolist()
        memory = [
            torch.stack(
                [self.memories[s][net][:, :, r] for s, r in zip(order, robots, strict=True)], dim=2
            )
            for net in (0, 1)
        ]
        names = ("inputs", "actions", "log_probability", "starts", "advantages", "targets")
        parts = {name: getattr(self, name)[rows, columns] for name in names}
        return Sequences(**parts, std=self.std[chosen[:, 1]], memory=memory)


class Sequences(NamedTuple):
    """B sequences of a rollout, time first; ``memory`` is that of actor and critic before them."""

    inputs: Tensor
    actions: Tensor
    log_probability: Tensor
    starts: Tensor
    advantages: Tensor
    targets: Tensor
    std: Tensor
    memory: list[Tensor]


def generalised_advantages(
    rewards: Tensor, values: Tensor, last_value: Tensor, ends: Tensor, discount: float,
    gae_lambda: float
) -> Tensor:  # fmt: skip
    """GAE(lambda) over a rollout.

    Args:
        rewards, values, ends: ``(T, N)``; ends are 1 where nothing follows.
        last_value: ``(N,)``, value of the state after the rollout.
        discount: Discount factor per control step.
        gae_lambda: Trade-off between bias (0) and variance (1).

    Returns:
        Advantages ``(T, N)``.
    """
    advantages, following, value = torch.zeros_like(rewards), 0.0, last_value
    for step in reversed(range(len(rewards))):
        alive = 1.0 - ends[step]
        delta = rewards[step] + discount * alive * value - values[step]
        following = delta + discount * gae_lambda * alive * following
        advantages[step], value = following, values[step]
    return advantages
