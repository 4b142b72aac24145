"""Every hyper-parameter, with units, in three presets.

``smoke`` runs every line in seconds and its results mean nothing; ``laptop`` gives the figures
that the README shows; ``thesis`` holds the thesis's own values and is meant for a GPU.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace

from cassie_lib.errors import unknown_name


@dataclass(frozen=True)
class SimulationParameters:
    """Physics.  Coarse steps serve expert training only; every reported number uses fine ones."""

    timestep_s: float = 0.0005
    training_timestep_s: float = 0.002
    speed_mps: float = 0.0509  # commanded forward speed of the thesis's data (section 4.3.2)


@dataclass(frozen=True)
class ExpertParameters:
    """Recurrent PPO (thesis section 4.3.1)."""

    hidden_size: int = 128
    layers: int = 2
    action_std_rad: float = 0.13  # exploration noise, fixed for most of the training
    final_action_std_rad: float = 0.05  # at its end: noise slows a walk, so the mean action drifts
    robots: int = 128
    rollout_steps: int = 56  # control steps per robot and update
    total_steps: int = 4_500_000  # control steps over all robots, before the refinement
    refinement_steps: int = 1_100_000  # more, for speed and pushes, at a low learning rate
    refinement_learning_rate: float = 3e-4
    epochs: int = 3
    minibatches: int = 4
    sequence_steps: int = 28  # truncation of back-propagation through time
    learning_rate: float = 1e-3
    discount: float = 0.97
    gae_lambda: float = 0.95
    clip: float = 0.2
    target_kl: float = 0.03
    max_gradient_norm: float = 0.5
    episode_steps: int = 300
    guidance_weight: float = 0.5  # share of the gait and velocity terms in the training reward
    foot_tolerance_m: float = 0.09  # a training episode ends when a sole strays this far in height
    push_limit_Ns: float = 55.0  # largest sideways push on the pelvis during training, N s
    push_interval_steps: int = 150  # mean control steps between pushes
    randomise: float = 0.0  # relative spread of masses, damping, friction; 0: none
    termination_reward: float = 0.3  # an episode ends when Eq 3.10 falls under this
    min_speed_mps: float = 0.0
    max_speed_mps: float = 1.0
    checkpoint_seconds: float = 60.0
    seed: int = 0


#: Eq 3.10 alone at the thesis's speed: the policy that learns to stand still.
REWARD_ONLY = ExpertParameters(
    guidance_weight=0.0,
    push_limit_Ns=0.0,
    min_speed_mps=0.0509,
    max_speed_mps=0.0509,
    total_steps=1_000_000,
    refinement_steps=0,
)


@dataclass(frozen=True)
class CollectionParameters:
    """One data set of section 4.3: how many transitions at which action noise."""

    name: str
    transitions: int
    noise_std_rad: float
    seed: int
    episode_steps: int = 300
    robots: int = 32


@dataclass(frozen=True)
class NoiseStudyParameters:
    """Whole episodes at each of several noise levels (falls and foot paths against sigma)."""

    noise_std_rad: tuple[float, ...] = (
        0.0, 0.01, 0.03, 0.06, 0.08, 0.1, 0.125, 0.15, 0.175, 0.2, 0.225, 0.25,
    )  # fmt: skip
    robots: int = 32  # episodes per level
    episode_steps: int = 300
    seed: int = 8


@dataclass(frozen=True)
class DataParameters:
    """The five data sets of sections 5.1.1 and 5.1.2, two wide ones, and the noise study."""

    train: CollectionParameters = CollectionParameters("train", 90_650, 0.06, 1)
    validation: CollectionParameters = CollectionParameters("validation", 41_650, 0.03, 2)
    test: CollectionParameters = CollectionParameters("test", 41_650, 0.01, 3)
    # Longer episodes, so that windows of H = 100 lose a tenth of the samples, not a third.
    baseline: CollectionParameters = CollectionParameters("baseline", 10_000, 0.01, 4, 1000)
    baseline_test: CollectionParameters = CollectionParameters(
        "baseline_test", 4_000, 0.03, 5, 1000
    )
    #: Not in the thesis: trains and tests the causal model off the expert's habits.
    wide: CollectionParameters = CollectionParameters("wide", 60_000, 0.15, 6)
    wide_test: CollectionParameters = CollectionParameters("wide_test", 10_000, 0.15, 7)
    noise_study: NoiseStudyParameters = NoiseStudyParameters()


@dataclass(frozen=True)
class MLPParameters:
    """Fully connected baseline (section 5.1.1, Figures 5.1 and 5.2)."""

    context: int = 100  # H, past state-action pairs
    hidden_layers: int = 3
    hidden_size: int = 5000
    learning_rate: float = 1e-4
    batch_size: int = 128
    epochs: int = 25
    curriculum_epochs: int = 20
    horizon: int = 6  # tau, predicted control steps
    patience: int = 4  # epochs
    slope: float = 0.05
    checkpoint_seconds: float = 60.0
    max_minutes: float = 0.0  # 0: no limit
    seed: int = 0


@dataclass(frozen=True)
class TransformerParameters:
    """Encoder-decoder of section 5.1.2; the defaults have 12,919,393 parameters."""

    context: int = 30  # H
    representation_size: int = 1000
    representation_layers: int = 2
    embedding_size: int = 64
    model_size: int = 256
    heads: int = 8
    encoder_layers: int = 4
    decoder_layers: int = 4
    feedforward_size: int = 2048
    dropout: float = 0.1
    horizon: int = 10  # tau
    epochs: int = 1000
    windows_per_epoch: int = 0  # 0: all of them
    batch_size: int = 128
    learning_rate: float = 1e-4
    weight_decay: float = 1e-2
    gradient_penalty: float = 1e-2  # lambda of Eq 3.9
    order_weights: tuple[float, float, float] = (1.0, 2.0, 5.0)  # w by derivative order
    scheduler_patience: int = 75  # epochs
    scheduler_factor: float = 0.9
    patience: int = 75  # p, epochs
    change_percent: float = 5.0  # psi
    validation_windows: int = 0  # windows per epoch of validation and test; 0: all of them
    checkpoint_seconds: float = 60.0
    max_minutes: float = 0.0  # 0: no limit
    seed: int = 0


@dataclass(frozen=True)
class GridParameters:
    """Hyper-parameter grid of Appendix A.1: its values, and the budget of one point.

    Every point trains the preset's transformer with the same number of passes over windows, so
    that a point does not depend on how busy the machine is.
    """

    batch_size: tuple[int, ...] = (64, 128, 256)
    context: tuple[int, ...] = (30, 40, 50)
    learning_rate: tuple[float, ...] = (1e-3, 1e-4, 1e-5)
    dropout: tuple[float, ...] = (0.1, 0.2, 0.3)
    weight_decay: tuple[float, ...] = (1e-3, 1e-2, 1e-1)
    epochs: int = 1000
    windows_per_epoch: int = 0  # 0: all of them
    horizon: int = 10  # tau of the training
    gradient_penalty: float = 1e-2
    evaluation_windows: int = 2000  # of the validation set
    base_seeds: int = 3  # trainings of the choice itself: their spread is noise


@dataclass(frozen=True)
class CausalParameters:
    """Decoder-only model with a key-value cache: this project's extension."""

    context: int = 30  # H
    clock_input: bool = False  # whether the clock and the commanded speed are inputs
    model_size: int = 128
    heads: int = 4
    layers: int = 3
    feedforward_size: int = 512
    dropout: float = 0.0
    horizon: int = 10  # tau
    steps: int = 20_000  # optimiser steps
    rollout_share: float = 0.4  # last part of the training, on tau-step predictions
    batch_size: int = 128
    learning_rate: float = 1e-3
    warmup_share: float = 0.02
    final_learning_rate: float = 1e-5
    weight_decay: float = 1e-2
    clip_norm: float = 1.0
    mirror: bool = True  # half of every batch with left and right exchanged
    order_weights: tuple[float, float, float] = (1.0, 1.0, 1.0)
    validation_steps: int = 500  # optimiser steps between two validations
    validation_windows: int = 500
    checkpoint_seconds: float = 60.0
    max_minutes: float = 45.0  # 0: no limit
    wide_noise_std_rad: float = 0.15  # one more training set, collected at this action noise
    seed: int = 0


