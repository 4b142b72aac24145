"""Every hyper-parameter, with units, in three presets.

``smoke`` runs every line in seconds and its results mean nothing; ``laptop`` gives the figures
that the README shows; ``thesis`` holds the thesis's own values and is meant for a GPU.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from typing import Any

from cassie_lib import parameters
from cassie_lib.errors import unknown_name
from cassie_lib.parameters import (
    CONTINUATION,
    REWARD_ONLY,
    BurstParameters,
    CausalParameters,
    CEMParameters,
    CollectionParameters,
    DAggerParameters,
    DataParameters,
    EvaluationParameters,
    ExpertParameters,
    GradientCEMParameters,
    GridParameters,
    MLPParameters,
    NoiseStudyParameters,
    SimulationParameters,
    TransformerParameters,
    WideCollectionParameters,
)


@dataclass(frozen=True)
class Preset:
    """All parameters of one preset."""

    name: str
    simulation: SimulationParameters = field(default_factory=SimulationParameters)
    expert: ExpertParameters = field(default_factory=ExpertParameters)
    expert_continuation: ExpertParameters = field(default_factory=lambda: CONTINUATION)
    reward_only_expert: ExpertParameters = field(default_factory=lambda: REWARD_ONLY)
    data: DataParameters = field(default_factory=DataParameters)
    mlp: MLPParameters = field(default_factory=MLPParameters)
    transformer: TransformerParameters = field(default_factory=TransformerParameters)
    grid: GridParameters = field(default_factory=GridParameters)
    causal: CausalParameters = field(default_factory=CausalParameters)
    #: Trained without the wide data: where DAgger has something to gain.
    narrow_causal: CausalParameters = field(default_factory=CausalParameters)
    cem: CEMParameters = field(default_factory=CEMParameters)
    gradient_cem: GradientCEMParameters = field(default_factory=GradientCEMParameters)
    dagger: DAggerParameters = field(default_factory=DAggerParameters)
    #: Rounds from that model, as in Algorithm 3: nobody disturbs the robots.
    narrow_dagger: DAggerParameters = field(default_factory=DAggerParameters)
    evaluation: EvaluationParameters = field(default_factory=EvaluationParameters)


def _smoke() -> Preset:
    collection = {
        name: CollectionParameters(name, transitions, noise, seed, episode_steps=60, robots=4)
        for name, transitions, noise, seed in (
            ("train", 480, 0.06, 1),
            ("validation", 240, 0.03, 2),
            ("test", 240, 0.01, 3),
            ("baseline", 480, 0.01, 4),
            ("baseline_test", 240, 0.03, 5),
            ("wide_test", 240, 0.15, 7),
        )
    }
    wide = WideCollectionParameters(
        "wide", 240, 0.06, 6, 60, 4, bursts=BurstParameters(pause_steps=(5, 20))
    )
    study = NoiseStudyParameters((0.0, 0.06, 0.25), robots=4, episode_steps=60)
    tiny: dict[str, Any] = {
        "hidden_size": 16,
        "robots": 4,
        "rollout_steps": 28,
        "epochs": 1,
        "minibatches": 1,
        "episode_steps": 56,
    }
    causal = CausalParameters(
        context=6,
        model_size=16,
        heads=2,
        layers=1,
        feedforward_size=32,
        horizon=3,
        steps=6,
        average_share=0.5,
        batch_size=16,
        validation_steps=3,
        validation_windows=16,
    )
    cem = CEMParameters(samples=8, elites=3, iterations=1, horizon=3, mean="warm")
    dagger = DAggerParameters(
        transitions=160, schedule=(1, 27), robots=4, episode_steps=40, training_steps=6
    )
    return Preset(
        "smoke",
        expert=ExpertParameters(total_steps=224, refinement_steps=112, **tiny),
        expert_continuation=replace(CONTINUATION, refinement_steps=112, **tiny),
        reward_only_expert=replace(REWARD_ONLY, total_steps=224, **tiny),
        data=DataParameters(**collection, wide=wide, noise_study=study),
        mlp=MLPParameters(
            context=5, hidden_size=32, epochs=2, curriculum_epochs=2, horizon=2, patience=1
        ),
        transformer=TransformerParameters(
            context=6,
            representation_size=16,
            embedding_size=8,
            model_size=16,
            heads=2,
            encoder_layers=1,
            decoder_layers=1,
            feedforward_size=32,
            horizon=2,
            epochs=2,
            windows_per_epoch=64,
            batch_size=32,
            scheduler_patience=1,
            patience=1,
        ),
        grid=GridParameters(
            batch_size=(16, 32),
            context=(6, 8),
            learning_rate=(1e-3, 1e-4),
            dropout=(0.1, 0.2),
            weight_decay=(1e-3, 1e-2),
            base_seeds=2,
            epochs=1,
            windows_per_epoch=64,
            horizon=1,
            evaluation_windows=32,
        ),
        causal=causal,
        narrow_causal=causal,
        cem=cem,
        gradient_cem=GradientCEMParameters(
            samples=8,
            elites=3,
            iterations=1,
            horizon=3,
            mean="warm",
            gradient_iterations=1,
            normalise_gradient=True,
        ),
        dagger=dagger,
        narrow_dagger=dagger,
        evaluation=EvaluationParameters(
            seeds=2,
            expert_seeds=2,
            zero_seeds=2,
            steps=120,
            short_steps=120,
            planner_steps=90,
            cem_steps=90,
            ablation_steps=60,
            last_round_steps=120,  # a start without expert leaves two cycles out of its report
            oracle_seeds=1,
            oracle_steps=40,
            oracle_gradient_seeds=1,
            oracle_gradient_steps=40,
        ),
    )


def _laptop() -> Preset:
    causal = CausalParameters(
        layers=2, model_size=160, feedforward_size=640, batch_size=64, steps=13_700,
        rollout_share=0.29,
    )  # fmt: skip
    dagger = DAggerParameters(
        transitions=10_000,
        schedule=(1, 2, 27),
        # Whoever drives without the expert must have seen how to recover.
        bursts=BurstParameters(strongest_rad=0.4),
        pad_starts=True,
        training_steps=1000,
        learning_rate=1e-4,
        # One-step batches first would undo what the model has learned of ten steps.
        rollout_share=1.0,
    )
    return Preset(
        "laptop",
        mlp=MLPParameters(hidden_size=256),
        transformer=TransformerParameters(
            representation_size=256,
            model_size=128,
            feedforward_size=512,
            heads=4,
            encoder_layers=2,
            decoder_layers=2,
            # 1280 optimiser steps, for which 1e-4 is too slow.
            learning_rate=1e-3,
            epochs=40,
            windows_per_epoch=4096,
            scheduler_patience=6,
            patience=6,
            validation_windows=1024,
        ),
        grid=GridParameters(
            epochs=4,
            windows_per_epoch=6144,
            horizon=1,
            gradient_penalty=0.0,
            evaluation_windows=500,
        ),
        causal=causal,
        narrow_causal=replace(causal, steps=3800),
        cem=CEMParameters(
            samples=128,
            elites=16,
            iterations=2,
            variance=tuple(0.2 * value for value in CEMParameters().variance),
            # Slow noise on what is left of the last plan: in a hundred dimensions a few hundred
            # samples find little, and it must not be found anew at every control step.
            noise_colour=1.0,
            carry=0.9,
            mean="feedforward",
            keep_best=True,
            include_mean=True,
            lower_rad=-1.5,
            upper_rad=1.5,
            terminal_weight=0.3,
            speed_weight=2.0,
            foot_weight=0.1,
        ),
        # Few samples close to the mean: the gradient does the work, and a plan that begins anew at
        # every control step strays less into what the model has never seen.
        gradient_cem=GradientCEMParameters(
            samples=8,
            elites=4,
            iterations=1,
            variance=tuple(0.02 * value for value in GradientCEMParameters().variance),
            gradient_iterations=6,
            learning_rate=0.3,
            anneal=True,
            mean="feedforward",
            lower_rad=-1.5,
            upper_rad=1.5,
            keep_best=True,
            include_mean=True,
            normalise_gradient=True,
            terminal_weight=0.3,
            speed_weight=2.0,
            foot_weight=0.1,
        ),
        dagger=dagger,
        narrow_dagger=replace(dagger, schedule=(1, 2), bursts=None, pad_starts=False),
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


__all__ = ["PRESETS", "Preset", "get_preset", "replace", "resolve", *parameters.__all__]
