"""Expert and planner in turns: who acts when in Algorithm 3."""

from __future__ import annotations

import numpy as np

from cassie_lib.errors import ParameterError
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.control import PlannerController


class MixedController(PlannerController):
    """The expert acts, but for n random steps of every phi, at which the planner does.

    The steps are drawn anew for every robot and every phi steps, without repetition (footnote 6 of
    the thesis).  Until H states are known the expert acts alone.  The expert sees every state, so
    its memory is right whenever it takes over again.  A planner that did not act at the step
    before starts from the mean that it begins an episode with.

    Args:
        planner: The planner.
        expert: The expert.
        planner_steps: n, 1 to phi; phi leaves everything after the hand-over to the planner.
        cycle_steps: phi, control steps of two walking steps.

    Raises:
        ParameterError: If n is out of range.
    """

    planner: CEM

    def __init__(self, planner: CEM, expert, planner_steps: int, cycle_steps: int = 27):
        if not 1 <= planner_steps <= cycle_steps:
            raise ParameterError(
                f"planner_steps is {planner_steps}: expected 1 to cycle_steps, {cycle_steps}"
            )
        super().__init__(planner, expert)
        self.planner_steps, self.cycle_steps = planner_steps, cycle_steps

    def reset(self, count: int, seed: int = 0) -> None:
        """Start ``count`` robots; the seed decides the planner's steps and its plans."""
        super().reset(count, seed)
        self._random = np.random.default_rng(seed)

    def _start_from(self, observation, step: int) -> np.ndarray:
        return np.array(self.expert.act(observation), dtype=float)

    def _driven(self, step: int) -> np.ndarray:
        place = step % self.cycle_steps
        if place == 0:
            order = self._random.random((self._count, self.cycle_steps)).argsort(axis=1)
            self._turns = order < self.planner_steps
        driven = self._turns[:, place] & (step >= self.handover_step)
        self.planner.forget(np.flatnonzero(~driven))
        return driven
