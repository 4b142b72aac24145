"""Expert and planner in turns while both are disturbed: rounds that also see recoveries."""

from __future__ import annotations

import numpy as np

from cassie_lib.controllers import Observation, StandStill
from cassie_lib.data.bursts import Bursts
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.mixed import MixedController
from cassie_lib.presets import BurstParameters, DAggerParameters


class DisturbedController(MixedController):
    """:class:`~cassie_lib.planning.mixed.MixedController` with bursts of noise on its actions.

    The planner's history holds the disturbed actions: they are what the robot did.

    Args:
        planner, expert, planner_steps, cycle_steps: As for the mixed controller.
        bursts: When, how long and how strong.

    Raises:
        ParameterError: If n or a parameter of the bursts is out of range.
    """

    def __init__(
        self, planner: CEM, expert, planner_steps: int, cycle_steps: int, bursts: BurstParameters
    ) -> None:
        super().__init__(planner, expert, planner_steps, cycle_steps)
        self._bursts = Bursts(StandStill(), bursts)

    def reset(self, count: int, seed: int = 0) -> None:
        """Start ``count`` robots; the seed also decides their bursts."""
        super().reset(count, seed)
        self._bursts.reset(count, seed)

    def _executed(self, observation: Observation, actions: np.ndarray) -> np.ndarray:
        return actions + self._bursts.act(observation)


def make_driver(
    planner: CEM, expert, planner_steps: int, parameters: DAggerParameters
) -> MixedController:
    """The controller that collects a round in which the planner has n steps of every phi."""
    turns = (planner, expert, planner_steps, parameters.cycle_steps)
    if parameters.bursts is None:
        return MixedController(*turns)
    return DisturbedController(*turns, parameters.bursts)


__all__ = ["DisturbedController", "make_driver"]
