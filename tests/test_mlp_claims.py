"""Claims of notebook 04: each verdict follows from the numbers, met or missed."""

from __future__ import annotations

import numpy as np
import pytest

from cassie_lib import mlp_claims as claims
from cassie_lib.dynamics.evaluation import OpenLoop
from cassie_lib.presets import get_preset
from cassie_lib.provenance import Provenance
from cassie_lib.results import read_results

PRESET = get_preset("laptop")
SOURCE = Provenance("laptop", (0, 1, 2), ())
pytestmark = pytest.mark.usefixtures("figure_folders")


def curve(**losses):
    """A training log of as many epochs as there are losses."""
    found = {f"{name}/state_prediction": np.array(values) for name, values in losses.items()}
    found["horizon"] = np.arange(1.0, 1.0 + len(losses["validation"]))
    return {name: (np.arange(len(values)) + 1, values) for name, values in found.items()}


def seeds(*test_ends, validation=0.25):
    return [curve(train=[1.0, 0.2], validation=[0.5, validation], test=[2.0, end])
            for end in test_ends]  # fmt: skip


def record(claim_id):
    return {item["id"]: item for item in read_results()}[claim_id]


@pytest.mark.parametrize(
    ("ends", "validation", "verdict"),
    [
        ((2.2, 2.5, 9.0), 0.25, "reproduced"),
        ((1.0, 1.9, 9.0), 0.25, "not reproduced"),
        ((2.2, 2.5, 9.0), 0.51, "not reproduced"),
    ],
    ids=["as in the thesis", "the median test loss falls", "the validation loss grows, too"],
)
def test_figure_5_1_is_reproduced_when_only_the_test_loss_grows(ends, validation, verdict):
    lines = claims.record_single_step(PRESET.mlp, seeds(*ends, validation=validation), SOURCE)
    found = record("04-test-to-validation")
    assert found["verdict"] == verdict
    assert found["value"] == pytest.approx(ends[1] / validation)
    assert found["seeds"] == 3
    assert f"test x{ends[1] / 2:.2f}" in lines[0]
    assert f"{PRESET.mlp.hidden_layers} x {PRESET.mlp.hidden_size} units" in found["protocol"]


def errors(step):
    """Errors that grow by ``step`` of the variance each predicted step."""
    model = np.full((6, 46), 2.0) * step * np.arange(1, 7)[:, None]
    return OpenLoop(model, model, model, model, np.full(46, 2.0), np.ones(46), 40)


def test_curriculum_is_recorded_with_the_steps_that_it_reached():
    run = curve(validation=[0.5, 0.4, 0.3])
    lines = claims.record_curriculum(PRESET.mlp, run, errors(0.1), errors(0.05), SOURCE)
    beyond, loss = record("04-beyond-mean-gait"), record("04-curriculum-loss")
    assert beyond["value"] == pytest.approx(2.0), "twice the error of the mean gait"
    assert "40 windows" in beyond["protocol"]
    assert "reached step 3" in beyond["protocol"]
    assert (loss["value"], loss["thesis_value"]) == (0.3, 0.6)
    assert "over 3 of 6 predicted steps" in loss["reason"]
    assert "3 epochs of curriculum" in loss["protocol"]
    assert "curriculum model 0.6, no change 0.6, mean gait 0.3" in lines[1]
