"""Which of several trained policies becomes the expert: trials decide, not the training reward.

The last bits of a training differ from processor to processor, and with them what a policy can do:
the same continuation mends a policy's pushes and speeds on one and spoils its slowest walk on
another.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cassie_lib.controllers import Controller
from cassie_lib.expert.trials import PUSH_NS, SPEEDS_MPS
from cassie_lib.recording import Recording
from cassie_lib.robot.schema import PERIOD
from cassie_lib.simulator import S0_SPEED_MPS
from cassie_lib.walking import Push, run_episodes
from cassie_lib.walking_report import walking_report

#: First seed: not the starts of the trials that are reported afterwards (``expert.trials``).
SEED = 1000
_PUSH_STEP = 112


class Score(NamedTuple):
    """What trials say of a policy; tuples compare from the left.

    Attributes:
        walks: Share of the episodes at the thesis's speed that pass the walking report: the data
            are collected there.
        passed: Mean share of the episodes that keep each of five speeds, ahead and to the side,
            and of those that stay upright after a push of 40 N s.
    """

    walks: float
    passed: float


def score(policy: Controller, episodes: int, steps: int, timestep_s: float) -> Score:
    """Try a policy at five speeds and under pushes.

    Args:
        policy: The policy.
        episodes: Episodes of each trial.
        steps: Control steps of an episode, at least four cycles.
        timestep_s: Physics step, s.

    Raises:
        ParameterError: If the episodes are too short for a walking report.
    """
    common: dict[str, Any] = {"episodes": episodes, "steps": steps, "timestep_s": timestep_s}

    def walk(index: int, speed_mps: float) -> Recording:
        return run_episodes(policy, speed_mps=speed_mps, seed=SEED * (index + 1), **common)

    speeds = (S0_SPEED_MPS, *SPEEDS_MPS[1:])
    reports = [
        walking_report(walk(index, speed), min_reward=0.0 if index else 0.85)
        for index, speed in enumerate(speeds)
    ]
    push = Push(min(_PUSH_STEP, steps // 2), (0.0, PUSH_NS, 0.0),
                spread_steps=PERIOD, both_sides=True)  # fmt: skip
    pushed = run_episodes(policy, push=push, seed=SEED * (len(speeds) + 1), **common)
    kept = [report["mean forward"].passed & report["mean sideways"].passed for report in reports]
    shares = [float(np.mean(passed)) for passed in (*kept, ~pushed.fell)]
    return Score(float(reports[0].walks.mean()), float(np.mean(shares)))


def select(scores: dict[str, Score]) -> str:
    """Name of the policy with the best score; of equal ones the last.

    Args:
        scores: Scores by name, in the order in which the policies were trained.
    """
    best = max(scores.values())
    return [name for name, found in scores.items() if found == best][-1]
