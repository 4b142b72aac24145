"""A planner in closed loop: model-predictive control of one or several robots at once.

A model needs H past states and H - 1 actions, which s0 alone does not give.  Either the expert
drives until the hand-over, or the context is padded with copies of the first state and zero
actions and the planner drives from the start.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Any, NamedTuple

import numpy as np
import torch

from cassie_lib.dynamics.model import History
from cassie_lib.errors import ParameterError
from cassie_lib.planning.planner import Planner
from cassie_lib.robot.schema import ACTION_SIZE, PELVIS_HEIGHT
from cassie_lib.simulator import UPRIGHT_M
from cassie_lib.threads import one_torch_thread


class PlanLog(NamedTuple):
    """What a controller noted, one row per control step of :meth:`PlannerController.act`.

    Attributes:
        handover_step: First control step at which the planner drives.
        plan_time_s: ``(S,)`` wall time of planning for all robots together; NaN without a plan.
        planned: ``(S, N)`` whether the planner chose the action.
        imagined_return: ``(S, N)`` Eq 3.11 on the model; NaN without a plan.
        realised_return: ``(S, N)`` the same sum over the states that followed; NaN where fewer
            than T steps followed.
        stage_reward: ``(S, N)`` reward of the state before the action, as the planner scores it.
        non_finite: ``(S, N)`` candidates without a finite prediction.
    """

    handover_step: int
    plan_time_s: np.ndarray
    planned: np.ndarray
    imagined_return: np.ndarray
    realised_return: np.ndarray
    stage_reward: np.ndarray
    non_finite: np.ndarray


class _Row(NamedTuple):
    plan_time_s: float
    planned: np.ndarray
    imagined_return: np.ndarray
    stage_reward: np.ndarray
    non_finite: np.ndarray


class Context:
    """The last H states and actions of N robots."""

    def __init__(self, length: int):
        self._states: deque = deque(maxlen=length)
        self._actions: deque = deque(maxlen=length)
        self.length = length

    @property
    def full(self) -> bool:
        """Whether H states are known."""
        return len(self._states) == self.length

    def pad(self, states: torch.Tensor) -> None:
        """Fill with copies of ``states (N, 49)`` and zero actions."""
        for _ in range(self.length - 1):
            self.see(states)
            self.did(torch.zeros(len(states), ACTION_SIZE))

    def see(self, states: torch.Tensor) -> None:
        """Append the states ``(N, 49)`` that are now."""
        self._states.append(states)

    def did(self, actions: torch.Tensor) -> None:
        """Append the actions ``(N, 10)`` applied to them."""
        self._actions.append(actions)

    def state_dict(self) -> dict[str, Any]:
        """All that is known of the past, oldest first."""
        return {"states": list(self._states), "actions": list(self._actions)}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Return to a :meth:`state_dict`."""
        self._states.clear()
        self._states.extend(saved["states"])
        self._actions.clear()
        self._actions.extend(saved["actions"])

    def history(self, observation, robots: np.ndarray) -> History:
        """History of some of the robots; the last state is now."""
        states = torch.stack(list(self._states), dim=1)
        count = self.length - 1
        recent = list(self._actions)[-count:] if count else []
        actions = torch.stack(recent, dim=1) if recent else torch.zeros(len(states), 0, ACTION_SIZE)
        physics = None if observation.physics is None else observation.physics[robots]
        phase = torch.as_tensor(np.asarray(observation.phase)[robots], dtype=torch.long)
        return History(states[robots], actions[robots], physics, phase)


