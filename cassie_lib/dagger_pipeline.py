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
    wide: bool = True,
    **changes,
) -> list[Round]:
    """The rounds of Algorithm 3 with Gradient-CEM.

    Args:
        preset: The preset.
        rounds: Only so many of the schedule's rounds.
        wide: False: from the model that has seen the expert's walk alone, with the preset's
            ``narrow_dagger``.
        changes: Fields of that section that differ from the preset's, e.g. ``decay``.

    Raises:
        ParameterError: If the schedule has not so many rounds.
    """
    parameters = replace(preset.dagger if wide else preset.narrow_dagger, **changes)
    most = len(parameters.schedule)
    if rounds is not None and not 1 <= rounds <= most:
        raise ParameterError(f"rounds is {rounds}: expected 1 to {most}, of the schedule")
    return dagger_rounds(
        dagger_start(preset, wide=wide), parameters, preset.gradient_cem, preset.simulation,
        preset=preset.name, rounds=rounds,
    )  # fmt: skip


class RoundTrials(NamedTuple):
    """Gradient-CEM's episodes before and after the rounds.

    Attributes:
        wide: Round 0 first; not the last one, whose trial is the padded one.
        narrow, decayed: From the model that has seen the expert's walk alone; all rounds.
        control: After its retraining. All up to here are of one length, so that their planner-only
            steps compare seed by seed.
        narrow_zero, control_zero: With plans that begin at the thesis's zero mean, where the robot
            soon falls: shorter and more of them. Before all of the narrow rounds and after them.
        padded: After the last wide round, begun without any expert: the longest.
        pushed: After the last wide round, under the push.
    """

    wide: list[Trial]
    narrow: list[Trial]
    decayed: list[Trial]
    control: Trial
    narrow_zero: list[Trial]
    control_zero: Trial
    padded: Trial
    pushed: Trial


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
        control: One retraining as long as all of the narrow ones together, on what the first model
            was trained on alone.
        trials: Before and after the rounds.
    """

    wide: list[Round]
    narrow: list[Round]
    decayed: list[Round]
    control: list[Round]
    trials: RoundTrials


def dagger_runs(
    preset: Preset,
    *,
    narrow_rounds: int,
    decayed_rounds: int,
    decay: float,
    push_Ns: float,
) -> DaggerRuns:
    """The rounds of notebook 08 and the trials after them, side by side where they are missing.

    Args:
        preset: The preset.
        narrow_rounds: Rounds from the model without wide data.
        decayed_rounds: Likewise with beta.
        decay: beta.
        push_Ns: Sideways push in N s.

    Raises:
        ParameterError: If more rounds are asked for than the preset's schedule has.
    """
    schedule = len(preset.narrow_dagger.schedule)
    for name, count in (("narrow_rounds", narrow_rounds), ("decayed_rounds", decayed_rounds)):
        if not 1 <= count <= schedule:
            raise ParameterError(f"{name} is {count}: expected 1 to {schedule}, of the schedule")
    chains: dict[str, dict[str, Any]] = {
        "wide": {"rounds": len(preset.dagger.schedule)},
        "narrow": {"rounds": narrow_rounds, "wide": False},
        "decayed": {"rounds": decayed_rounds, "wide": False, "decay": decay},
        "control": {
            "rounds": 1, "wide": False, "rounds_share": 0.0,
            "training_steps": narrow_rounds * preset.narrow_dagger.training_steps,
        },
    }  # fmt: skip
    wanted = _wanted_trials(preset, chains, push_Ns)
    calls: list[Callable[[], Any]] = [partial(dagger, preset, **made) for made in chains.values()]
    calls += [
        partial(_trial_after, preset, chains[item.chain], item.round, options)
        for item, options in wanted.items()
    ]
    # The rounds first: a trial whose round another process still trains waits for it.
    costs = [float("inf")] * len(chains)
    costs += [float(options["steps"]) for options in wanted.values()]
    results = side_by_side(calls, costs)
    made, tried = results[: len(chains)], results[len(chains) :]
    found = dict(zip(wanted, tried, strict=True))
    return DaggerRuns(**dict(zip(chains, made, strict=True)), trials=_by_chain(found, chains))


def _wanted_trials(
    preset: Preset, chains: dict[str, dict[str, Any]], push_Ns: float
) -> dict[_Wanted, dict[str, Any]]:
    """Arguments of every trial."""
    sizes, last = preset.evaluation, chains["wide"]["rounds"]
    wanted: dict[_Wanted, dict[str, Any]] = {
        _Wanted("wide", "padded", last): {"start": "padded", "steps": sizes.last_round_steps},
        _Wanted("wide", "pushed", last): {"push_Ns": push_Ns, "steps": sizes.steps},
    }
    zero = {
        "steps": sizes.ablation_steps, "episodes": sizes.zero_seeds, "changes": {"mean": "zero"}
    }  # fmt: skip
    for name, chain in chains.items():
        # The model before the rounds is the same for all that begin without wide data.
        first, end = int(name in ("decayed", "control")), chain["rounds"] + (name != "wide")
        for index in range(first, end):
            wanted[_Wanted(name, "plain", index)] = {"steps": sizes.planner_steps}
    for name, index in (("narrow", 0), ("narrow", chains["narrow"]["rounds"]), ("control", 1)):
        wanted[_Wanted(name, "zero mean", index)] = zero
    return wanted


def _trial_after(preset: Preset, chain: dict[str, Any], index: int, options: dict) -> Trial:
    """Trial with the model of a chain's round; with the one before the rounds for round 0."""
    after = dagger(preset, **{**chain, "rounds": index})[-1] if index else None
    wide = chain.get("wide", True)
    return planner_trial(preset, "gradient_cem", after=after, wide=wide, **options)


def _by_chain(found: dict[_Wanted, Trial], chains: dict[str, dict[str, Any]]) -> RoundTrials:
    def rounds(name: str, kind: str = "plain") -> list[Trial]:
        return [trial for item, trial in found.items() if item[:2] == (name, kind)]

    last, narrow = chains["wide"]["rounds"], rounds("narrow")
    return RoundTrials(
        rounds("wide"), narrow, [narrow[0], *rounds("decayed")],
        control=found[_Wanted("control", "plain", 1)],
        narrow_zero=rounds("narrow", "zero mean"),
        control_zero=found[_Wanted("control", "zero mean", 1)],
        padded=found[_Wanted("wide", "padded", last)],
        pushed=found[_Wanted("wide", "pushed", last)],
    )  # fmt: skip


__all__ = ["DaggerRuns", "RoundTrials", "dagger", "dagger_runs", "dagger_start"]
