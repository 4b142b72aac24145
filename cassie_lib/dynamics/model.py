"""What a dynamics model is: history and candidate actions in, predicted states out.

Learned models and the true simulator are interchangeable behind :class:`DynamicsModel`.  One pair
does not determine the next state (Eq 3.1), so the thesis gives the model H past pairs (Eq 3.2) and
has it predict the difference to the next state (Eq 3.3).
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from torch import Tensor
from torch.nn import functional

from cassie_lib.errors import NonFiniteError, ParameterError, SchemaError, ShapeError
from cassie_lib.robot import schema

#: How far a clock value may be from the unit circle before the component order is doubted.
CLOCK_TOLERANCE = 1e-2
_ANGLE = 2.0 * torch.pi / schema.CLOCK_DIVISOR
_CLOCK_TABLE = torch.from_numpy(schema.clock(range(schema.PERIOD)))


class History(NamedTuple):
    """What is known at the moment of planning.

    Attributes:
        states: ``(E, H, 49)``, physical units; ``states[:, -1]`` is now.
        actions: ``(E, H - 1, 10)``, rad; ``actions[:, t]`` was applied at ``states[:, t]``.  The
            H-th pair is completed by the first candidate action.
        physics: ``(E, P)`` full simulator state, read only by the oracle; otherwise None.
        phase: ``(E,)`` integers 0..27, phase of ``states[:, -1]``.  None: inferred from the last
            two clock values (:func:`infer_phase`).
    """

    states: Tensor
    actions: Tensor
    physics: Any = None
    phase: Tensor | None = None


@runtime_checkable
class DynamicsModel(Protocol):
    """Predicts states from a history and candidate action sequences.

    Attributes:
        context: H, the number of past states that :meth:`predict` needs.
    """

    context: int

    def prepare(self, history: History) -> Any:
        """Do once what does not depend on the candidates; ``predict`` accepts the result.

        A model with nothing to prepare returns the history itself.
        """

    def predict(self, history: Any, actions: Tensor) -> Tensor:
        """Predict ``(E, N, T, 49)`` for candidates ``actions`` ``(E, N, T, 10)`` (rad).

        ``history`` is a :class:`History` or what :meth:`prepare` returned.  Differentiable in
        ``actions``.  E episodes, N candidates each, T control steps; step 0 of the answer is the
        state after the first action.

        Raises:
            ShapeError, NonFiniteError, SchemaError: On bad input.
        """


def check_history(
    history: History, context: int, device: torch.device | None = None
) -> None:
    """Check shapes, finiteness and component order of a history.

    Args:
        history: The history.
        context: H that the model needs; a longer history is accepted.
        device: Where the model is; None: not checked.

    Raises:
        ShapeError: If a shape differs or fewer than ``context`` states are given.
        NonFiniteError: If a state or action is NaN or infinite.
        SchemaError: If the components cannot be in the documented order.
        ParameterError: If the parts and the model are on different devices.
    """
    states, actions = history.states, history.actions
    if states.ndim != 3 or states.shape[-1] != schema.STATE_SIZE:
        raise ShapeError(
            f"history states have shape {tuple(states.shape)}: expected (E, H, {schema.STATE_SIZE})"
        )
    episodes, length = states.shape[:2]
    if length < context:
        raise ShapeError(f"history has {length} states: expected at least {context}")
    if tuple(actions.shape) != (episodes, length - 1, schema.ACTION_SIZE):
        raise ShapeError(
            f"history actions have shape {tuple(actions.shape)}: "
            f"expected {(episodes, length - 1, schema.ACTION_SIZE)}"
        )
    if actions.device != states.device:
        raise ParameterError(
            f"history states are on {states.device}, actions on {actions.device}: "
            "expected one device"
        )
    if device is not None and states.device != device:
        raise ParameterError(f"history is on {states.device}, the model on {device}")
    for name, value in (("states", states), ("actions", actions)):
        if not torch.isfinite(value).all():
            raise NonFiniteError(f"history {name} hold NaN or infinity: expected finite values")
    check_components(states)


def check_components(states: Tensor) -> None:
    """Doubt states ``(..., 49)`` whose clock or quaternion is not of unit length.

    Raises:
        SchemaError: If either is not, as happens when components are in another order.
    """
    for name, part in (("clock", schema.CLOCK), ("quaternion", schema.PELVIS_ORIENTATION)):
        deviation = (states[..., part].square().sum(-1) - 1.0).abs().max().item()
        if deviation > CLOCK_TOLERANCE:
            raise SchemaError(
                f"{name} at components {part.start}..{part.stop - 1} has squared length off by "
                f"{deviation:.3g}: expected 1, is the component order that of robot/schema.py?"
            )


def check_actions(actions: Tensor, episodes: int, device: torch.device) -> None:
    """Check candidate actions ``(E, N, T, 10)``.

    Raises:
        ShapeError: If the shape differs.
        NonFiniteError: If an action is NaN or infinite.
        ParameterError: If they are not on ``device``.
    """
    if actions.ndim != 4 or actions.shape[0] != episodes or actions.shape[-1] != 10:
        raise ShapeError(
            f"actions have shape {tuple(actions.shape)}: expected ({episodes}, N, T, 10)"
        )
    if min(actions.shape[1:3]) < 1:
        raise ShapeError(f"actions have shape {tuple(actions.shape)}: expected N, T of at least 1")
    if actions.device != device:
        raise ParameterError(f"actions are on {actions.device}, the model is on {device}")
    if not torch.isfinite(actions).all():
        raise NonFiniteError("actions hold NaN or infinity: expected finite values")


def infer_phase(states: Tensor) -> Tensor:
    """Phase ``(E,)`` of the last of the states ``(E, H, 49)``, from the last two clock values.

    Phases 27 and 0 have the same clock; the step before tells them apart: 26 comes before 27, and
    27 (which reads as 0) before 0.

    Raises:
        ShapeError: If fewer than two states are given.
    """
    if states.shape[1] < 2:
        raise ShapeError(f"history has {states.shape[1]} state: expected 2 to infer the phase")
    clock = states[:, -2:, schema.CLOCK].detach()
    angle = torch.atan2(clock[..., 0], clock[..., 1])
    read = torch.round(angle / _ANGLE).long() % schema.CLOCK_DIVISOR
    before, now = read[:, 0], read[:, 1]
    last = schema.CLOCK_DIVISOR
    return torch.where((now == 0) & (before == last - 1), torch.full_like(now, last), now)


def phase_of(history: History) -> Tensor:
    """Phase ``(E,)`` of the present state: given, or inferred from the clock.

    Raises:
        ShapeError: If a given phase is not ``(E,)``.
        ParameterError: If a given phase is outside 0..27.
    """
    if history.phase is None:
        return infer_phase(history.states)
    phase = torch.as_tensor(history.phase, device=history.states.device).long()
    if phase.shape != history.states.shape[:1]:
        raise ShapeError(
            f"phase has shape {tuple(phase.shape)}: expected ({history.states.shape[0]},)"
        )
    if ((phase < 0) | (phase >= schema.PERIOD)).any():
        raise ParameterError(f"phase is outside 0..{schema.PERIOD - 1}: {phase.tolist()}")
    return phase


def known_components(now: Tensor, phase: Tensor, steps: int) -> Tensor:
    """Clock and commanded speed of the next steps, which follow from the present exactly.

    Args:
        now: Present states ``(E, 49)``.
        phase: Their phases ``(E,)``.
        steps: T.

    Returns:
        ``(E, T, 3)``: clock sine, clock cosine, speed in m/s.
    """
    ahead = torch.arange(1, steps + 1, device=phase.device)
    table = _CLOCK_TABLE.to(now)
    clock = table[(phase[:, None] + ahead) % schema.PERIOD]
    speed = now[:, None, schema.SPEED].expand(-1, steps, -1)
    return torch.cat([clock, speed], dim=-1)


def complete_state(previous: Tensor, difference: Tensor, known: Tensor) -> Tensor:
    """Next state from the present one and a predicted difference (Eq 3.7).

    Speed and clock are not learned but computed; the quaternion is brought back to unit length
    and keeps its sign, because it is the previous one moved a little.

    Args:
        previous: States ``(..., 49)``, physical units.
        difference: Predicted differences ``(..., 46)`` or more; those past 46 are ignored.
        known: Clock and speed of the next state ``(..., 3)``, broadcast against ``previous``.

    Returns:
        States ``(..., 49)``.
    """
    moved = previous[..., schema.PHYSICAL] + difference[..., schema.PHYSICAL]
    height, quaternion, rest = moved.split((1, 4, 41), dim=-1)
    return torch.cat(
        [
            height,
            functional.normalize(quaternion, dim=-1),
            rest,
            known.expand(*previous.shape[:-1], 3),
        ],
        dim=-1,
    )


__all__ = [
    "DynamicsModel",
    "History",
    "check_actions",
    "check_components",
    "check_history",
    "complete_state",
    "infer_phase",
    "known_components",
    "phase_of",
]