class PlannerController:
    """A planner as a controller of N robots, planned for in one batch.

    Robots that have fallen get zero actions and are no longer planned for.

    Args:
        planner: CEM, Gradient-CEM or another :class:`~cassie_lib.planning.planner.Planner`.
        expert: Controller that drives until the hand-over; ``None`` pads the context instead.
        handover_step: First control step of the planner; default H, at least H - 1.

    Raises:
        ParameterError: If the hand-over comes before H states are known, or is asked for without
            an expert.
    """

    def __init__(self, planner: Planner, expert=None, handover_step: int | None = None):
        context = planner.objective.model.context
        if expert is None and handover_step not in (None, 0):
            raise ParameterError(f"handover_step is {handover_step}: expected 0 without an expert")
        if expert is not None and handover_step is not None and handover_step < context - 1:
            raise ParameterError(
                f"handover_step is {handover_step}: expected at least {context - 1}, so that the "
                f"model's {context} states are known"
            )
        self.planner, self.expert = planner, expert
        self.handover_step = (
            0 if expert is None else (context if handover_step is None else handover_step)
        )
        self._context = Context(context)
        self._rows: list[_Row] = []

    def reset(self, count: int, seed: int = 0) -> None:
        """Start ``count`` robots; robot i plans with the random numbers of ``seed + i``."""
        self.planner.reset([seed + index for index in range(count)])
        if self.expert is not None:
            self.expert.reset(count, seed)
        self._context = Context(self._context.length)
        self._rows, self._count = [], count

    def act(self, observation) -> np.ndarray:
        """Actions ``(N, 10)`` rad for a :class:`cassie_lib.walking.Observation`.

        Raises:
            NonFiniteError: If every candidate of a robot has a non-finite prediction.
        """
        states = torch.as_tensor(np.asarray(observation.states), dtype=torch.float32)
        step = len(self._rows)
        if self.expert is None and step == 0:
            self._context.pad(states)
        self._context.see(states)
        actions = self._start_from(observation, step)
        row = self._blank(self._stage_reward(states, observation))
        height = np.asarray(observation.states)[:, PELVIS_HEIGHT.start]
        upright = (height > UPRIGHT_M[0]) & (height < UPRIGHT_M[1])
        driven = np.flatnonzero(upright & self._driven(step))
        if len(driven):
            actions, row = self._plan(observation, driven, actions, row)
        self._rows.append(row)
        actions = self._executed(observation, actions)
        self._context.did(torch.as_tensor(actions, dtype=torch.float32))
        return actions

    def _start_from(self, observation, step: int) -> np.ndarray:
        """Actions of the robots that the planner does not drive."""
        if step < self.handover_step:
            return np.array(self.expert.act(observation), dtype=float)
        return np.zeros((self._count, ACTION_SIZE))

    def _driven(self, step: int) -> np.ndarray:
        """Which robots the planner drives at this control step, ``(N,)``."""
        return np.full(self._count, step >= self.handover_step)

    def _executed(self, observation, actions: np.ndarray) -> np.ndarray:
        """What is done of the actions ``(N, 10)`` that were chosen: here, all of it."""
        return actions

    def state_dict(self) -> dict[str, Any]:
        """Log and context, for a checkpoint; what planner and expert remember is their own."""
        rows = {name: torch.as_tensor(column) for name, column in self._columns().items()}
        return {"rows": rows, "context": self._context.state_dict()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Return to a :meth:`state_dict` of as many robots."""
        columns = [saved["rows"][name].numpy() for name in _Row._fields]
        self._rows = [_Row(float(row[0]), *row[1:]) for row in zip(*columns, strict=True)]
        self._context.load_state_dict(saved["context"])

    def _columns(self) -> dict[str, np.ndarray]:
        return {name: np.array([getattr(row, name) for row in self._rows]) for name in _Row._fields}

    def log(self) -> PlanLog:
        """Everything noted since the last :meth:`reset`."""
        columns = self._columns()
        horizon = self.planner.horizon
        realised = realised_return(
            columns["stage_reward"], horizon, self.planner.objective.discount
        )
        realised[~columns["planned"]] = np.nan
        return PlanLog(self.handover_step, realised_return=realised, **columns)

    def _plan(self, observation, driven, actions, row: _Row) -> tuple[np.ndarray, _Row]:
        start = time.perf_counter()
        with one_torch_thread():
            history = self._context.history(observation, driven)
            lateral_m = torch.as_tensor(np.asarray(observation.pelvis_position)[driven, 1])
            plan = self.planner.plan(history, history.phase, lateral_m.float(), episodes=driven)
        row = row._replace(plan_time_s=time.perf_counter() - start)
        actions[driven] = plan.actions[:, 0].double().numpy()
        row.planned[driven] = True
        row.imagined_return[driven] = plan.imagined_return.numpy()
        row.non_finite[driven] = plan.non_finite.numpy()
        return actions, row

    def _blank(self, reward: np.ndarray) -> _Row:
        """A row without a plan."""
        count = self._count
        return _Row(
            np.nan,
            np.zeros(count, dtype=bool),
            np.full(count, np.nan),
            reward,
            np.zeros(count, dtype=int),
        )

    def _stage_reward(self, states: torch.Tensor, observation) -> np.ndarray:
        phase = torch.as_tensor(np.asarray(observation.phase), dtype=torch.long)[:, None]
        lateral = torch.as_tensor(np.asarray(observation.pelvis_position)[:, 1]).float()
        with torch.inference_mode():
            reward = self.planner.objective.stage_reward(
                states[:, None, None], phase, lateral[:, None, None]
            )
        return reward[:, 0, 0].double().numpy()


def realised_return(stage_reward: np.ndarray, horizon: int, discount: float) -> np.ndarray:
    """Eq 3.11 over what followed: sum over t = 1..T of gamma**t times the reward t steps later.

    Args:
        stage_reward: ``(S, N)`` reward of the state at each control step.
        horizon: T.
        discount: gamma.

    Returns:
        ``(S, N)``; NaN where fewer than T steps follow.
    """
    steps = len(stage_reward)
    found = np.full(stage_reward.shape, np.nan)
    if steps > horizon:
        found[: steps - horizon] = sum(
            discount**t * stage_reward[t : steps - horizon + t] for t in range(1, horizon + 1)
        )
    return found
