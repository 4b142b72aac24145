"""What planning costs: time of a plan, memory that gradients hold."""

from __future__ import annotations

import time
from collections.abc import Callable

import torch
from torch.profiler import ProfilerActivity, profile

from cassie_lib.dynamics.model import History
from cassie_lib.planning.objective import Objective
from cassie_lib.robot.schema import ACTION_SIZE, STATE_SIZE
from cassie_lib.threads import one_torch_thread


def standing_history(episodes: int, context: int) -> History:
    """Histories of a robot that stands at phase 0: for timing, where values do not matter."""
    states = torch.zeros(episodes, context, STATE_SIZE)
    # Unit quaternion and clock.
    states[..., 0], states[..., 1], states[..., 47] = 1.0, 1.0, 1.0
    actions = torch.zeros(episodes, context - 1, ACTION_SIZE)
    return History(states, actions, phase=torch.zeros(episodes, dtype=torch.long))


def seconds(
    work: Callable[[], object],
    repeats: int = 3,
    clock: Callable[[], float] = time.process_time,
    warm: bool = True,
) -> float:
    """Shortest time of some calls, in s, on one torch thread.

    Args:
        work: What is timed.
        repeats: How often.
        clock: Processor time by default, which other processes do not lengthen; on one thread of
            an idle machine it is the wall time.
        warm: Begin with a call that does not count.
    """
    found = []
    with one_torch_thread():
        if warm:
            work()
        for _ in range(repeats):
            start = clock()
            work()
            found.append(clock() - start)
    return min(found)


class Uncached:
    """A causal model without its cache: every predicted step encodes the whole window anew.

    Args:
        model: :class:`cassie_lib.dynamics.causal.CausalModel`.
    """

    def __init__(self, model):
        self._model, self.context = model, model.context

    def prepare(self, history: History) -> History:
        """Nothing is kept."""
        return history

    def predict(self, history: History, actions: torch.Tensor) -> torch.Tensor:
        """The same states as the cached model gives."""
        return self._model.predict_uncached(history, actions)


def gradient_memory(objective: Objective, candidates: int, horizon: int) -> int:
    """Bytes that one gradient of the return holds between its forward and backward pass.

    Memory allocated and not given back during the forward pass, as the profiler counts it: it
    does not matter whether autograd or a hand-written backward pass keeps the tensors.

    Args:
        objective: Model and reward.
        candidates: Sequences that are improved at once: K, or N of reference [3].
        horizon: T.
    """
    actions, score = _problem(objective, candidates, horizon)
    score(actions)  # what is made once and kept does not count
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as profiler:
        value = score(actions).value.sum()
    del value
    return sum(event.self_cpu_memory_usage for event in profiler.key_averages())


def gradient_seconds(objective: Objective, candidates: int, horizon: int, repeats: int = 3):
    """Time (s) of one gradient of the return on so many sequences."""
    actions, score = _problem(objective, candidates, horizon)
    return seconds(lambda: torch.autograd.grad(score(actions).value.sum(), actions), repeats)


def _problem(objective: Objective, candidates: int, horizon: int):
    actions = torch.zeros(1, candidates, horizon, ACTION_SIZE, requires_grad=True)
    zero = torch.zeros(1)
    return actions, objective.bind(standing_history(1, objective.model.context), zero.long(), zero)


def plan_seconds(planner, episodes: int = 1, repeats: int = 3, warm: bool = True) -> float:
    """Time (s) of one plan for so many episodes."""
    history = standing_history(episodes, planner.objective.model.context)
    zero = torch.zeros(episodes)
    planner.reset(range(episodes))
    return seconds(lambda: planner.plan(history, zero.long(), zero), repeats, warm=warm)
