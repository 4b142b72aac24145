"""Rounds of DAgger and the trials after them, each loaded or computed: pipeline.py, continued."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

from cassie_lib import pipeline
from cassie_lib.artifacts.side_by_side import side_by_side
from cassie_lib.dagger import Round, Start, dagger_rounds
from cassie_lib.planner_pipeline import Trial, causal_model, planner_trials
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
) -> list[Round]:
    """The rounds of Algorithm 3 with Gradient-CEM.

    Args:
        preset: The preset.
        rounds: Only so many of the schedule's rounds.
        decay: beta of section 6.2; default the preset's.
        wide: See :func:`dagger_start`.
    """
    parameters = preset.dagger if decay is None else replace(preset.dagger, decay=decay)
    return dagger_rounds(
        dagger_start(preset, wide=wide), parameters, preset.gradient_cem, preset.simulation,
        preset=preset.name, rounds=rounds,
    )  # fmt: skip


def dagger_runs(
    preset: Preset, narrow_rounds: int, decayed_rounds: int, decay: float
) -> list[list[Round]]:
    """The rounds of notebook 08, side by side where they are missing.

    Args:
        preset: The preset.
        narrow_rounds: Rounds from the model without wide data.
        decayed_rounds: Likewise with beta.
        decay: beta.

    Returns:
        The rounds of the schedule, those from the narrow model, those with beta.
    """
    calls = [
        partial(dagger, preset),
        partial(dagger, preset, rounds=narrow_rounds, wide=False),
        partial(dagger, preset, rounds=decayed_rounds, decay=decay, wide=False),
    ]
    return side_by_side(calls, (len(preset.dagger.schedule), narrow_rounds, decayed_rounds))


class RoundTrials(NamedTuple):
    """Gradient-CEM's episodes before and after the rounds.

    Attributes:
        wide: Round 0 first; the last one is the longest.
        narrow, decayed: The same from the model that has seen the expert's walk alone; all of one
            length, so that their planner-only steps compare seed by seed.
        padded: After the last round, begun without any expert.
        pushed: After the last round, under the push.
        harder: Under the hard push, by round; not after the first.
    """

    wide: list[Trial]
    narrow: list[Trial]
    decayed: list[Trial]
    padded: Trial
    pushed: Trial
    harder: dict[int, Trial]


def round_trials(
    preset: Preset,
    rounds: Sequence[Round],
    narrow: Sequence[Round],
    decayed: Sequence[Round],
    *,
    push_Ns: float,
    hard_push_Ns: float,
) -> RoundTrials:
    """All trials of notebook 08, side by side where they are missing.

    Args:
        preset: The preset.
        rounds: Of :func:`dagger`.
        narrow: Of :func:`dagger` without wide data.
        decayed: Likewise, with beta.
        push_Ns: Sideways push in N s.
        hard_push_Ns: One that the planner hardly survives.
    """
    sizes, last = preset.evaluation, rounds[-1]
    complete = last.index == len(preset.dagger.schedule)
    longest = {"steps": sizes.last_round_steps}
    hard = {"push_Ns": hard_push_Ns, "steps": sizes.short_steps}
    wanted: dict[str, dict[str, Any]] = {
        "padded": {"after": last, "start": "padded", **longest},
        "pushed": {"after": last, "push_Ns": push_Ns, "steps": sizes.steps},
        "wide 0": {},
        "narrow 0": {"wide": False},
        "harder 0": hard,
    }
    for item in rounds:
        whole = longest if item is last and complete else {}
        wanted[f"wide {item.index}"] = {"after": item, **whole}
        if item.index > 1:
            wanted[f"harder {item.index}"] = {"after": item, **hard}
    wanted |= {f"narrow {item.index}": {"after": item} for item in narrow}
    wanted |= {f"decayed {item.index}": {"after": item} for item in decayed}
    found = planner_trials(preset, "gradient_cem", wanted)

    def in_order(name: str, count: int) -> list[Trial]:
        return [found[f"{name} {index}"] for index in range(1, count + 1)]

    before = found["narrow 0"]
    return RoundTrials(
        [found["wide 0"], *in_order("wide", len(rounds))],
        [before, *in_order("narrow", len(narrow))],
        [before, *in_order("decayed", len(decayed))],
        found["padded"],
        found["pushed"],
        {int(k.split()[1]): trial for k, trial in found.items() if k.startswith("harder")},
    )


__all__ = ["RoundTrials", "dagger", "dagger_runs", "dagger_start", "round_trials"]
