"""The rounds of Algorithm 3: collect with the planner in the loop, retrain, report."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from cassie_lib.artifacts import WORK, Artifact, Upstream, load_or_compute
from cassie_lib.dagger.disturbed import make_driver
from cassie_lib.dagger.recordings import (
    check_shares,
    load_transitions,
    pad_starts,
    save_transitions,
    split_by_episode,
    to_transitions,
    window_shares,
)
from cassie_lib.data import collect
from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.dynamics.evaluation import open_loop
from cassie_lib.dynamics.store import load_causal, save_model
from cassie_lib.dynamics.train_causal import train_causal
from cassie_lib.dynamics.windows import Transitions, concatenate
from cassie_lib.errors import ArtifactError, ParameterError
from cassie_lib.expert.policy import Expert
from cassie_lib.files import UNREADABLE, write_json
from cassie_lib.planning.assemble import make_planner
from cassie_lib.presets import (
    CEMParameters,
    CollectionParameters,
    DAggerParameters,
    SimulationParameters,
    replace,
)
from cassie_lib.threads import one_torch_thread

MODEL, TRANSITIONS, REPORT = "model", "transitions.npz", "report.json"
#: Holds wall times, so it is no part of the content that later rounds depend on.
LOG = "timing_log.csv"


@dataclass(frozen=True)
class Start:
    """Round 0: what the first model was made of.

    Attributes:
        expert: pi*.
        model: The initial dynamics model f.
        load_train: Gives the recordings that it was trained on; they stay in the data as the
            oldest round.  Not asked for when all rounds are stored.
        load_test: Gives a recording of the expert that it has not seen, for the error on expert
            states.
        artifacts: Where these come from; they decide every round.
    """

    expert: Expert
    model: CausalModel
    load_train: Callable[[], tuple[Transitions, ...]]
    load_test: Callable[[], Transitions]
    artifacts: tuple[Upstream, ...] = ()

    @cached_property
    def train(self) -> tuple[Transitions, ...]:
        """Recordings that the model was trained on."""
        return self.load_train()

    @cached_property
    def test(self) -> Transitions:
        """Recording of the expert that the model has not seen."""
        return self.load_test()


@dataclass(frozen=True)
class Round:
    """One finished round.

    Attributes:
        index: 1 for the first.
        planner_steps: n.
        model: The retrained model.
        train, validation, test: This round's transitions, split by episode.
        report: Counts, and relative errors by predicted step before and after retraining.
        artifact: Where all of it is stored.
    """

    index: int
    planner_steps: int
    model: CausalModel
    train: Transitions
    validation: Transitions
    test: Transitions
    report: dict[str, Any]
    artifact: Artifact


def dagger_rounds(
    start: Start,
    parameters: DAggerParameters,
    planner: CEMParameters,
    simulation: SimulationParameters,
    *,
    preset: str = "",
    rounds: int | None = None,
) -> list[Round]:
    """Run Algorithm 3, or load what has been run.

    Args:
        start: Round 0.
        parameters: n of each round, M, beta and the budget of a retraining.
        planner: A preset's ``cem`` or ``gradient_cem``: the controller rho.
        simulation: Physics step and commanded speed.
        preset: For the record; results of ``laptop`` are kept in ``data/``.
        rounds: Run only so many of the schedule's rounds.

    Returns:
        The rounds, oldest first.

    Raises:
        ParameterError: If a parameter is out of range or the model cannot be retrained.
    """
    _check(start, parameters)
    found: list[Round] = []
    for index, planner_steps in enumerate(parameters.schedule[:rounds], start=1):
        found.append(
            _round(index, planner_steps, start, found, parameters, planner, simulation, preset)
        )
    return found


def _check(start: Start, parameters: DAggerParameters) -> None:
    if not isinstance(start.model, CausalModel):
        raise ParameterError(
            f"model is a {type(start.model).__name__}: expected a CausalModel, which can be "
            "trained on"
        )
    check_shares(parameters.decay, parameters.rounds_share)
    if not parameters.schedule:
        raise ParameterError("schedule is empty: expected n of at least one round")
    for steps in parameters.schedule:
        if not 1 <= steps <= parameters.cycle_steps:
            raise ParameterError(
                f"schedule holds n = {steps}: expected 1 to phi = {parameters.cycle_steps}"
            )


def _round(index, planner_steps, start, before, parameters, planner, simulation, preset) -> Round:
    settings = asdict(parameters)
    # A longer schedule must not make the rounds that have been run already unknown.
    del settings["schedule"]
    recipe = {
        "round": index,
        "planner_steps": planner_steps,
        "dagger": settings,
        "planner": {"kind": type(planner).__name__, **asdict(planner)},
        "simulation": simulation,
    }

    def compute(folder: Path) -> None:
        model = before[-1].model if before else start.model
        driver = make_driver(
            make_planner(model, planner, expert=start.expert, speed_mps=simulation.speed_mps),
            start.expert, planner_steps, parameters,
        )  # fmt: skip
        with one_torch_thread():
            counts = _collect(folder, index, driver, parameters, simulation)
            _retrain(folder, index, model, start, before, parameters, counts)

    artifact = load_or_compute(
        "dagger", recipe, compute, (*start.artifacts, *(item.artifact for item in before)),
        preset=preset, seed=parameters.seed, kept=True,
    )  # fmt: skip
    return _open(artifact, index, planner_steps, parameters)


def _collect(folder, index, driver, parameters, simulation) -> dict[str, Any]:
    """Lines 5-12 of Algorithm 3: M transitions from many robots in one batch; their counts."""
    collection = CollectionParameters(
        name=f"dagger round {index}, n = {driver.planner_steps}",
        transitions=parameters.transitions,
        noise_std_rad=0.0,
        seed=1000 * (parameters.seed + 1) + index,
        episode_steps=parameters.episode_steps,
        robots=parameters.robots,
    )
    # What nobody learns from (forces, heights, means of actions) stays behind.
    recorded = collect(driver, collection, simulation, folder / WORK / "data")
    save_transitions(folder / TRANSITIONS, to_transitions(recorded))
    return recorded.card["counts"]


def _retrain(
    folder: Path, index, model, start: Start, before: list[Round], parameters, counts
) -> None:
    """Lines 13-14: put the data together and go on training the last model."""
    settings = replace(
        model.parameters_,
        steps=parameters.training_steps,
        learning_rate=parameters.learning_rate,
        rollout_share=parameters.rollout_share,
        max_minutes=parameters.minutes_per_round,
        seed=parameters.seed + index,
    )
    train, validation, test = _split(folder, index, parameters)
    # The oldest first; what the first model was trained on has age `index`.
    rounds = [*(item.train for item in before), train]
    ages = [index] * len(start.train) + list(range(index - 1, -1, -1))
    if parameters.pad_starts:
        rounds = [pad_starts(source, settings.context) for source in rounds]
    sources = [*start.train, *rounds]
    length = settings.context + settings.horizon
    result = train_causal(
        sources,
        settings,
        validation=concatenate([*(item.validation for item in before), validation]),
        shares=window_shares(
            sources, ages, parameters.decay, length,
            first=len(start.train), rounds_share=parameters.rounds_share,
        ),
        initial=model,
        folder=folder / WORK / "training",
    )
    report = _report(index, model, result.model, start.test, test, settings.horizon)
    report["counts"] = counts
    report["optimiser_steps"], report["skipped_steps"] = result.steps, result.skipped
    save_model(folder / MODEL, result.model, notes=report)
    write_json(folder / REPORT, report)
    shutil.copyfile(folder / WORK / "training" / "log.csv", folder / LOG)


def _split(folder: Path, index: int, parameters) -> tuple[Transitions, Transitions, Transitions]:
    recorded = load_transitions(folder / TRANSITIONS)
    train, validation, test = split_by_episode(recorded, parameters.split, parameters.seed + index)
    return train, validation, test


def _report(index, old, new, expert_test, planner_test, horizon) -> dict[str, Any]:
    """Relative errors by predicted step on both kinds of states."""
    errors = {
        states: {
            when: open_loop(model, recording, horizon).relative.tolist()
            for when, model in (("before", old), ("after", new))
        }
        for states, recording in (("expert", expert_test), ("round", planner_test))
    }
    return {"round": index, "relative_error": errors}


def _open(artifact: Artifact, index: int, planner_steps: int, parameters) -> Round:
    report = _read_report(artifact.file(REPORT))
    parts = _split(artifact.path, index, parameters)
    model = load_causal(artifact.path / MODEL)
    return Round(index, planner_steps, model, *parts, report, artifact)


def _read_report(path: Path) -> dict[str, Any]:
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        lacking = {"counts", "relative_error"} - set(report)
    except UNREADABLE:
        lacking = {"everything"}
    if lacking:
        raise ArtifactError(
            f"{path.parent.name}/{path.name} lacks {', '.join(sorted(lacking))}: expected the "
            "report of a round"
        )
    return report
