"""The data sets, each loaded or collected: pipeline.py, second part."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np

from cassie_lib.artifacts import Artifact, Pending, load_or_compute
from cassie_lib.controllers import Controller
from cassie_lib.data import Bursts, Episodes, collect, collect_noise_study, open_dataset
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.errors import unknown_name
from cassie_lib.expert.policy import load_expert
from cassie_lib.expert_pipeline import expert_artifact
from cassie_lib.presets import (
    CollectionParameters,
    DataParameters,
    Preset,
    WideCollectionParameters,
)

#: Names of the data sets of a preset.
DATASETS = tuple(
    item.name for item in fields(DataParameters) if isinstance(item.default, CollectionParameters)
)


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


__all__ = [
    "DATASETS",
    "as_transitions",
    "baseline_sets",
    "dataset",
    "dataset_artifact",
    "held_out_artifacts",
    "held_out_sets",
    "noise_study_artifact",
    "pending_dataset",
    "transitions",
]
