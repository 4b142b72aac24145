"""Bursts of correlated action noise: they push the robot off the walk, and the expert recovers.

White noise, however strong, keeps a robot near the walk: what it does in one control step it
undoes in the next.  A planner does not; its errors point the same way for many steps.
"""

from __future__ import annotations

import numpy as np

from cassie_lib.controllers import Controller, Observation
from cassie_lib.errors import ParameterError
from cassie_lib.presets import BurstParameters
from cassie_lib.robot.schema import ACTION_SIZE

#: Correlation of the noise from one control step to the next; each burst draws one.
CORRELATIONS = (0.0, 0.7, 0.9, 0.97)
#: Scale of a burst on each motor, relative to its strength, is drawn between these.
_MOTOR_SCALE = (0.2, 1.5)


class Bursts:
    """A controller whose actions are disturbed now and then, each robot at its own times.

    Each burst lasts 1 to ``longest_steps`` control steps and adds a first-order autoregressive
    process of its own correlation, strength and scale per motor.
    """

    def __init__(self, controller: Controller, parameters: BurstParameters) -> None:
        """Wrap a controller.

        Raises:
            ParameterError: If a parameter is out of range.
        """
        if parameters.longest_steps < 1 or parameters.strongest_rad < 0.0:
            raise ParameterError(
                f"bursts last {parameters.longest_steps} steps of {parameters.strongest_rad} rad: "
                "expected at least 1 step and 0 rad"
            )
        low, high = parameters.pause_steps
        if not 1 <= low <= high:
            raise ParameterError(f"pause_steps are {low} to {high}: expected 1 <= least <= most")
        self.controller, self.parameters = controller, parameters
        self.reset(1)

    def reset(self, count: int, seed: int = 0) -> None:
        """Prepare ``count`` robots; their bursts depend on the seed."""
        self.controller.reset(count, seed)
        self._random = np.random.default_rng([seed, 1])
        self._left = np.zeros(count, dtype=int)
        self._pause = self._draw_pause(count)
        self._noise = np.zeros((count, ACTION_SIZE))
        self._scale = np.zeros((count, ACTION_SIZE))
        self._correlation = np.zeros((count, 1))

    def act(self, observation: Observation) -> np.ndarray:
        """The controller's actions and the bursts, ``(N, 10)`` rad."""
        actions = np.asarray(self.controller.act(observation), dtype=float)
        self._begin(np.flatnonzero((self._left == 0) & (self._pause == 0)))
        fresh = self._random.standard_normal(actions.shape)
        kept = self._correlation
        self._noise = kept * self._noise + np.sqrt(1.0 - kept**2) * fresh
        bursting = self._left > 0
        self._left[bursting] -= 1
        self._pause[~bursting] -= 1
        over = bursting & (self._left == 0)
        self._pause[over] = self._draw_pause(int(over.sum()))
        return actions + np.where(bursting[:, None], self._scale * self._noise, 0.0)

    def _draw_pause(self, count: int) -> np.ndarray:
        low, high = self.parameters.pause_steps
        return self._random.integers(low, high + 1, count)

    def _begin(self, robots: np.ndarray) -> None:
        """Draw a burst for each of some robots."""
        count, random = len(robots), self._random
        self._left[robots] = random.integers(1, self.parameters.longest_steps + 1, count)
        strength = random.uniform(0.0, self.parameters.strongest_rad, (count, 1))
        self._scale[robots] = strength * random.uniform(*_MOTOR_SCALE, (count, ACTION_SIZE))
        self._correlation[robots] = random.choice(CORRELATIONS, (count, 1))
        self._noise[robots] = random.standard_normal((count, ACTION_SIZE))


__all__ = ["CORRELATIONS", "Bursts"]
