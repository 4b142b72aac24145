"""Rounds of DAgger and the trials after them, each loaded or computed: pipeline.py, continued."""

from __future__ import annotations

from collections.abc import Sequence

from cassie_lib import pipeline
from cassie_lib.dagger import Round, Start, dagger_rounds
from cassie_lib.planner_pipeline import Trial, causal_model, planner_trial
from cassie_lib.presets import Preset, replace


def dagger_start(preset: Preset, *, wide: bool = True) -> Start:
    """Round 0 of Algorithm 3: the causal model and what it was trained on.

    Args:
        preset: The preset.
        wide: False: as in the thesis, a model that has seen the expert's walk alone.
    """
    names = ("train", "wide") if wide else ("train",)
    return Start(
        expert=pipeline.expert(preset),
        model=causal_model(preset, wide=wide),
        load_train=lambda: tuple(pipeline.transitions(preset, name) for name in names),
        load_test=lambda: pipeline.transitions(preset, "test"),
        artifacts=(
            pipeline.expert_artifact(preset),
            pipeline.causal_artifact(preset, wide=wide),
            *(pipeline.pending_dataset(preset, name) for name in (*names, "test")),
        ),
    )


def dagger(
    preset: Preset,
    *,
    rounds: int | None = None,
    decay: float | None = None,
    wide: bool = True,
    kept: bool = True,
) -> list[Round]:
    """The rounds of Algorithm 3 with Gradient-CEM.

    Args:
        preset: The preset.
        rounds: Only so many of the schedule's rounds.
        decay: beta of section 6.2; default the preset's.
        wide: See :func:`dagger_start`.
        kept: Whether git keeps the rounds of ``laptop``.
    """
    parameters = preset.dagger if decay is None else replace(preset.dagger, decay=decay)
    return dagger_rounds(
        dagger_start(preset, wide=wide), parameters, preset.gradient_cem, preset.simulation,
        preset=preset.name if kept else pipeline.not_kept(preset), rounds=rounds,
    )  # fmt: skip


def round_trials(preset: Preset, rounds: Sequence[Round]) -> list[Trial]:
    """Gradient-CEM before the first round and after each: round 0 first, the last one longest."""
    found = [planner_trial(preset, "gradient_cem")]
    for item in rounds:
        last = item.index == len(preset.dagger.schedule)
        steps = preset.evaluation.last_round_steps if last else None
        found.append(planner_trial(preset, "gradient_cem", after=item, steps=steps))
    return found


def narrow_round_trials(
    preset: Preset, rounds: Sequence[Round], *, kept: bool = True
) -> list[Trial]:
    """Gradient-CEM on the model that has seen the expert's walk alone, and after its rounds.

    All trials have the same length: their planner-only steps compare seed by seed.

    Args:
        preset: The preset.
        rounds: Of :func:`dagger` without wide data.
        kept: Whether git keeps the trials after the rounds.
    """
    before = planner_trial(preset, "gradient_cem", wide=False)
    return [before, *(planner_trial(preset, "gradient_cem", after=r, kept=kept) for r in rounds)]


__all__ = ["dagger", "dagger_start", "narrow_round_trials", "round_trials"]
