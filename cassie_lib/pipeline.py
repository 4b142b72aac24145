"""Upstream results of a notebook, each loaded or computed: no notebook needs another to run first.

Every function takes a preset and returns the artifact of one stage (``..._artifact``) or what is
in it.  What a stage itself needs it asks for in the same way.
"""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np

from cassie_lib.artifacts import WORK, Artifact, Pending, load_or_compute
from cassie_lib.controllers import Controller
from cassie_lib.data import Bursts, Episodes, collect, collect_noise_study, open_dataset
from cassie_lib.dynamics.store import save_model
from cassie_lib.dynamics.training import Training, train_causal, train_mlp, train_transformer
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.errors import unknown_name
from cassie_lib.expert.policy import Expert, load_expert, save_expert
from cassie_lib.expert.ppo import RecurrentPPO
from cassie_lib.files import plain, write_json
from cassie_lib.presets import (
    CollectionParameters,
    DataParameters,
    ExpertParameters,
    Preset,
    WideCollectionParameters,
    replace,
)

#: Names of the data sets of a preset.
DATASETS = tuple(
    item.name for item in fields(DataParameters) if isinstance(item.default, CollectionParameters)
)

#: Training curves of a model: epoch, step, seconds, metric, value.
TRAINING_LOG = "timing_log.csv"


def first_expert_artifact(preset: Preset) -> Artifact:
    """The expert after its first training; :func:`expert_artifact` goes on from it."""
    return _trained_policy(preset, preset.expert)


def expert_artifact(preset: Preset) -> Artifact:
    """The expert pi* of section 4.3.1: weights, card and ``timing_log.csv``."""
    return _trained_policy(preset, preset.expert_continuation, first_expert_artifact(preset))


def reward_only_artifact(preset: Preset) -> Artifact:
    """A policy trained on Eq 3.10 alone at 0.0509 m/s, which learns to stand still."""
    return _trained_policy(preset, preset.reward_only_expert)


def _trained_policy(
    preset: Preset, parameters: ExpertParameters, first: Artifact | None = None
) -> Artifact:
    timestep_s = preset.simulation.training_timestep_s

    def compute(folder: Path) -> None:
        work = folder / WORK
        work.mkdir(parents=True, exist_ok=True)
        run = RecurrentPPO(parameters, timestep_s)
        if first is not None:
            run.policy.load_state_dict(load_expert(first.path).policy.state_dict())
        policy = run.train(work)
        # Wall times stay out of the card: they would make equal weights look different.
        card = {"parameters": plain(parameters), "timestep_s": timestep_s, "steps": run.steps}
        if first is not None:
            card["continues"] = first.name
        save_expert(policy, folder, card)
        shutil.copyfile(work / "log.csv", folder / "timing_log.csv")
        write_json(folder / "timing.json", {"training_s": run.seconds})

    return load_or_compute(
        "expert", {"expert": parameters, "timestep_s": timestep_s}, compute,
        [first] if first else [], preset=preset.name, seed=parameters.seed, kept=True,
    )  # fmt: skip


def expert(preset: Preset) -> Expert:
    """The expert as a controller."""
    return load_expert(expert_artifact(preset).path)


def _physics(preset: Preset) -> dict[str, float]:
    return {
        "timestep_s": preset.simulation.timestep_s,
        "speed_mps": preset.simulation.speed_mps,
    }


def dataset_artifact(preset: Preset, name: str) -> Artifact:
    """A data set of section 4.3, collected with the expert; see :func:`pending_dataset`."""
    return pending_dataset(preset, name).get()


def pending_dataset(preset: Preset, name: str) -> Pending:
    """A data set that is collected only when it is needed.

    Args:
        preset: The preset.
        name: One of :data:`DATASETS`.

    Raises:
        UnknownNameError: If the preset has no such data set.
    """
    if name not in DATASETS:
        raise unknown_name("data set", name, DATASETS)
    parameters: CollectionParameters = getattr(preset.data, name)
    upstream = expert_artifact(preset)

    def compute(folder: Path) -> None:
        controller: Controller = load_expert(upstream.path)
        if isinstance(parameters, WideCollectionParameters):
            controller = Bursts(controller, parameters.bursts)
        collect(controller, parameters, preset.simulation, folder)

    return Pending(
        "data", {"collection": parameters, **_physics(preset)}, compute, [upstream],
        preset=preset.name, seed=parameters.seed,
    )  # fmt: skip


def dataset(preset: Preset, name: str) -> Episodes:
    """A data set, mapped into memory; arguments and errors as :func:`dataset_artifact`."""
    return open_dataset(dataset_artifact(preset, name).path)


def transitions(preset: Preset, name: str) -> Transitions:
    """A data set as the models train on it; arguments and errors as :func:`dataset_artifact`."""
    return as_transitions(dataset(preset, name))


def as_transitions(episodes: Episodes) -> Transitions:
    """The same arrays under the models' interface, not copied."""
    return Transitions(episodes.states, episodes.actions, episodes.phase, episodes.episode_starts)


def noise_study_artifact(preset: Preset) -> Artifact:
    """Whole episodes at noise levels from 0 to 0.25 rad."""
    parameters, upstream = preset.data.noise_study, expert_artifact(preset)

    def compute(folder: Path) -> None:
        collect_noise_study(load_expert(upstream.path), parameters, preset.simulation, folder)

    return load_or_compute(
        "data", {"noise_study": parameters, **_physics(preset)}, compute, [upstream],
        preset=preset.name, seed=parameters.seed,
    )  # fmt: skip


