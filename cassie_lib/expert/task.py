"""What the expert is trained on: many robots, many speeds, pushes, and the training reward."""

from __future__ import annotations

import numpy as np

from cassie_lib import gait
from cassie_lib.expert.guidance import gait_term, long_swing, velocity_term
from cassie_lib.expert.pushes import Pushes
from cassie_lib.presets import ExpertParameters
from cassie_lib.reward import ReferencePose, reward
from cassie_lib.robot.randomisation import randomised_models
from cassie_lib.robot.schema import GRAVITY, PERIOD
from cassie_lib.simulator import S0_PHASE, S0_SPEED_MPS, Simulator

#: 0.1 m/s off keep 0.67 of the term, in the refinement 0.30.
_VELOCITY_SHARPNESS, _REFINED_SHARPNESS = 4.0, 12.0
#: Share of the velocity term in the guidance.
_VELOCITY_SHARE, _REFINED_SHARE = 0.3, 0.5
#: A pelvis this low cannot be saved; waiting for the fall would waste a second of simulation.
_LOST_HEIGHT_M = 0.6
#: Share of the training during which a foot that strays ends the episode.
_STRICT_SHARE = 0.4


class WalkingTask:
    """N training robots that start anew when they fall, stray or run out of time.

    Attributes:
        simulator: The robots, at the coarse training timestep.
        progress: Share of the training that is done, 0..1; set by the trainer.
        refining: Whether the training is over and the speed is being refined; set by the trainer.
    """

    def __init__(
        self, parameters: ExpertParameters, timestep_s: float, rng: np.random.Generator
    ) -> None:
        """Start N robots.

        Args:
            parameters: Expert parameters.
            timestep_s: Physics step in s.
            rng: Source of starts, speeds and pushes.
        """
        self.parameters, self.rng = parameters, rng
        models = None
        if parameters.randomise > 0.0:
            models = randomised_models(parameters.robots, parameters.randomise, rng)
        self.simulator = Simulator(parameters.robots, timestep_s, models=models)
        low, high = parameters.min_speed_mps, parameters.max_speed_mps
        speeds = np.append(np.linspace(low, high, 21), S0_SPEED_MPS)
        self.references = [gait.walk(float(speed)) for speed in speeds]
        self._speeds = speeds
        self._motor = np.stack([reference.motor_position for reference in self.references])
        self._joint = np.stack([reference.joint_position for reference in self.references])
        self._height = self.references[0].foot_height_m
        self._swing = long_swing(self.references[0].in_contact)
        self._gait_index = np.zeros(parameters.robots, dtype=int)
        self.age = np.zeros(parameters.robots, dtype=int)
        self.progress, self.refining = 0.0, False
        self._weight_N = GRAVITY * float(self.simulator.model.body_mass.sum())
        self._mean_velocity = np.zeros((parameters.robots, 2))
        self.pushes = Pushes(parameters, rng)
        self._start(np.arange(parameters.robots))
        # Spread the ages so that time limits do not strike all robots at once.
        self.age = rng.integers(0, parameters.episode_steps, parameters.robots)

    def _start(self, indices: np.ndarray) -> None:
        """40 % of the robots start from s0's pose, the others within a reference cycle."""
        count = len(indices)
        if not count:
            return
        chosen = self.rng.integers(0, len(self._speeds), count)
        thesis = self.rng.random(count) < 0.2
        chosen[thesis] = len(self._speeds) - 1
        phase = self.rng.integers(0, PERIOD, count)
        qpos = np.stack([self.references[g].qpos[p] for g, p in zip(chosen, phase, strict=True)])
        qvel = np.stack([self.references[g].qvel[p] for g, p in zip(chosen, phase, strict=True)])
        qpos[:, 0] = 0.0
        self.simulator.reset(indices, qpos=qpos, qvel=qvel, phase=phase, speed=self._speeds[chosen])
        standing = self.rng.random(count) < 0.4
        self.simulator.reset(
            indices[standing], phase=S0_PHASE, speed=self._speeds[chosen[standing]]
        )
        self._gait_index[indices] = chosen
        self._mean_velocity[indices] = self.simulator.qvel[indices, :2]
        self.age[indices] = 0
        self.pushes.forget(indices)

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Advance all robots by one control step; nothing is reset yet.

        Args:
            actions: ``(N, 10)`` rad.

        Returns:
            Training reward, plain Eq 3.10, whether the episode failed, and whether its time is
            up, each ``(N,)``.
        """
        simulator = self.simulator
        self.pushes.strike(simulator, self.progress)
        simulator.step(actions)
        phase, chosen = simulator.phase, self._gait_index
        reference = ReferencePose(self._motor[chosen, phase], self._joint[chosen, phase])
        self.pushes.advance(simulator.qpos[:, 1])
        lateral = simulator.qpos[:, 1] - self.pushes.line_m
        plain = reward(simulator.states, reference, lateral)
        self._mean_velocity += (simulator.qvel[:, :2] - self._mean_velocity) / PERIOD
        load = simulator.foot_force[:, :, 2] / self._weight_N
        periodic = gait_term(simulator.foot_height, load, self._height[phase], self._swing[phase])
        share = _REFINED_SHARE if self.refining else _VELOCITY_SHARE
        sharpness = _REFINED_SHARPNESS if self.refining else _VELOCITY_SHARPNESS
        tracking = velocity_term(self._mean_velocity, simulator.speed, sharpness)
        guidance = (1.0 - share) * periodic + share * tracking
        guidance += self.pushes.indulgence * (1.0 - guidance)
        weight = self.parameters.guidance_weight
        self.age += 1
        down = simulator.fallen | (simulator.qpos[:, 2] < _LOST_HEIGHT_M)
        walking = ~self.pushes.recovering
        failed = down | (walking & (plain < self.parameters.termination_reward))
        if weight > 0.0 and self.progress < _STRICT_SHARE:
            # Without this the way from standing to stepping leads through a valley of reward.
            stray = np.abs(simulator.foot_height - self._height[phase]).max(axis=1)
            failed |= walking & (stray > self.parameters.foot_tolerance_m)
        total = np.where(down, 0.0, (1.0 - weight) * plain + weight * guidance)
        return total, plain, failed, ~failed & (self.age >= self.parameters.episode_steps)

    def restart(self, ended: np.ndarray) -> None:
        """Start the robots of a mask ``(N,)`` anew."""
        self._start(np.flatnonzero(ended))
