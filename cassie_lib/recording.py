"""Recordings of episodes: what reports, figures and videos are made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cassie_lib import gait
from cassie_lib.reward import WEIGHTS, reward_terms
from cassie_lib.robot.schema import ACTION_SIZE, STATE_SIZE
from cassie_lib.simulator import Simulator


@dataclass(frozen=True)
class Recording:
    """N episodes of up to T control steps; rows beyond an episode's length mean nothing.

    As long as another robot still walks they hold the fallen one as it lies, with the clock going
    on; after the last fall they repeat the last row, with actions and rewards of zero.

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
        total = np.sum(list(self.terms.values()), axis=0)
        steps = np.arange(total.shape[1])
        return np.where(steps[None, :] < self.length[:, None], total, np.nan)

    @property
    def fell(self) -> np.ndarray:
        """Whether each episode ended in a fall, ``(N,)``."""
        return self.length < self.actions.shape[1]


class Tape:
    """Arrays of a recording while it is being written."""

    def __init__(self, episodes: int, steps: int, reference: gait.GaitReference) -> None:
        """Make room for N episodes of T control steps, scored against a reference gait."""
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
        """Store where the robots are at a row in 0..T."""
        self.states[:, row] = simulator.states
        self.qpos[:, row] = simulator.qpos
        self.foot_position[:, row] = simulator.foot_position
        self.foot_height[:, row] = simulator.foot_height
        self.foot_force[:, row] = simulator.foot_force
        self.phase[:, row] = simulator.phase

    def write(self, step: int, simulator: Simulator, actions: np.ndarray) -> None:
        """Store the actions ``(N, 10)`` of a control step, its reward terms and its result."""
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
        """The finished recording."""
        return Recording(
            self.states, self.actions, self.qpos, self.foot_position, self.foot_height,
            self.foot_force, self.phase, self.terms, self.length, speed_mps, protocol
        )  # fmt: skip
