"""Score action sequences: roll a dynamics model out and discount Eq 3.10 over it (Eq 3.11).

The thesis writes Eq 3.11 with gamma instead of a power of it; gamma**t is used here.  The state
holds no lateral position: it is the integral of the predicted lateral velocity from the position
that the simulator knows, or the term is read as a centre-of-mass *height* term (``lateral``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch

from cassie_lib.dynamics.model import DynamicsModel, History
from cassie_lib.errors import ParameterError, SchemaError, ShapeError
from cassie_lib.planning.stage_reward import StageReward
from cassie_lib.robot.schema import (
    ACTION_SIZE,
    CONTROL_PERIOD_S,
    PELVIS_VELOCITY,
    PERIOD,
    STATE_SIZE,
)

_VY = PELVIS_VELOCITY.start + 1


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
        value = self.horizon_return(history, states, phase, lateral_m)
        if self.terminal_value is not None:
            horizon = states.shape[2]
            phases = _phases(phase, horizon)
            beyond = self.discount ** (horizon + 1)
            value = value + beyond * self.terminal_value(history, states, phases)
        finite = torch.isfinite(states.detach()).flatten(2).all(dim=-1)
        finite = finite & torch.isfinite(value.detach())
        return Score(torch.where(finite, value, float("-inf")), finite, states)

    def horizon_return(
        self, history: History, states: torch.Tensor, phase: torch.Tensor, lateral_m: torch.Tensor
    ) -> torch.Tensor:
        """Eq 3.11 over predicted states, without what a terminal value adds.

        Args:
            history, phase, lateral_m: As for :meth:`bind`.
            states: ``(E, N, T, 49)``.

        Returns:
            ``(E, N)``.
        """
        horizon = states.shape[2]
        lateral = integrate_lateral(states, history.states[:, -1], lateral_m)
        stage = self.stage_reward(states, _phases(phase, horizon), lateral)
        weight = self.discount ** torch.arange(1, horizon + 1, device=phase.device).to(stage)
        return (stage * weight).sum(dim=-1)


def _phases(phase: torch.Tensor, horizon: int) -> torch.Tensor:
    """Phases ``(E, T)`` of the steps after phases ``(E,)``."""
    return (phase[:, None] + torch.arange(1, horizon + 1, device=phase.device)) % PERIOD
