"""What notebook 05 claims, each verdict computed from numbers and written to ``results.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cassie_lib.artifacts import Artifact
from cassie_lib.artifacts.ledger import from_nothing_s
from cassie_lib.dynamics.evaluation import OpenLoop
from cassie_lib.plots.transformer import CAUSAL_LABEL, THESIS_LABEL, Log
from cassie_lib.presets import Preset
from cassie_lib.results import Result, record_result

#: Final Eq 3.6 of section 5.1.2 by set.
THESIS_LOSSES = {"train": 0.0018, "validation": 0.0016, "test": 0.0013}
#: Epochs before the first increment, read off the thesis's Figure A.1.
THESIS_FIRST_INCREMENT = 375
#: Held-out sets of notebook 05 that are the thesis's.
SETS = {"train": "training set", "validation": "σ = 0.03", "test": "σ = 0.01"}
#: How the final losses are measured.
EVALUATED = "Eq 3.6 over ten predicted steps, raw units, mean of 49 components, dropout off"
Losses = Mapping[str, float]
#: Parameters of the thesis's transformer, section 5.1.2.
THESIS_PARAMETERS = 12_919_393
#: Eq 3.9 on the training set after 1000 epochs, section 5.1.2 on Figure 5.5.
THESIS_PENALISED = 0.023
#: Error over variance that the causal model is to reach on sigma = 0.01, by predicted step.
TARGETS = {1: 0.002, 10: 0.006}


def first_to_last(log: Log, name: str) -> tuple[float, float]:
    """First and last Eq 3.6 of a set, raw units."""
    values = log[f"{name}/state_prediction_raw"].value
    return float(values[0]), float(values[-1])


def epochs_per_step(log: Log) -> np.ndarray:
    """Epochs that each number of predicted steps lasted, the last (unfinished) one included."""
    return np.bincount(log["horizon"].value.astype(int))[1:]


def _verdict(holds: bool) -> str:
    return "reproduced" if holds else "not reproduced"


def set_losses(errors: Mapping[str, Mapping[str, OpenLoop]], label: str) -> Losses:
    """Eq 3.6 of a model over all predicted steps by set, raw units, dropout off.

    The log's training loss is a mean over the epoch with dropout on and over the steps predicted
    by then; these compare with one another and between models.

    Args:
        errors: Open-loop errors by set (a key of :data:`SETS`) and model.
        label: The model.
    """
    return {part: errors[name][label].thesis_loss() for part, name in SETS.items()}


def record_training(
    preset: Preset, log: Log, artifact: Artifact, losses: Losses
) -> list[dict[str, Any]]:
    """Record what section 5.1.2 says of its curves: they fall, in which order, how fast.

    Args:
        preset: The preset that really ran.
        log: Log of the thesis's architecture.
        artifact: Its artifact, for the time.
        losses: Its final losses, of :func:`set_losses`.
    """
    ends = {name: first_to_last(log, name) for name in THESIS_LOSSES}
    lasted = epochs_per_step(log)
    spent_s = from_nothing_s([artifact])
    protocol = (
        f"Eq 3.6 in raw units, mean of 49 components, {lasted.sum()} epochs, "
        f"{len(lasted)} predicted steps at the end; training: mean of the epoch, dropout on"
    )
    falls = all(end[1] < end[0] for end in ends.values())
    ordered = losses["test"] < losses["validation"] < losses["train"]
    # The last number of steps has no increment after it: its epochs are no waiting time.
    longest = len(lasted) > 1 and lasted[0] == lasted[:-1].max()
    shared = (None, 1, protocol, spent_s)
    return [
        record_result(
            "05-loss-falls", "Figures 5.3, 5.4", preset.name, ends["test"][1] / ends["test"][0],
            *shared, "falls", _verdict(falls), claim="test loss, last epoch over first",
            reason="of training, validation and test: " + ("all fall" if falls else "not all fall")
            + ", although more and more steps are predicted",
        ),
        record_result(
            "05-loss-order", "section 5.1.2", preset.name, losses["test"] / losses["train"], None,
            1, EVALUATED, spent_s, THESIS_LOSSES["test"] / THESIS_LOSSES["train"],
            _verdict(ordered), claim="test loss over training loss",
            reason=" < ".join(sorted(losses, key=lambda name: losses[name]))
            + (": the order of their action noise" if ordered else ""),
        ),
        record_result(
            "05-first-increment", "Figure A.1", preset.name, float(lasted[0]), *shared,
            float(THESIS_FIRST_INCREMENT), _verdict(longest),
            claim="the first increment takes the most epochs", unit="epochs",
            reason="epochs per predicted step: " + ", ".join(map(str, lasted))
            + " (the last one cut off)",
        ),
    ]  # fmt: skip


def record_losses(
    preset: Preset, log: Log, artifact: Artifact, parameters: int, losses: Losses
) -> list[Result]:
    """Record the final losses beside the thesis's: Eq 3.6, and Eq 3.9 of Figure 5.5.

    Args:
        preset: The preset that really ran.
        log: Log of the thesis's architecture.
        artifact: Its artifact, for the time.
        parameters: Number of its weights.
        losses: Its final losses, of :func:`set_losses`.
    """
    steps, epochs = len(epochs_per_step(log)), epochs_per_step(log).sum()
    size = f"{parameters:,} of {THESIS_PARAMETERS:,} weights, {epochs} of 1000 epochs"
    reached = f"{steps} of {preset.transformer.horizon} predicted steps"
    spent_s = from_nothing_s([artifact])
    ends = {name: log[f"train/{name}"].value[[0, -1]] for name in ("penalised", "gradient_penalty")}
    falls = all(end[1] < end[0] for end in ends.values())
    first, final = ends["gradient_penalty"]
    return [
        record_result(
            "05-losses", "section 5.1.2", preset.name, losses["test"], None, 1,
            f"{EVALUATED}; {size}", spent_s, THESIS_LOSSES["test"], "not comparable",
            claim="test loss of the thesis's architecture, Eq 3.6 in raw units",
            reason="the thesis names no units (training 0.0018, validation 0.0016); ours: "
            f"training {losses['train']:.3g}, validation {losses['validation']:.3g}; trained on "
            f"{reached}",
        ),
        record_result(
            "05-penalised", "Figure 5.5", preset.name, float(ends["penalised"][1]), None, 1,
            f"mean of the last epoch, dropout on; {size}, {reached}", spent_s, THESIS_PENALISED,
            _verdict(falls),
            claim="training loss and gradient penalty of Eq 3.9 both fall",
            reason=f"loss (normalised) from {ends['penalised'][0]:.3g}; penalty before λ from "
            f"{first:.2g} to {final:.2g}; {reached}",
        ),
    ]  # fmt: skip


def record_accuracy(
    preset: Preset, models: Mapping[str, OpenLoop], artifact: Artifact
) -> list[Result]:
    """Record the causal model's relative errors on the test set beside their targets.

    Args:
        preset: The preset that really ran.
        models: Errors on sigma = 0.01 by model.
        artifact: The causal model's artifact, for the time.
    """
    causal, thesis = models[CAUSAL_LABEL], models[THESIS_LABEL]
    records = []
    for step, target in TARGETS.items():
        value = float(causal.relative[step - 1])
        records.append(record_result(
            f"05-relative-step-{step}", "section 5.1.2", preset.name, value, None, 1,
            f"sigma = 0.01 rad, open loop, {causal.windows} windows, mean of 46 components",
            from_nothing_s([artifact]), None, "not comparable",
            claim=f"squared error over variance at step {step}, causal model",
            reason=f"target {target:g} {'met' if value <= target else 'missed'}; thesis "
            f"architecture {thesis.relative[step - 1]:.2g}, no change "
            f"{causal.relative_no_change[step - 1]:.2g}",
        ))  # fmt: skip
    return records


def record_grid(
    preset: Preset, rows: Sequence[Mapping[str, Any]], artifacts: Sequence[Artifact]
) -> list[dict[str, Any]]:
    """Record the best point of the grid beside the trainings of the thesis's choice.

    No verdict: the best of many single trainings would beat a few of the choice even if no factor
    did anything, and so short a training does not tell where a thousand epochs end.

    Args:
        preset: The preset that really ran.
        rows: Of :func:`~cassie_lib.grid_search.score_table`; none records nothing.
        artifacts: Of the same points, for the time.
    """
    base = [row["one_step_loss"] for row in rows if not row["changed"]]
    others = [row for row in rows if row["changed"]]
    if not base or not others:
        return []
    best = min(others, key=lambda row: row["one_step_loss"])
    grid = preset.grid
    return [record_result(
        "05-grid", "Appendix A.1", preset.name, best["one_step_loss"] / float(np.median(base)),
        None, 1,
        f"{len(rows)} trainings near the choice, {grid.epochs} epochs of "
        f"{grid.windows_per_epoch or 'all'} windows, {grid.horizon} predicted step(s)",
        from_nothing_s(artifacts), "the choice is best",
        "not comparable",
        claim="validation loss of the best other point over that of the thesis's choice",
        reason=f"best of {len(others)} single trainings: {best['changed']}; the choice's "
        f"{len(base)} seeds {min(base):.3g} to {max(base):.3g}; {grid.epochs} epochs do not tell "
        "where 1000 end",
    )]  # fmt: skip


def losses_beside_the_thesis(models: Mapping[str, Losses], log: Log) -> str:
    """Lines of text: the thesis's final losses, and those of the models in raw units.

    Args:
        models: Of :func:`set_losses` by model.
        log: Log of the thesis's architecture.
    """
    lines = [EVALUATED + ":"]
    for name, value in THESIS_LOSSES.items():
        ours = ", ".join(f"{losses[name]:.3g} ({label})" for label, losses in models.items())
        lines.append(f"{name}: thesis {value:g}, here {ours}")
    lasted = ", ".join(map(str, epochs_per_step(log)))
    lines.append(
        f"epochs per predicted step: {lasted}; the thesis's first {THESIS_FIRST_INCREMENT}"
    )
    return "\n".join(lines)


__all__ = [
    "EVALUATED",
    "SETS",
    "TARGETS",
    "THESIS_LOSSES",
    "THESIS_PARAMETERS",
    "epochs_per_step",
    "first_to_last",
    "losses_beside_the_thesis",
    "record_accuracy",
    "record_grid",
    "record_losses",
    "record_training",
    "set_losses",
]