def baseline_sets(preset: Preset) -> tuple[Transitions, Transitions, Transitions]:
    """Training, validation and test set of section 5.1.1.

    The first 70 % of the collection train, the last 30 % validate; the test set was collected at
    another noise level.
    """
    train, validation = dataset(preset, "baseline").split(0.7, 0.3)
    test = dataset(preset, "baseline_test")
    return as_transitions(train), as_transitions(validation), as_transitions(test)


def mlp_artifact(preset: Preset, *, curriculum: bool = False, seed: int | None = None) -> Artifact:
    """The fully connected baseline of section 5.1.1: weights, card and ``timing_log.csv``.

    Args:
        preset: The preset.
        curriculum: False for Figure 5.1, True for Figure 5.2.
        seed: Of the weights and the order of the batches; default the preset's.
    """
    parameters = preset.mlp if seed is None else replace(preset.mlp, seed=seed)
    upstream = [pending_dataset(preset, name) for name in ("baseline", "baseline_test")]

    def compute(folder: Path) -> None:
        train, validation, test = baseline_sets(preset)
        work = _work(folder)
        trained = train_mlp(
            train, parameters, validation=validation, test=test, curriculum=curriculum, folder=work
        )
        _store(folder, trained)

    return load_or_compute(
        "mlp", {"mlp": parameters, "curriculum": curriculum}, compute, upstream, preset=preset.name,
        seed=parameters.seed, kept=True,
    )  # fmt: skip


def held_out_artifacts(preset: Preset) -> tuple[Artifact, Artifact, Artifact, Artifact]:
    """Test, validation, noise study and wide test: what :func:`held_out_sets` reads."""
    test, validation, wide = (
        dataset_artifact(preset, name) for name in ("test", "validation", "wide_test")
    )
    return test, validation, noise_study_artifact(preset), wide


def held_out_sets(preset: Preset) -> dict[str, Transitions]:
    """Recordings that no model has trained on, by action noise sigma in rad, least first.

    sigma of the training set comes from the noise study, which has other seeds; the largest is
    ``wide_test``, a noise that no model trains on.
    """
    test, validation, study, wide = (open_dataset(a.path) for a in held_out_artifacts(preset))
    level = preset.data.train.noise_std_rad
    own = np.flatnonzero(np.isclose(study.noise_std_rad, level))
    ends = np.append(study.episode_starts[1:], len(study))
    # The episodes of one level lie side by side.
    middle = study.part(int(study.episode_starts[own[0]]), int(ends[own[-1]]))
    found = {
        preset.data.test.noise_std_rad: test,
        preset.data.validation.noise_std_rad: validation,
        level: middle,
        preset.data.wide_test.noise_std_rad: wide,
    }
    return {f"σ = {sigma:g}": as_transitions(episodes) for sigma, episodes in found.items()}


def transformer_artifact(preset: Preset) -> Artifact:
    """The thesis's transformer of section 5.1.2: weights, card and ``timing_log.csv``."""
    names = ("train", "validation", "test")

    def compute(folder: Path) -> None:
        train, validation, test = (transitions(preset, name) for name in names)
        work = _work(folder)
        trained = train_transformer(
            train, preset.transformer, validation=validation, test=test, folder=work
        )
        _store(folder, trained)

    return load_or_compute(
        "transformer", preset.transformer, compute,
        [pending_dataset(preset, name) for name in names], preset=preset.name, kept=True,
    )  # fmt: skip


def causal_artifact(preset: Preset) -> Artifact:
    """The causal model, trained on the thesis's training set and on the wide one."""
    names = ("train", "wide", "validation")

    def compute(folder: Path) -> None:
        train, wide, validation = (transitions(preset, name) for name in names)
        work = _work(folder)
        # Measured only, for the curves of notebook 05: the weights do not depend on them.
        measured = {"train": train, "test": transitions(preset, "test")}
        trained = train_causal(
            [train, wide], preset.causal, validation=validation, measured=measured, folder=work
        )
        _store(folder, trained)

    return load_or_compute(
        "causal", preset.causal, compute,
        [pending_dataset(preset, name) for name in names], preset=preset.name, kept=True,
    )  # fmt: skip


def _work(folder: Path) -> Path:
    (folder / WORK).mkdir(parents=True, exist_ok=True)
    return folder / WORK


def _store(folder: Path, trained: Training) -> None:
    """Weights and card count as content; the log holds wall times and does not."""
    save_model(folder, trained.model, {"steps": trained.steps, "skipped": trained.skipped})
    trained.log.path = folder / TRAINING_LOG
    trained.log.flush()


__all__ = [
    "TRAINING_LOG",
    "DATASETS",
    "as_transitions",
    "baseline_sets",
    "causal_artifact",
    "dataset",
    "dataset_artifact",
    "expert",
    "expert_artifact",
    "held_out_artifacts",
    "held_out_sets",
    "mlp_artifact",
    "noise_study_artifact",
    "pending_dataset",
    "reward_only_artifact",
    "transformer_artifact",
    "transitions",
]
