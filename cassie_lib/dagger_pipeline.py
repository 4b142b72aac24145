"""Rounds of DAgger and the trials after them, each loaded or computed: pipeline.py, continued."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from cassie_lib import pipeline
from cassie_lib.artifacts.side_by_side import side_by_side
from cassie_lib.dagger import Round, Start, dagger_rounds
from cassie_lib.errors import ParameterError
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


class _Wanted(NamedTuple):
    """One of those trials: chain of rounds, what is special about it, round (0: before all)."""

    chain: str
    kind: str
    round: int


class DaggerRuns(NamedTuple):
    """What notebook 08 shows.

    Attributes:
        wide: All rounds of the schedule.
        narrow: Rounds from the model without wide data.
        decayed: The same with beta.
        trials: Before and after the rounds.
    """

    wide: list[Round]
    narrow: list[Round]
    decayed: list[Round]
    trials: RoundTrials


def dagger_runs(
    preset: Preset,
    *,
    narrow_rounds: int,
    decayed_rounds: int,
    decay: float,
    push_Ns: float,
    hard_push_Ns: float,
) -> DaggerRuns:
    """The rounds of notebook 08 and the trials after them, side by side where they are missing.

    Args:
        preset: The preset.
        narrow_rounds: Rounds from the model without wide data.
        decayed_rounds: Likewise with beta.
        decay: beta.
        push_Ns: Sideways push in N s.
        hard_push_Ns: A harder one.

    Raises:
        ParameterError: If more rounds are asked for than the preset's schedule has.
    """
    schedule = len(preset.dagger.schedule)
    for name, count in (("narrow_rounds", narrow_rounds), ("decayed_rounds", decayed_rounds)):
        if not 1 <= count <= schedule:
            raise ParameterError(f"{name} is {count}: expected 1 to {schedule}, of the schedule")
    chains: dict[str, dict[str, Any]] = {
        "wide": {"rounds": schedule},
        "narrow": {"rounds": narrow_rounds, "wide": False},
        "decayed": {"rounds": decayed_rounds, "wide": False, "decay": decay},
    }
    wanted = _wanted_trials(preset, chains, push_Ns, hard_push_Ns)
    calls: list[Callable[[], Any]] = [partial(dagger, preset, **made) for made in chains.values()]
    calls += [
        partial(_trial_after, preset, chains[item.chain], item.round, options)
        for item, options in wanted.items()
    ]
    # The rounds first: a trial whose round another process still trains waits for it.
    costs = [float("inf")] * len(chains)
    costs += [float(options["steps"]) for options in wanted.values()]
    wide, narrow, decayed, *tried = side_by_side(calls, costs)
    found = dict(zip(wanted, tried, strict=True))
    return DaggerRuns(wide, narrow, decayed, _by_chain(found, chains))


def _wanted_trials(
    preset: Preset, chains: dict[str, dict[str, Any]], push_Ns: float, hard_push_Ns: float
) -> dict[_Wanted, dict[str, Any]]:
    """Arguments of every trial."""
    sizes, last = preset.evaluation, chains["wide"]["rounds"]
    usual: dict[str, Any] = {"steps": sizes.planner_steps}
    longest: dict[str, Any] = {"steps": sizes.last_round_steps}
    hard: dict[str, Any] = {"push_Ns": hard_push_Ns, "steps": sizes.short_steps}
    wanted: dict[_Wanted, dict[str, Any]] = {
        _Wanted("wide", "padded", last): {"start": "padded", **longest},
        _Wanted("wide", "pushed", last): {"push_Ns": push_Ns, "steps": sizes.steps},
    }
    for index in range(last + 1):
        wanted[_Wanted("wide", "plain", index)] = longest if index == last else usual
        if index != 1:
            wanted[_Wanted("wide", "harder", index)] = hard
    # The model before the rounds is the same with beta and without.
    for name, first in (("narrow", 0), ("decayed", 1)):
        for index in range(first, chains[name]["rounds"] + 1):
            wanted[_Wanted(name, "plain", index)] = usual
    return wanted


def _trial_after(preset: Preset, chain: dict[str, Any], index: int, options: dict) -> Trial:
    """Trial with the model of a chain's round; with the one before the rounds for round 0."""
    after = dagger(preset, **{**chain, "rounds": index})[-1] if index else None
    wide = chain.get("wide", True)
    return planner_trial(preset, "gradient_cem", after=after, wide=wide, **options)


def _by_chain(found: dict[_Wanted, Trial], chains: dict[str, dict[str, Any]]) -> RoundTrials:
    def plain(name: str) -> list[Trial]:
        return [trial for item, trial in found.items() if item[:2] == (name, "plain")]

    last, narrow = chains["wide"]["rounds"], plain("narrow")
    return RoundTrials(
        plain("wide"), narrow, [narrow[0], *plain("decayed")],
        found[_Wanted("wide", "padded", last)],
        found[_Wanted("wide", "pushed", last)],
        {item.round: trial for item, trial in found.items() if item.kind == "harder"},
    )  # fmt: skip


__all__ = ["DaggerRuns", "RoundTrials", "dagger", "dagger_runs", "dagger_start"]
