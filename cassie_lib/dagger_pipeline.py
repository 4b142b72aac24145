"""Rounds of DAgger and the trials after them, each loaded or computed: pipeline.py, continued."""

from __future__ import annotations

from collections.abc import Sequence

from cassie_lib import pipeline
from cassie_lib.dagger import Round, Start, dagger_rounds
from cassie_lib.planner_pipeline import Trial, causal_model, planner_trial
from cassie_lib.presets import Preset, replace


def dagger_start(preset: Preset) -> Start:
    """Round 0 of Algorithm 3: the causal model and what it was trained on."""
    names = ("train", "wide")
    return Start(
        expert=pipeline.expert(preset),
        model=causal_model(preset),
        load_train=lambda: tuple(pipeline.transitions(preset, name) for name in names),
        load_test=lambda: pipeline.transitions(preset, "test"),
        artifacts=(
            pipeline.expert_artifact(preset),
            pipeline.causal_artifact(preset),
            *(pipeline.pending_dataset(preset, name) for name in (*names, "test")),
        ),
    )


def dagger(preset: Preset, *, rounds: int | None = None, decay: float | None = None) -> list[Round]:
    """The rounds of Algorithm 3 with Gradient-CEM.

    Args:
        preset: The preset.
        rounds: Only so many of the schedule's rounds.
        decay: beta of section 6.2; default the preset's.
    """
    parameters = preset.dagger if decay is None else replace(preset.dagger, decay=decay)
    return dagger_rounds(
        dagger_start(preset), parameters, preset.gradient_cem, preset.simulation,
        preset=preset.name, rounds=rounds,
    )  # fmt: skip


def round_trials(preset: Preset, rounds: Sequence[Round]) -> list[Trial]:
    """Gradient-CEM before the first round and after each: round 0 first, the last one longest."""
    found = [planner_trial(preset, "gradient_cem")]
    for item in rounds:
        last = item.index == len(preset.dagger.schedule)
        steps = preset.evaluation.last_round_steps if last else None
        found.append(planner_trial(preset, "gradient_cem", after=item, steps=steps))
    return found


def bare_round_trials(preset: Preset, rounds: Sequence[Round]) -> list[Trial]:
    """As :func:`round_trials`, shorter, with plans that begin at the bare joint angles.

    Without the feed-forward the planner depends more on its model and falls before any round, so
    that there is something to gain.
    """
    steps, changes = preset.evaluation.ablation_steps, {"mean": "reference"}
    return [
        planner_trial(preset, "gradient_cem", after=item, steps=steps, changes=changes)
        for item in (None, *rounds)
    ]


__all__ = ["bare_round_trials", "dagger", "dagger_start", "round_trials"]
