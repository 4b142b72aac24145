"""One robot behind the Gymnasium interface: a thin face on the simulator."""

from __future__ import annotations

import gymnasium
import numpy as np

from cassie_lib import gait
from cassie_lib.errors import ParameterError
from cassie_lib.reward import reward_terms
from cassie_lib.robot.rendering import pictures
from cassie_lib.robot.schema import ACTION_SIZE, CONTROL_PERIOD_S, PERIOD, STATE_SIZE
from cassie_lib.simulator import S0_PHASE, S0_SPEED_MPS, Simulator


class CassieEnv(gymnasium.Env):
    """Walk at a commanded speed.

    Observation: the 49 components of Table 4.1.  Action: 10 offsets of the PD targets from the
    neutral pose in rad.  Reward: Eq 3.10.  The episode terminates when the pelvis leaves
    0.4-3.0 m and is truncated after ``episode_steps``.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": round(1.0 / CONTROL_PERIOD_S)}

    def __init__(
        self,
        speed_mps: float = S0_SPEED_MPS,
        gait_name: str = "walk",
        episode_steps: int = 300,
        start: str = "s0",
        timestep_s: float = 0.0005,
        render_mode: str | None = None,
    ) -> None:
        """Make the environment.

        Args:
            speed_mps: Commanded forward speed.
            gait_name: Reference of the reward, one of ``cassie_lib.gait.GAITS``.
            episode_steps: Control steps before truncation.
            start: ``"s0"`` (Appendix A.3) or ``"reference"`` (a random phase of the gait).
            timestep_s: Physics step in s.
            render_mode: ``"rgb_array"`` or None.

        Raises:
            ParameterError: If a number is out of range or ``start`` is unknown.
            UnknownNameError: If there is no such gait.
        """
        if start not in ("s0", "reference"):
            raise ParameterError(f"start = {start!r}: expected 's0' or 'reference'")
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ParameterError(f"render_mode = {render_mode!r}: expected 'rgb_array' or None")
        if episode_steps < 1:
            raise ParameterError(f"episode_steps = {episode_steps}: expected at least 1")
        self.render_mode = render_mode
        self._reference = gait.get_gait(gait_name, speed_mps)
        self._speed, self._start, self._limit = speed_mps, start, episode_steps
        self._simulator = Simulator(1, timestep_s, threads=1)
        self._simulator.reset(speed=speed_mps)
        self._age = 0
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (STATE_SIZE,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float64)

    def reset(self, *, seed=None, options=None):
        """Start an episode; returns the observation ``(49,)`` and an empty dictionary."""
        super().reset(seed=seed)
        del options
        self._age = 0
        if self._start == "s0":
            self._simulator.reset(phase=S0_PHASE, speed=self._speed)
        else:
            phase = int(self.np_random.integers(PERIOD))
            self._simulator.reset(
                qpos=self._reference.qpos[phase],
                qvel=self._reference.qvel[phase],
                phase=phase,
                speed=self._speed,
            )
        return self._simulator.states[0], {}

    def step(self, action):
        """Hold an action ``(10,)`` for 0.03 s.

        Returns:
            Observation, Eq 3.10, terminated, truncated, and the six reward terms by name.
        """
        self._simulator.step(np.asarray(action, dtype=float)[None])
        self._age += 1
        terms = reward_terms(
            self._simulator.states,
            self._reference.pose(self._simulator.phase),
            self._simulator.qpos[:, 1],
        )
        info = {name: float(value[0]) for name, value in terms.items()}
        terminated = bool(self._simulator.fallen[0])
        truncated = not terminated and self._age >= self._limit
        return self._simulator.states[0], sum(info.values()), terminated, truncated, info

    def render(self):
        """Picture ``(480, 640, 3)`` of the robot."""
        return pictures(self._simulator.qpos)[0][0]