@dataclass(frozen=True)
class CEMParameters:
    """CEM planner (section 5.2.1)."""

    samples: int = 1000  # N
    elites: int = 50  # K
    iterations: int = 10  # C
    horizon: int = 10  # tau
    discount: float = 0.99  # gamma, applied as gamma^t
    variance: tuple[float, ...] = (0.01, 0.02, 0.01, 0.05, 0.01, 0.03, 0.02, 0.04, 0.01, 0.01)
    mean: str = "zero"  # zero | warm | expert
    covariance: str = "diagonal"  # diagonal | full
    keep_best: bool = False
    include_mean: bool = False  # the mean itself is a candidate of every round
    warm_fill: str = "repeat"  # repeat | zero: last action of a plan that was moved on
    lower_rad: float = -0.5
    upper_rad: float = 0.5
    std_floor_rad: float = 1e-3
    noise_colour: float = 0.0  # exponent of the power spectrum over the horizon (iCEM)
    elite_reuse: float = 0.0  # share of elites carried to the next iteration (iCEM)
    terminal_value: bool = False
    lateral: str = "position"  # position | height
    deadband: bool = False
    gait_weight: float = 0.0  # share of a gait-tracking term besides Eq 3.10; 0 is the thesis


@dataclass(frozen=True)
class GradientCEMParameters(CEMParameters):
    """Gradient-CEM planner (Algorithm 2, section 5.2.2)."""

    gradient_iterations: int = 7  # G
    learning_rate: float = 7e-2
    momentum: float = 0.8
    normalise_gradient: bool = False
    gradient_on_all: bool = False  # True: gradients on all N samples, reference [3]


