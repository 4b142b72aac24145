"""Upstream results of a notebook, each loaded or computed: no notebook needs another to run first.

Every function takes a preset and returns the artifact of one stage (``..._artifact``) or what is
in it.  What a stage itself needs it asks for in the same way.
"""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path

from cassie_lib.artifacts import WORK, Artifact, load_or_compute
from cassie_lib.data import Episodes, collect, collect_noise_study, open_dataset
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.errors import unknown_name
from cassie_lib.expert.policy import Expert, load_expert, save_expert
from cassie_lib.expert.ppo import RecurrentPPO
from cassie_lib.files import plain, write_json
from cassie_lib.presets import CollectionParameters, DataParameters, Preset

#: Names of the data sets of a preset.
DATASETS = tuple(
    item.name for item in fields(DataParameters) if isinstance(item.default, CollectionParameters)
)


def expert_artifact(preset: Preset) -> Artifact:
    """The expert pi* of section 4.3.1: weights, card and ``timing_log.csv``."""
    timestep_s = preset.simulation.training_timestep_s

    def compute(folder: Path) -> None:
        work = folder / WORK
        work.mkdir(parents=True, exist_ok=True)
        run = RecurrentPPO(preset.expert, timestep_s)
        policy = run.train(work)
        # Wall times stay out of the card: they would make equal weights look different.
        card = {"parameters": plain(preset.expert), "timestep_s": timestep_s, "steps": run.steps}
        save_expert(policy, folder, card)
        shutil.copyfile(work / "log.csv", folder / "timing_log.csv")
        write_json(folder / "timing.json", {"training_s": run.seconds})

    return load_or_compute(
        "expert", {"expert": preset.expert, "timestep_s": timestep_s}, compute,
        preset=preset.name, seed=preset.expert.seed, kept=True,
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
    """A data set of section 4.3, collected with the expert.

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
        collect(load_expert(upstream.path), parameters, preset.simulation, folder)

    return load_or_compute(
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
    return Transitions(
        episodes.states, episodes.actions, episodes.phase, episodes.episode_starts
    )


def noise_study_artifact(preset: Preset) -> Artifact:
    """Whole episodes at noise levels from 0 to 0.25 rad."""
    parameters, upstream = preset.data.noise_study, expert_artifact(preset)

    def compute(folder: Path) -> None:
        collect_noise_study(load_expert(upstream.path), parameters, preset.simulation, folder)

    return load_or_compute(
        "data", {"noise_study": parameters, **_physics(preset)}, compute, [upstream],
        preset=preset.name, seed=parameters.seed,
    )  # fmt: skip


__all__ = [
    "DATASETS",
    "as_transitions",
    "dataset",
    "dataset_artifact",
    "expert",
    "expert_artifact",
    "noise_study_artifact",
    "transitions",
]
