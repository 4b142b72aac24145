"""Score action sequences: roll a dynamics model out and discount Eq 3.10 over it (Eq 3.11).

The thesis writes Eq 3.11 with gamma instead of a power of it; gamma**t is used here.  The state
holds no lateral position: it is the integral of the predicted lateral velocity from the position
that the simulator knows, or the term is read as a centre-of-mass *height* term (``lateral``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
import torch

from cassie_lib.dynamics.model import DynamicsModel, History
from cassie_lib.errors import ParameterError, SchemaError, ShapeError, unknown_name
from cassie_lib.reward import ReferencePose, reward
from cassie_lib.robot.schema import (
    ACTION_SIZE,
    CONTROL_PERIOD_S,
    MOTOR_POSITION,
    PELVIS_HEIGHT,
    PELVIS_VELOCITY,
    PERIOD,
    STATE_SIZE,
)

LATERAL = ("position", "height")
_GAIT_SHARPNESS = 10.0  # 1/rad
_VY = PELVIS_VELOCITY.start + 1


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


class Score(NamedTuple):
    """What one evaluation of candidates gives.

    Attributes:
        value: ``(E, N)`` discounted return; minus infinity where a prediction was not finite.
        finite: ``(E, N)`` whether states and return of the candidate are finite.
        states: ``(E, N, T, 49)`` predicted states.
    """

    value: torch.Tensor
    finite: torch.Tensor
    states: torch.Tensor


def integrate_lateral(states: torch.Tensor, now: torch.Tensor, lateral_m: torch.Tensor):
    """Lateral pelvis position along predictions: trapezoidal integral of the lateral velocity.

    Args:
        states: ``(E, N, T, 49)`` predicted states.
        now: ``(E, 49)`` state before the first of them.
        lateral_m: ``(E,)`` y of the pelvis now, metres, world frame.

    Returns:
        ``(E, N, T)`` metres.
    """
    velocity = states[..., _VY]
    first = now[:, None, None, _VY].expand_as(velocity[..., :1])
    before = torch.cat([first, velocity[..., :-1]], dim=-1)
    travelled = torch.cumsum(0.5 * CONTROL_PERIOD_S * (before + velocity), dim=-1)
    return lateral_m[:, None, None] + travelled


class WalkingReward:
    """Eq 3.10 on predicted states, against the gait reference of their phases.

    Args:
        gait: :class:`cassie_lib.gait.GaitReference`.
        lateral: ``"position"`` scores y, ``"height"`` scores pelvis height against the gait's.
        deadband: Keep the bands without penalty of Eq 3.10.  Inside one the gradient is zero, so
            planners drop them by default.
        gait_weight: Share of :func:`gait_term` besides Eq 3.10, 0 to 1.  Standing still scores
            about 0.9 on Eq 3.10, and a planner with the true dynamics finds that out; this term,
            like the one of the expert's training, makes stepping pay.  0 is the thesis.

    Raises:
        UnknownNameError: If ``lateral`` is neither of the two.
        ParameterError: If the weight is out of range.
    """

    def __init__(
        self, gait, lateral: str = "position", deadband: bool = False, gait_weight: float = 0.0
    ):
        if lateral not in LATERAL:
            raise unknown_name("lateral term", lateral, LATERAL)
        if not 0.0 <= gait_weight <= 1.0:
            raise ParameterError(f"gait_weight is {gait_weight}: expected 0 to 1")
        self.gait, self.lateral, self.deadband = gait, lateral, deadband
        self.gait_weight = gait_weight
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
        if not self.gait_weight:
            return plain
        periodic = gait_term(states[..., MOTOR_POSITION], reference.motor_position)
        return (1.0 - self.gait_weight) * plain + self.gait_weight * periodic


def gait_term(motor_position: torch.Tensor, reference: torch.Tensor) -> torch.Tensor:
    """How closely the legs follow the reference: exp(-10 times the mean absolute error in rad).

    Unlike the motor term of Eq 3.10 it is steep near zero error and not yet flat at the error of
    a leg that stays on the ground during its swing (0.1 rad over all motors).

    Args:
        motor_position: ``(..., 10)`` rad.
        reference: ``(..., 10)`` rad.

    Returns:
        ``(...)`` in (0, 1].
    """
    return (-_GAIT_SHARPNESS * (motor_position - reference).abs().mean(dim=-1)).exp()


class Objective:
    """Discounted return of action sequences under a dynamics model.

    Args:
        model: :class:`cassie_lib.dynamics.model.DynamicsModel`; its ``context`` is H.
        stage_reward: Reward of predicted states, e.g. :class:`WalkingReward`.
        discount: gamma in (0, 1]; the state t steps ahead counts gamma**t, t = 1..T.
        terminal_value: Optional ``(history, states (E, N, T, 49), phase (E, T)) -> (E, N)``: value
            of the last predicted state.  A critic's value counts rewards from the state after, so
            it is weighted by gamma**(T + 1).
        max_rows: Most candidates, over all episodes, in one forward pass outside the gradient
            loop; bounds the memory of N = 1000.  0: no limit.

    Raises:
        ParameterError: If the discount is out of range.
    """

    def __init__(
        self,
        model: DynamicsModel,
        stage_reward: StageReward,
        discount: float = 0.99,
        terminal_value: Callable | None = None,
        max_rows: int = 0,
    ):
        if not 0.0 < discount <= 1.0:
            raise ParameterError(f"discount is {discount}: expected 0 < gamma <= 1")
        self.model, self.stage_reward, self.discount = model, stage_reward, float(discount)
        self.terminal_value, self.max_rows = terminal_value, int(max_rows)

    def check(self, history: History, phase: torch.Tensor, lateral_m: torch.Tensor) -> None:
        """Check that what is to be planned for fits the model.

        Raises:
            SchemaError: If the states are not 49 long or the history is not the model's context.
            ShapeError: If phase or lateral position do not have one value per episode.
        """
        shape = tuple(history.states.shape)
        if len(shape) != 3 or shape[-1] != STATE_SIZE:
            raise SchemaError(f"history states are {shape}: expected (E, H, {STATE_SIZE})")
        if shape[1] < self.model.context:
            raise SchemaError(
                f"history holds {shape[1]} states: expected the {self.model.context} of the "
                f"dynamics model's context"
            )
        expected = (shape[0], shape[1] - 1, ACTION_SIZE)
        if tuple(history.actions.shape) != expected:
            raise ShapeError(
                f"history actions are {tuple(history.actions.shape)}: expected {expected}"
            )
        for name, value in (("phase", phase), ("lateral_m", lateral_m)):
            if tuple(value.shape) != shape[:1]:
                raise ShapeError(f"{name} is {tuple(value.shape)}: expected {shape[:1]}")

    def bind(self, history: History, phase: torch.Tensor, lateral_m: torch.Tensor) -> Callable:
        """Prepare one planning problem: the model encodes the history once.

        Args:
            history: The last H states and H - 1 actions of E episodes.
            phase: ``(E,)`` integer phase now, 0..27; predicted steps have phase + 1 .. phase + T.
            lateral_m: ``(E,)`` y of the pelvis now, metres.

        Returns:
            Function ``actions (E, N, T, 10) rad -> Score``, differentiable in the actions.

        Raises:
            SchemaError, ShapeError: As :meth:`check`; the function raises SchemaError when the
                model predicts states of another schema.
        """
        self.check(history, phase, lateral_m)
        # Not inference mode: what it makes could not be used inside the gradient loop.
        with torch.no_grad():
            prepared = self.model.prepare(history._replace(phase=phase))

        def score(actions: torch.Tensor) -> Score:
            rows = actions.shape[0] * actions.shape[1]
            if not self.max_rows or rows <= self.max_rows or torch.is_grad_enabled():
                return self._score(history, prepared, actions, phase, lateral_m)
            size = max(1, self.max_rows // actions.shape[0])
            parts = [
                self._score(history, prepared, part, phase, lateral_m)
                for part in actions.split(size, dim=1)
            ]
            return Score(*(torch.cat(tensors, dim=1) for tensors in zip(*parts, strict=True)))

        return score

    def _score(self, history, prepared, actions, phase, lateral_m) -> Score:
        states = self.model.predict(prepared, actions)
        if tuple(states.shape) != (*actions.shape[:3], STATE_SIZE):
            raise SchemaError(
                f"the dynamics model predicts {tuple(states.shape)}: expected "
                f"{(*actions.shape[:3], STATE_SIZE)}"
            )
        horizon = actions.shape[2]
        ahead = torch.arange(1, horizon + 1, device=phase.device)
        phases = (phase[:, None] + ahead) % PERIOD
        lateral = integrate_lateral(states, history.states[:, -1], lateral_m)
        stage = self.stage_reward(states, phases, lateral)
        weight = self.discount ** ahead.to(stage)
        value = (stage * weight).sum(dim=-1)
        if self.terminal_value is not None:
            beyond = self.discount ** (horizon + 1)
            value = value + beyond * self.terminal_value(history, states, phases)
        finite = torch.isfinite(states.detach()).flatten(2).all(dim=-1)
        finite = finite & torch.isfinite(value.detach())
        return Score(torch.where(finite, value, float("-inf")), finite, states)