@dataclass(frozen=True)
class DAggerParameters:
    """Model-based DAgger (Algorithm 3, section 5.2.3)."""

    cycle_steps: int = 27  # phi
    transitions: int = 100_000  # M per round
    schedule: tuple[int, ...] = (1, 2)  # n of each round
    decay: float = 1.0  # beta on older rounds (section 6.2)
    split: tuple[float, float, float] = (0.6, 0.2, 0.2)
    robots: int = 16
    episode_steps: int = 300
    pad_starts: bool = False  # episodes begin with the context of a start without expert
    training_steps: int = 20_000  # optimiser steps per round
    learning_rate: float = 3e-4  # peak of each retraining
    minutes_per_round: float = 0.0  # training budget; 0: no limit
    seed: int = 0


@dataclass(frozen=True)
class EvaluationParameters:
    """Protocol of every reported number."""

    seeds: int = 10
    expert_seeds: int = 20
    steps: int = 1000  # control steps per episode
    short_steps: int = 400  # of the trials at other speeds and of those with a push
    planner_steps: int = 560  # of a planner's episodes, hand-over included
    ablation_steps: int = 230  # of the trials with another initial mean
    last_round_steps: int = 3060  # of the last DAgger round
    oracle_seeds: int = 2  # CEM on the true simulator
    oracle_steps: int = 100
    oracle_gradient_seeds: int = 1  # Gradient-CEM on it: 550 simulated steps for one gradient
    oracle_gradient_steps: int = 80
    oracle_timestep_s: float = 0.002  # of the oracle's own physics; the loop's stays fine


@dataclass(frozen=True)
class Preset:
    """All parameters of one preset."""

    name: str
    simulation: SimulationParameters = field(default_factory=SimulationParameters)
    expert: ExpertParameters = field(default_factory=ExpertParameters)
    reward_only_expert: ExpertParameters = field(default_factory=lambda: REWARD_ONLY)
    data: DataParameters = field(default_factory=DataParameters)
    mlp: MLPParameters = field(default_factory=MLPParameters)
    transformer: TransformerParameters = field(default_factory=TransformerParameters)
    grid: GridParameters = field(default_factory=GridParameters)
    causal: CausalParameters = field(default_factory=CausalParameters)
    cem: CEMParameters = field(default_factory=CEMParameters)
    gradient_cem: GradientCEMParameters = field(default_factory=GradientCEMParameters)
    dagger: DAggerParameters = field(default_factory=DAggerParameters)
    evaluation: EvaluationParameters = field(default_factory=EvaluationParameters)


