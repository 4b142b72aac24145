"""Planners, DAgger and the protocol of every reported number."""

from __future__ import annotations

from dataclasses import dataclass

from cassie_lib.parameters.data import BurstParameters


@dataclass(frozen=True)
class CEMParameters:
    """CEM planner (section 5.2.1)."""

    samples: int = 1000  # N
    elites: int = 50  # K
    iterations: int = 10  # C
    horizon: int = 10  # tau
    discount: float = 0.99  # gamma, applied as gamma^t
    variance: tuple[float, ...] = (0.01, 0.02, 0.01, 0.05, 0.01, 0.03, 0.02, 0.04, 0.01, 0.01)
    mean: str = "zero"  # zero | warm | expert | reference | feedforward
    covariance: str = "diagonal"  # diagonal | full
    keep_best: bool = False
    include_mean: bool = False  # the mean itself is a candidate of every round
    carry: float = 0.0  # share of the last plan's departure from a cycle that the next mean keeps
    warm_fill: str = "repeat"  # repeat | zero: last action of a plan that was moved on
    lower_rad: float = -0.5
    upper_rad: float = 0.5
    std_floor_rad: float = 1e-3
    noise_colour: float = 0.0  # exponent of the power spectrum over the horizon (iCEM)
    elite_reuse: float = 0.0  # share of elites carried to the next iteration (iCEM)
    terminal_weight: float = 0.0  # of the expert's critic beyond the horizon; 0 is the thesis
    speed_weight: float = 0.0  # of keeping the speed over a cycle, beyond the horizon; 0: thesis
    lateral: str = "position"  # position | height
    deadband: bool = False
    foot_weight: float = 0.0  # share of a foot-height term besides Eq 3.10; 0 is the thesis


@dataclass(frozen=True)
class GradientCEMParameters(CEMParameters):
    """Gradient-CEM planner (Algorithm 2, section 5.2.2)."""

    gradient_iterations: int = 7  # G
    learning_rate: float = 7e-2
    momentum: float = 0.8
    normalise_gradient: bool = False
    anneal: bool = False  # learning rate falls linearly over the G iterations, to 1/G of it
    gradient_on_all: bool = False  # True: gradients on all N samples, reference [3]


@dataclass(frozen=True)
class DAggerParameters:
    """Model-based DAgger (Algorithm 3, section 5.2.3)."""

    cycle_steps: int = 27  # phi
    transitions: int = 100_000  # M per round
    schedule: tuple[int, ...] = (1, 2)  # n of each round
    decay: float = 1.0  # beta on older rounds (section 6.2)
    # Share of the batches that all rounds get together; None: by their number of windows, 0: a
    # control that trains as long and learns nothing from them.
    rounds_share: float | None = None
    split: tuple[float, float, float] = (0.6, 0.2, 0.2)
    robots: int = 16
    episode_steps: int = 300
    bursts: BurstParameters | None = None  # disturb the robots while collecting; None: never
    pad_starts: bool = False  # episodes begin with the context of a start without expert
    training_steps: int = 20_000  # optimiser steps per round
    learning_rate: float = 3e-4  # peak of each retraining
    rollout_share: float = 0.4  # last part of a retraining, on tau-step predictions
    minutes_per_round: float = 0.0  # training budget; 0: no limit
    seed: int = 0


@dataclass(frozen=True)
class EvaluationParameters:
    """Protocol of every reported number."""

    seeds: int = 10
    expert_seeds: int = 20
    steps: int = 1000  # control steps per episode
    short_steps: int = 400  # of the trials at other speeds and of those with a push
    planner_steps: int = 560  # of Gradient-CEM's episodes, hand-over included
    cem_steps: int = 330  # of CEM's
    ablation_steps: int = 170  # of the trials with another initial mean
    zero_seeds: int = 30  # of DAgger's trials at the zero mean: some seeds last a cycle longer
    last_round_steps: int = 3060  # after the last DAgger round, begun without the expert
    oracle_seeds: int = 2  # CEM on the true simulator
    oracle_steps: int = 80
    oracle_gradient_seeds: int = 1  # Gradient-CEM on it: 550 simulated steps for one gradient
    oracle_gradient_steps: int = 60
    oracle_timestep_s: float = 0.002  # of the oracle's own physics; the loop's stays fine
