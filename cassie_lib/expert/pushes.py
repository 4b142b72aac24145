"""Random pushes on training robots, and the time that a robot is given to recover from one."""

from __future__ import annotations

import numpy as np

from cassie_lib.presets import ExpertParameters
from cassie_lib.simulator import Simulator

#: A robot that was never pushed.
_LONG_AGO = 1_000_000
#: Forward share of a push: mostly sideways, where a biped's feet are in each other's way.
_FORWARD_SHARE = 0.4


class Pushes:
    """Pushes on N robots.

    A push of 40 N s moves the whole robot at 1.2 m/s.  The step that saves it is against Eq 3.10
    and against the clock, and carries it away from the line of the walk, which it cannot see
    afterwards.  So for ``recovery_steps`` the gait and velocity terms are given away, less and
    less, a low reward does not end the episode, and the line of the walk moves with the robot.

    Attributes:
        since: Control steps since the last push, ``(N,)``.
        line_m: Lateral position of the line that each robot should walk on, ``(N,)`` m.
    """

    def __init__(self, parameters: ExpertParameters, rng: np.random.Generator) -> None:
        """Prepare N robots that have not been pushed."""
        self.parameters, self.rng = parameters, rng
        self.since = np.full(parameters.robots, _LONG_AGO)
        self.line_m = np.zeros(parameters.robots)

    def forget(self, indices: np.ndarray) -> None:
        """Start robots anew."""
        self.since[indices], self.line_m[indices] = _LONG_AGO, 0.0

    def strike(self, simulator: Simulator, progress: float) -> None:
        """Push some of the robots that are not recovering; pushes grow once the robots walk.

        Args:
            simulator: The robots.
            progress: Share of the training that is done, 0..1.
        """
        p = self.parameters
        limit = p.push_limit_Ns * float(np.clip((progress - 0.25) / 0.35, 0.0, 1.0))
        if limit == 0.0:
            return
        drawn = self.rng.random(simulator.count) < 1.0 / p.push_interval_steps
        struck = np.flatnonzero(drawn & (self.since >= p.recovery_steps))
        if len(struck):
            size = self.rng.uniform(-1.0, 1.0, (len(struck), 2))
            # More large pushes than small ones: the small ones are soon learned.
            size[:, 1] = np.sign(size[:, 1]) * np.sqrt(np.abs(size[:, 1]))
            impulse = limit * size @ np.array([[_FORWARD_SHARE, 0.0, 0.0], [0.0, 1.0, 0.0]])
            simulator.push(impulse, indices=struck)
            self.since[struck] = 0

    def advance(self, lateral_m: np.ndarray) -> None:
        """Count a control step; the line moves with the robots that are recovering.

        Args:
            lateral_m: Lateral positions of the pelvises, ``(N,)`` m.
        """
        self.since += 1
        self.line_m = np.where(self.recovering, lateral_m, self.line_m)

    @property
    def recovering(self) -> np.ndarray:
        """Whether each robot was pushed less than ``recovery_steps`` ago, ``(N,)``."""
        return self.since < self.parameters.recovery_steps

    @property
    def indulgence(self) -> np.ndarray:
        """Share of the guidance that is given away: 1 at a push, falling to 0, ``(N,)``."""
        return np.clip(1.0 - self.since / self.parameters.recovery_steps, 0.0, 1.0)