def _smoke() -> Preset:
    collection = {
        name: CollectionParameters(name, transitions, noise, seed, episode_steps=60, robots=4)
        for name, transitions, noise, seed in (
            ("train", 480, 0.06, 1), ("validation", 240, 0.03, 2), ("test", 240, 0.01, 3),
            ("baseline", 480, 0.01, 4), ("baseline_test", 240, 0.03, 5),
            ("wide", 240, 0.15, 6), ("wide_test", 240, 0.15, 7),
        )
    }
    study = NoiseStudyParameters((0.0, 0.06, 0.25), robots=4, episode_steps=60)
    cem = CEMParameters(samples=8, elites=3, iterations=1, horizon=3, mean="warm")
    return Preset(
        "smoke",
        expert=ExpertParameters(
            hidden_size=16, robots=4, rollout_steps=28, total_steps=224, refinement_steps=112,
            epochs=1, minibatches=1, episode_steps=56,
        ),
        reward_only_expert=replace(
            REWARD_ONLY, hidden_size=16, robots=4, rollout_steps=28, total_steps=224, epochs=1,
            minibatches=1, episode_steps=56,
        ),
        data=DataParameters(**collection, noise_study=study),
        mlp=MLPParameters(context=5, hidden_size=32, epochs=2, curriculum_epochs=2, horizon=2,
                          patience=1),
        transformer=TransformerParameters(
            context=6, representation_size=16, embedding_size=8, model_size=16, heads=2,
            encoder_layers=1, decoder_layers=1, feedforward_size=32, horizon=2, epochs=2,
            windows_per_epoch=64, batch_size=32, scheduler_patience=1, patience=1,
        ),
        grid=GridParameters(
            batch_size=(16, 32), context=(6, 8), learning_rate=(1e-3, 1e-4), dropout=(0.1, 0.2),
            weight_decay=(1e-3, 1e-2), base_seeds=2, epochs=1, windows_per_epoch=64, horizon=1,
            evaluation_windows=32,
        ),
        causal=CausalParameters(
            context=6, model_size=16, heads=2, layers=1, feedforward_size=32, horizon=3, steps=6,
            batch_size=16, validation_steps=3, validation_windows=16, max_minutes=0.5,
        ),
        cem=cem,
        gradient_cem=GradientCEMParameters(
            samples=8, elites=3, iterations=1, horizon=3, mean="warm", gradient_iterations=1,
            normalise_gradient=True,
        ),
        dagger=DAggerParameters(transitions=160, schedule=(1, 27), robots=4, episode_steps=40,
                                training_steps=6, minutes_per_round=0.1),
        evaluation=EvaluationParameters(
            seeds=2, expert_seeds=2, steps=120, short_steps=120, planner_steps=90,
            ablation_steps=60, last_round_steps=100, oracle_seeds=1, oracle_steps=40,
            oracle_gradient_seeds=1, oracle_gradient_steps=40,
        ),
    )


def _laptop() -> Preset:
    return Preset(
        "laptop",
        mlp=MLPParameters(hidden_size=512),
        transformer=TransformerParameters(
            representation_size=256, model_size=128, feedforward_size=512, heads=4,
            encoder_layers=2, decoder_layers=2, epochs=300, windows_per_epoch=8192,
            scheduler_patience=20, patience=15, validation_windows=1024, max_minutes=60.0,
        ),
        grid=GridParameters(epochs=4, windows_per_epoch=6144, horizon=1, gradient_penalty=0.0,
                            evaluation_windows=500),
        causal=CausalParameters(
            layers=2, model_size=160, feedforward_size=640, batch_size=64, max_minutes=22.0
        ),
        cem=CEMParameters(samples=256, elites=32, iterations=4, mean="warm", keep_best=True,
                          include_mean=True),
        gradient_cem=GradientCEMParameters(
            samples=32, elites=8, iterations=1, gradient_iterations=12, learning_rate=0.03,
            mean="warm", keep_best=True, include_mean=True, normalise_gradient=True,
        ),
        dagger=DAggerParameters(transitions=20_000, schedule=(1, 2, 9, 18, 27),
                                pad_starts=True, training_steps=4000),
    )


PRESETS = {preset.name: preset for preset in (_smoke(), _laptop(), Preset("thesis"))}


def get_preset(name: str) -> Preset:
    """Return a preset by name.

    Raises:
        UnknownNameError: If there is no such preset.
    """
    if name not in PRESETS:
        raise unknown_name("preset", name, PRESETS)
    return PRESETS[name]


def resolve(name: str) -> Preset:
    """Preset of a notebook: ``CASSIE_PRESET`` overrides the cell, because nbval cannot inject.

    Raises:
        UnknownNameError: If there is no such preset.
    """
    return get_preset(os.environ.get("CASSIE_PRESET") or name)


__all__ = ["PRESETS", "Preset", "get_preset", "replace", "resolve"]
