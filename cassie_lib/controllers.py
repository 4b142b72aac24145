"""What acts on robots: the interface of policies and planners, and two open-loop controllers."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from cassie_lib import gait
from cassie_lib.robot.schema import ACTION_SIZE


class Observation(NamedTuple):
    """What a controller may look at before each control step.

    Attributes:
        states: ``(N, 49)``, Table 4.1.
        physics: Full physics state ``(N, 68)``, for planners on the true simulator only.
        phase: Phase of the clock ``(N,)``.
        pelvis_position: World frame, ``(N, 3)`` m; the state does not hold x and y.
        step: Control steps since the start.
    """

    states: np.ndarray
    physics: np.ndarray
    phase: np.ndarray
    pelvis_position: np.ndarray
    step: int


class Controller(Protocol):
    """Policies and planners are interchangeable behind this."""

    def reset(self, count: int, seed: int = 0) -> None:
        """Forget everything and prepare for ``count`` robots."""

    def act(self, observation: Observation) -> np.ndarray:
        """Actions ``(N, 10)`` rad: offsets of the PD targets from the neutral pose."""


class StandStill:
    """Holds one constant action: no feedback at all.

    With the default, zero, the PD drive sags and the robot falls within about 33 control steps: a
    robot that stands has to be controlled, see ``pipeline.reward_only_artifact``.
    """

    def __init__(self, action=None) -> None:
        """Hold ``action`` (10,) rad; default zero."""
        self.action = np.zeros(ACTION_SIZE) if action is None else np.asarray(action, dtype=float)
        self.reset(1)

    def reset(self, count: int, seed: int = 0) -> None:
        """Prepare for ``count`` robots."""
        del seed
        self._count = count

    def act(self, observation: Observation) -> np.ndarray:
        """The constant action for every robot, ``(N, 10)``."""
        del observation
        return np.tile(self.action, (self._count, 1))


class ReferencePlayback:
    """Feeds the reference gait's joint angles to the PD drive, with no feedback at all."""

    def __init__(self, reference: gait.GaitReference) -> None:
        """Play back a reference gait."""
        from cassie_lib.robot.model import neutral_pose

        self._cycle = reference.motor_position - neutral_pose()

    def reset(self, count: int, seed: int = 0) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> np.ndarray:
        """Targets of the next phase, ``(N, 10)``."""
        return self._cycle[(observation.phase + 1) % len(self._cycle)]
