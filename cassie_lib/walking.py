"""Closed-loop episodes of any controller, recorded with all that proves a walk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from cassie_lib import gait
from cassie_lib.errors import ParameterError
from cassie_lib.reward import WEIGHTS, reward_terms
from cassie_lib.robot.schema import ACTION_SIZE, CONTROL_PERIOD_S, STATE_SIZE
from cassie_lib.simulator import S0_SPEED_MPS, Simulator


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


@dataclass(frozen=True)
class Recording:
    """N episodes of up to T control steps; rows beyond an episode's length repeat its end.

    Attributes:
        states: ``(N, T+1, 49)``.
        actions: ``(N, T, 10)`` rad, as executed.
        qpos: ``(N, T+1, 35)``.
        foot_position: ``(N, T+1, 2, 3)`` m, world frame, left and right.
        foot_height: ``(N, T+1, 2)`` m over the floor.
        foot_force: ``(N, T+1, 2, 3)`` N, world frame, mean over each control step.
        phase: ``(N, T+1)``.
        terms: The six weighted terms of Eq 3.10, each ``(N, T)``.
        length: Control steps before the fall, T where there was none, ``(N,)``.
        speed_mps: Commanded forward speed.
        protocol: One line that says how the episodes were run.
    """

    states: np.ndarray
    actions: np.ndarray
    qpos: np.ndarray
    foot_position: np.ndarray
    foot_height: np.ndarray
    foot_force: np.ndarray
    phase: np.ndarray
    terms: dict[str, np.ndarray]
    length: np.ndarray
    speed_mps: float
    protocol: str

    @property
    def reward(self) -> np.ndarray:
        """Plain Eq 3.10 per control step, ``(N, T)``; NaN after a fall."""
        total = sum(self.terms.values())
        steps = np.arange(total.shape[1])
        return np.where(steps[None, :] < self.length[:, None], total, np.nan)

    @property
    def fell(self) -> np.ndarray:
        """Whether each episode ended in a fall, ``(N,)``."""
        return self.length < self.actions.shape[1]


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
    tape = _Tape(episodes, steps, reference or gait.walk(speed_mps))
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


class _Tape:
    """Arrays of a recording while it is being written."""

    def __init__(self, episodes: int, steps: int, reference: gait.GaitReference) -> None:
        self.reference, self.steps = reference, steps
        long = (episodes, steps + 1)
        self.states = np.zeros((*long, STATE_SIZE))
        self.qpos = np.zeros((*long, 35))
        self.foot_position = np.zeros((*long, 2, 3))
        self.foot_height = np.zeros((*long, 2))
        self.foot_force = np.zeros((*long, 2, 3))
        self.phase = np.zeros(long, dtype=int)
        self.actions = np.zeros((episodes, steps, ACTION_SIZE))
        self.terms = {name: np.zeros((episodes, steps)) for name in WEIGHTS}
        self.length = np.full(episodes, steps)

    def write_state(self, row: int, simulator: Simulator) -> None:
        self.states[:, row] = simulator.states
        self.qpos[:, row] = simulator.qpos
        self.foot_position[:, row] = simulator.foot_position
        self.foot_height[:, row] = simulator.foot_height
        self.foot_force[:, row] = simulator.foot_force
        self.phase[:, row] = simulator.phase

    def write(self, step: int, simulator: Simulator, actions: np.ndarray) -> None:
        self.write_state(step + 1, simulator)
        self.actions[:, step] = actions
        terms = reward_terms(
            simulator.states, self.reference.pose(simulator.phase), simulator.qpos[:, 1]
        )
        for name, values in terms.items():
            self.terms[name][:, step] = values
        new = simulator.fallen & (self.length == self.steps)
        self.length[new] = step

    def fill(self, row: int) -> None:
        """Repeat the end of the episodes when all have fallen."""
        for array in (
            self.states,
            self.qpos,
            self.foot_position,
            self.foot_height,
            self.foot_force,
            self.phase,
        ):
            array[:, row + 1 :] = array[:, row : row + 1]

    def recording(self, speed_mps: float, protocol: str) -> Recording:
        return Recording(
            self.states, self.actions, self.qpos, self.foot_position, self.foot_height,
            self.foot_force, self.phase, self.terms, self.length, speed_mps, protocol
        )  # fmt: skip
