"""What a predicted step is worth: Eq 3.10, and terms that make stepping pay."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch

from cassie_lib.errors import ParameterError, unknown_name
from cassie_lib.planning.feet import SoleHeight
from cassie_lib.reward import ReferencePose, reward
from cassie_lib.robot.schema import PELVIS_HEIGHT

LATERAL = ("position", "height")
_LEAST_LIFT_M = 0.01  # of a reference that hardly steps


class StageReward(Protocol):
    """Reward of predicted states, differentiable in them."""

    def __call__(
        self, states: torch.Tensor, phase: torch.Tensor, lateral_m: torch.Tensor
    ) -> torch.Tensor:
        """Score predicted states.

        Args:
            states: ``(E, N, T, 49)``.
            phase: ``(E, T)`` phases of the predicted steps.
            lateral_m: ``(E, N, T)`` y of the pelvis, metres.

        Returns:
            ``(E, N, T)``.
        """
        ...


class WalkingReward:
    """Eq 3.10 on predicted states, against the gait reference of their phases.

    Args:
        gait: :class:`cassie_lib.gait.GaitReference`.
        lateral: ``"position"`` scores y, ``"height"`` scores pelvis height against the gait's.
        deadband: Keep the bands without penalty of Eq 3.10.  Inside one the gradient is zero, so
            planners drop them by default.
        foot_weight: Share of :func:`foot_term` besides Eq 3.10, 0 to 1.  Standing still scores
            about 0.9 on Eq 3.10, and a planner with the true dynamics finds that out; this term
            makes stepping pay.  Following the reference's joints does not: the expert's walk
            scores less on it than its stand.  0 is the thesis.

    Raises:
        UnknownNameError: If ``lateral`` is neither of the two.
        ParameterError: If the weight is out of range.
    """

    def __init__(
        self,
        gait,
        lateral: str = "position",
        deadband: bool = False,
        foot_weight: float = 0.0,
    ):
        if lateral not in LATERAL:
            raise unknown_name("lateral term", lateral, LATERAL)
        if not 0.0 <= foot_weight <= 1.0:
            raise ParameterError(f"foot_weight is {foot_weight}: expected 0 to 1")
        self.gait, self.lateral, self.deadband = gait, lateral, deadband
        self.foot_weight = foot_weight
        self._soles = SoleHeight() if foot_weight else None
        self._lift = torch.as_tensor(np.asarray(gait.foot_height_m), dtype=torch.float32)
        self._mean_lift = max(float(self._lift.mean()), _LEAST_LIFT_M)
        self._motor = torch.as_tensor(np.asarray(gait.motor_position), dtype=torch.float32)
        self._joint = torch.as_tensor(np.asarray(gait.joint_position), dtype=torch.float32)
        self._height = torch.as_tensor(np.asarray(gait.qpos)[:, 2], dtype=torch.float32)

    def __call__(self, states, phase, lateral_m):
        """Score ``states (E, N, T, 49)`` as :class:`StageReward` asks: ``(E, N, T)``."""
        index = phase.to(self._motor.device)
        reference = ReferencePose(self._motor[index][:, None], self._joint[index][:, None])
        if self.lateral == "height":
            lateral_m = states[..., PELVIS_HEIGHT.start] - self._height[index][:, None]
        plain = reward(states, reference, lateral_m=lateral_m, deadband=self.deadband)
        total = (1.0 - self.foot_weight) * plain
        if self._soles is not None:
            steps = foot_term(self._soles(states), self._lift[index][:, None], self._mean_lift)
            total = total + self.foot_weight * steps
        return total


def foot_term(
    foot_height_m: torch.Tensor, reference_m: torch.Tensor, lift_m: float
) -> torch.Tensor:
    """How closely the soles follow the heights of the reference's.

    Linear, because it has to outweigh what Eq 3.10 pays for standing: 1 for the reference, 0 on
    average over a cycle for a robot whose feet stay on the floor, less for worse.

    Args:
        foot_height_m: ``(..., 2)`` m.
        reference_m: ``(..., 2)`` m.
        lift_m: Mean height of the reference's soles over a cycle.

    Returns:
        ``(...)``, at most 1.
    """
    return 1.0 - (foot_height_m - reference_m).abs().mean(dim=-1) / lift_m
