"""Closed-loop episodes of any controller, recorded with all that proves a walk."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cassie_lib import gait
from cassie_lib.controllers import Controller, Observation
from cassie_lib.errors import ParameterError
from cassie_lib.recording import Recording, Tape
from cassie_lib.robot.schema import CONTROL_PERIOD_S
from cassie_lib.simulator import S0_SPEED_MPS, Simulator


class Push(NamedTuple):
    """An external push on the pelvis.

    Attributes:
        step: First control step of the push.
        impulse: N s in the world frame.
        duration_steps: Control steps over which it is spread; 4 are 0.12 s.
        spread_steps: The episodes are pushed at even intervals within this many control steps
            after ``step``, so that a whole gait cycle (28) can be covered.
        both_sides: Whether every other episode is pushed to the other side.
    """

    step: int
    impulse: tuple[float, float, float]
    duration_steps: int = 4
    spread_steps: int = 0
    both_sides: bool = False

    def apply(self, simulator: Simulator, step: int) -> None:
        """Push the robots whose turn it is at this control step."""
        order = np.arange(simulator.count)
        due = np.flatnonzero(self.step + order * self.spread_steps // simulator.count == step)
        if len(due):
            sign = np.where(self.both_sides & (order[due] % 2 == 1), -1.0, 1.0)
            impulse = np.array(self.impulse) * np.stack(
                [np.ones(len(due)), sign, np.ones(len(due))], axis=1
            )
            simulator.push(impulse, self.duration_steps, due)

    def __str__(self) -> str:
        """One phrase for a protocol line."""
        size = float(np.linalg.norm(self.impulse))
        return (
            f"push of {size:g} N s at step {self.step}"
            + (f" to {self.step + self.spread_steps}" if self.spread_steps else "")
            + (", left and right in turn" if self.both_sides else "")
        )


def run_episodes(
    controller: Controller,
    *,
    episodes: int,
    steps: int,
    speed_mps: float = S0_SPEED_MPS,
    noise_std_rad: float = 0.0,
    perturbation: float = 0.05,
    push: Push | None = None,
    seed: int = 0,
    timestep_s: float = 0.0005,
    reference: gait.GaitReference | None = None,
) -> Recording:
    """Run episodes from s0 in one batch.

    Args:
        controller: Any policy or planner.
        episodes: Number of episodes N; each has its own random start and noise.
        steps: Control steps T of 0.03 s.
        speed_mps: Commanded forward speed.
        noise_std_rad: Standard deviation of the Gaussian added to every action.
        perturbation: Standard deviation of random initial velocities (m/s, rad/s) around s0, so
            that seeds differ; 0 starts every episode from s0 exactly.
        push: Push on the pelvis, or None.
        seed: Seeds starts and noise.
        timestep_s: Physics step; 0.5 ms for every reported number.
        reference: Gait that the reward compares with; default a walk at ``speed_mps``.

    Returns:
        The recording.

    Raises:
        ParameterError: If counts are under 1 or the noise is negative.
    """
    if episodes < 1 or steps < 1 or noise_std_rad < 0.0 or perturbation < 0.0:
        raise ParameterError(
            f"episodes = {episodes}, steps = {steps}, noise_std_rad = {noise_std_rad}, "
            f"perturbation = {perturbation}: expected counts >= 1 and deviations >= 0"
        )
    rng = np.random.default_rng(seed)
    simulator = Simulator(episodes, timestep_s)
    qvel = rng.normal(0.0, perturbation, (episodes, 32)) if perturbation else None
    if qvel is not None:
        qvel[:, 6:] *= _driven_mask()
    simulator.reset(qvel=qvel, speed=speed_mps)
    controller.reset(episodes, seed)
    tape = Tape(episodes, steps, reference or gait.walk(speed_mps))
    tape.write_state(0, simulator)
    for step in range(steps):
        if push is not None:
            push.apply(simulator, step)
        observation = Observation(
            simulator.states, simulator.physics.copy(), simulator.phase.copy(),
            simulator.pelvis_position, step
        )  # fmt: skip
        actions = controller.act(observation)
        if noise_std_rad:
            actions = actions + rng.normal(0.0, noise_std_rad, actions.shape)
        simulator.step(actions)
        tape.write(step, simulator, actions)
        if simulator.fallen.all():
            tape.fill(step + 1)
            break
    protocol = (
        f"from s0, {episodes} episodes of {steps} control steps "
        f"({steps * CONTROL_PERIOD_S:.1f} s), {timestep_s * 1e3:g} ms physics, "
        f"initial velocities N(0, {perturbation:g}), action noise {noise_std_rad:g} rad"
        + (f", {push}" if push else "")
    )
    return tape.recording(speed_mps, protocol)


def _driven_mask() -> np.ndarray:
    """Perturb driven joints only: the others are bound by the loops."""
    from cassie_lib.robot.model import motor_qvel

    mask = np.zeros(26)
    mask[motor_qvel() - 6] = 1.0
    return mask
