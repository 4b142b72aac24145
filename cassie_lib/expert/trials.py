"""The trials that an expert has to pass before anything is learned from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cassie_lib.controllers import Controller
from cassie_lib.presets import EvaluationParameters
from cassie_lib.recording import Recording
from cassie_lib.robot.schema import PERIOD
from cassie_lib.simulator import S0_SPEED_MPS
from cassie_lib.walking import Push, run_episodes
from cassie_lib.walking_report import WalkingReport, walking_report

SPEEDS_MPS = (0.05, 0.25, 0.5, 0.75, 1.0)
#: Sideways push at the pelvis that an expert should survive.
PUSH_NS = 40.0
_PUSH_STEP = 112


@dataclass(frozen=True)
class ExpertTrials:
    """Results of :func:`run_trials`.

    Attributes:
        quiet: Recording at 0.0509 m/s without noise.
        noisy: The same with action noise of 0.06 rad.
        pushed: The same with a sideways push, over all phases of the cycle and both sides.
        reports: Walking report by commanded speed (m/s).
        report: Walking report of ``quiet``.
    """

    quiet: Recording
    noisy: Recording
    pushed: Recording
    reports: dict[float, WalkingReport]
    report: WalkingReport

    def speeds(self) -> list[np.ndarray]:
        """Mean forward speeds of every episode, one array per commanded speed."""
        return [report["mean forward"].values for report in self.reports.values()]

    def rows(self) -> list[dict[str, object]]:
        """One row per trial: what was asked, how many of the episodes did it."""
        count = len(self.quiet.length)
        inside = {speed: int(r["mean forward"].passed.sum()) for speed, r in self.reports.items()}
        sideways = {s: int(r["mean sideways"].passed.sum()) for s, r in self.reports.items()}
        table = [
            ("no fall, no noise", f"{count}/{count}", int((~self.quiet.fell).sum())),
            ("no fall, action noise 0.06 rad", f"≥ {count - 1}/{count}",
             int((~self.noisy.fell).sum())),
            ("all measures of the walking report", f"{count}/{count}",
             int(self.report.walks.sum())),
            (f"upright after a sideways push of {PUSH_NS:g} N s", f"≥ {3 * count // 4}/{count}",
             int((~self.pushed.fell).sum())),
        ]  # fmt: skip
        table += [(f"speed within 0.05 m/s of {speed:g} m/s", f"{count}/{count}", passed)
                  for speed, passed in inside.items()]  # fmt: skip
        table += [(f"sideways drift < 0.1 m/s at {speed:g} m/s", f"{count}/{count}", passed)
                  for speed, passed in sideways.items()]  # fmt: skip
        return [{"trial": name, "target": target, "episodes": f"{found}/{count}"}
                for name, target, found in table]  # fmt: skip


def run_trials(
    controller: Controller, parameters: EvaluationParameters, timestep_s: float = 0.0005
) -> ExpertTrials:
    """Walk from s0 quietly, with noise, at five speeds and under pushes.

    Args:
        controller: The expert, or any other policy.
        parameters: Number of episodes and their lengths.
        timestep_s: Physics step in s.
    """
    common: dict[str, Any] = {"episodes": parameters.expert_seeds, "timestep_s": timestep_s}
    quiet = run_episodes(controller, steps=parameters.steps, speed_mps=S0_SPEED_MPS, **common)
    noisy = run_episodes(controller, steps=parameters.steps, noise_std_rad=0.06, seed=1, **common)
    push = Push(min(_PUSH_STEP, parameters.short_steps // 2), (0.0, PUSH_NS, 0.0),
                spread_steps=PERIOD, both_sides=True)  # fmt: skip
    pushed = run_episodes(controller, steps=parameters.short_steps, push=push, seed=2, **common)
    reports = {
        speed: walking_report(
            run_episodes(controller, steps=parameters.short_steps, speed_mps=speed, seed=3,
                         **common)
        )
        for speed in SPEEDS_MPS
    }  # fmt: skip
    return ExpertTrials(quiet, noisy, pushed, reports, walking_report(quiet, min_reward=0.85))
