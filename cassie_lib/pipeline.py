"""Upstream results of a notebook, each loaded or computed: no notebook needs another to run first.

Every function takes a preset and returns the artifact of one stage (``..._artifact``) or what is
in it.  What a stage itself needs it asks for in the same way.  Models are trained with one torch
thread, so that their weights do not depend on the number of cores.  Policies and data sets have
modules of their own and are found here, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from cassie_lib.artifacts import WORK, Artifact, load_or_compute
from cassie_lib.artifacts.side_by_side import side_by_side
from cassie_lib.data_pipeline import (
    DATASETS,
    as_transitions,
    baseline_sets,
    dataset,
    dataset_artifact,
    held_out_artifacts,
    held_out_sets,
    noise_study_artifact,
    pending_dataset,
    transitions,
)
from cassie_lib.dynamics.store import save_model
from cassie_lib.dynamics.training import Training, train_causal, train_mlp, train_transformer
from cassie_lib.expert_pipeline import (
    continued_expert_artifact,
    expert,
    expert_artifact,
    expert_choice,
    expert_scores,
    first_expert_artifact,
    reward_only_artifact,
)
from cassie_lib.logs import step_progress
from cassie_lib.presets import Preset, replace
from cassie_lib.threads import one_torch_thread

#: Training curves of a model: epoch, step, seconds, metric, value.
TRAINING_LOG = "timing_log.csv"


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
        with one_torch_thread():
            trained = train_mlp(
                train, parameters, validation=validation, test=test, curriculum=curriculum,
                folder=work,
            )  # fmt: skip
        _store(folder, trained)

    return load_or_compute(
        "mlp", {"mlp": parameters, "curriculum": curriculum}, compute, upstream, preset=preset.name,
        seed=parameters.seed,
    )  # fmt: skip


def mlp_artifacts(preset: Preset, seeds: Sequence[int]) -> tuple[list[Artifact], Artifact]:
    """The baselines of Figure 5.1, one a seed, and that of Figure 5.2; side by side if missing."""
    calls = [partial(mlp_artifact, preset, seed=seed) for seed in seeds]
    *single, several = side_by_side([*calls, partial(mlp_artifact, preset, curriculum=True)])
    return single, several


def transformer_artifact(preset: Preset) -> Artifact:
    """The thesis's transformer of section 5.1.2: weights, card and ``timing_log.csv``."""
    names, parameters = ("train", "validation", "test"), preset.transformer

    def compute(folder: Path) -> None:
        train, validation, test = (transitions(preset, name) for name in names)
        work = _work(folder)
        windows = len(train.window_starts(parameters.context + parameters.horizon))
        windows = min(parameters.windows_per_epoch or windows, windows)
        steps = parameters.epochs * -(-windows // parameters.batch_size)
        with one_torch_thread():
            trained = train_transformer(
                train, parameters, validation=validation, test=test, folder=work,
                callback=step_progress("transformer", steps),
            )  # fmt: skip
        _store(folder, trained)

    return load_or_compute(
        "transformer", parameters, compute,
        [pending_dataset(preset, name) for name in names], preset=preset.name, kept=True,
    )  # fmt: skip


def causal_artifact(preset: Preset, *, wide: bool = True) -> Artifact:
    """The causal model.

    Args:
        preset: The preset.
        wide: Trained on the thesis's training set and on the wide one.  False: on the thesis's
            alone, which holds little but the expert's walk; sizes and budget are then those of
            the preset's ``narrow_causal``.
    """
    sources = ("train", "wide") if wide else ("train",)
    names = (*sources, "validation")
    parameters = preset.causal if wide else preset.narrow_causal

    def compute(folder: Path) -> None:
        *used, validation = (transitions(preset, name) for name in names)
        work = _work(folder)
        # Measured only, for the curves of notebook 05: the weights do not depend on them.
        measured = {"train": used[0], "test": transitions(preset, "test")}
        with one_torch_thread():
            trained = train_causal(
                used, parameters, validation=validation, measured=measured, folder=work,
                callback=step_progress("causal model", parameters.steps),
            )  # fmt: skip
        _store(folder, trained)

    return load_or_compute(
        "causal", parameters, compute,
        [pending_dataset(preset, name) for name in names], preset=preset.name, kept=True,
    )  # fmt: skip


def transformer_and_causal(
    preset: Preset, beside: Sequence[Callable[[], Artifact]] = ()
) -> list[Artifact]:
    """The thesis's transformer and the causal model beside it; side by side if missing.

    Args:
        preset: The preset.
        beside: Further calls for :func:`~cassie_lib.artifacts.side_by_side.side_by_side`; they
            fill the core that is free until the longer of the two trainings ends.
    """
    both: list[Callable[[], Artifact]]
    both = [partial(causal_artifact, preset), partial(transformer_artifact, preset)]
    causal, transformer, *_ = side_by_side([*both, *beside])
    return [transformer, causal]


def _work(folder: Path) -> Path:
    (folder / WORK).mkdir(parents=True, exist_ok=True)
    return folder / WORK


def _store(folder: Path, trained: Training) -> None:
    """Weights and card count as content; the log holds wall times and does not."""
    save_model(folder, trained.model, {"steps": trained.steps, "skipped": trained.skipped})
    trained.log.path = folder / TRAINING_LOG
    trained.log.flush()


__all__ = [
    "DATASETS",
    "TRAINING_LOG",
    "as_transitions",
    "baseline_sets",
    "causal_artifact",
    "continued_expert_artifact",
    "dataset",
    "dataset_artifact",
    "expert",
    "expert_artifact",
    "expert_choice",
    "expert_scores",
    "first_expert_artifact",
    "held_out_artifacts",
    "held_out_sets",
    "mlp_artifact",
    "mlp_artifacts",
    "noise_study_artifact",
    "pending_dataset",
    "reward_only_artifact",
    "transformer_and_causal",
    "transformer_artifact",
    "transitions",
]
