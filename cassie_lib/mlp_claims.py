"""What notebook 04 claims, each verdict computed from numbers and written to ``results.json``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cassie_lib.dynamics.evaluation import OpenLoop
from cassie_lib.plots.mlp import Curves
from cassie_lib.presets import MLPParameters
from cassie_lib.provenance import Provenance
from cassie_lib.results import record_result

#: Validation loss at the end of the curriculum over six steps, section 5.1.1 on Figure 5.2.
THESIS_CURRICULUM_LOSS = 0.6
SETS = ("train", "validation", "test")


def _losses(curves: Curves, name: str) -> np.ndarray:
    """Loss of a set after each epoch."""
    return curves[f"{name}/state_prediction"][1]


def growth(curves: Sequence[Curves], name: str) -> np.ndarray:
    """Loss of a set after the last epoch over that after the first, one value a seed."""
    return np.array([_losses(run, name)[-1] / _losses(run, name)[0] for run in curves])


def generalisation_gap(curves: Sequence[Curves]) -> np.ndarray:
    """Test loss over validation loss after the last epoch, one value a seed."""
    return np.array([_losses(run, "test")[-1] / _losses(run, "validation")[-1] for run in curves])


def record_single_step(
    parameters: MLPParameters, curves: Sequence[Curves], provenance: Provenance
) -> list[str]:
    """Record what Figure 5.1 says: the validation loss falls while the test loss grows.

    Args:
        parameters: Of the network.
        curves: Training logs, one a seed.
        provenance: Of the notebook.

    Returns:
        Lines for the reader.
    """
    gap = generalisation_gap(curves)
    medians = {name: float(np.median(growth(curves, name))) for name in SETS}
    grows = medians["test"] > 1.0 > medians["validation"]
    record_result(
        "04-test-to-validation", "Figure 5.1", provenance.preset, float(np.median(gap)), None,
        len(curves), _protocol(parameters, f"{parameters.epochs} epochs"),
        provenance.from_nothing_s, "validation falls, test grows",
        "reproduced" if grows else "not reproduced", claim="test loss over validation loss",
        reason=f"test loss x{medians['test']:.2f} from first to last epoch; ratio of each "
        f"seed {gap.min():.3g} to {gap.max():.3g}",
    )  # fmt: skip
    found = ", ".join(f"{name} x{value:.2f}" for name, value in medians.items())
    return [
        f"thesis: validation falls, test grows. Ours, last epoch beside first: {found}",
        f"test loss is {np.median(gap):.1f} times the validation loss",
    ]


def record_curriculum(
    parameters: MLPParameters, curve: Curves, model: OpenLoop, gait: OpenLoop,
    provenance: Provenance,
) -> list[str]:
    """Record where the curriculum of Figure 5.2 ends, and what it has learned beyond the gait.

    Args:
        parameters: Of the network.
        curve: Training log.
        model: Errors of the network on the test set.
        gait: Those of predicting the mean gait.
        provenance: Of the notebook.

    Returns:
        Lines for the reader.
    """
    loss, reached = float(_losses(curve, "validation")[-1]), int(curve["horizon"][1][-1])
    lasted, horizon = len(curve["horizon"][1]), parameters.horizon
    shared, spent_s = (None, 1), provenance.from_nothing_s
    record_result(
        "04-beyond-mean-gait", "section 5.1.1", provenance.preset,
        float(model.relative[-1] / gait.relative[-1]), *shared,
        f"test set, step {horizon}, {model.windows} windows, curriculum that reached step "
        f"{reached}", spent_s, None, "not comparable",
        claim="error of the MLP over that of predicting the mean gait",
        reason="under 1 is better than knowing only the gait",
    )  # fmt: skip
    record_result(
        "04-curriculum-loss", "Figure 5.2", provenance.preset, loss, *shared,
        _protocol(parameters, f"{lasted} epochs of curriculum"), spent_s,
        THESIS_CURRICULUM_LOSS, "not comparable",
        claim="validation loss at the end of the curriculum",
        reason=f"over {reached} of {horizon} predicted steps; the thesis does not say in which "
        "units its loss is",
    )  # fmt: skip
    return [
        f"curriculum: thesis {THESIS_CURRICULUM_LOSS} over 6 steps, ours {loss:.3g} over {reached} "
        f"of {horizon} (validation set, {lasted} epochs)",
        f"test, step {horizon}: curriculum model {model.relative[-1]:.3g}, no change "
        f"{model.relative_no_change[-1]:.3g}, mean gait {gait.relative[-1]:.3g} of the variance",
    ]


def _protocol(parameters: MLPParameters, trained: str) -> str:
    return (
        f"H = {parameters.context}, {parameters.hidden_layers} x {parameters.hidden_size} units, "
        f"{trained}, loss in units of the training differences' spread"
    )


__all__ = ["generalisation_gap", "growth", "record_curriculum", "record_single_step"]
