"""Open-loop figures and tables of notebook 05: numbers in them are those of the evaluation."""

from __future__ import annotations

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from recording_toys import lines, saved

from cassie_lib.dynamics.evaluation import OpenLoop
from cassie_lib.dynamics.imagination import Imagined
from cassie_lib.figures import write_plotted_data
from cassie_lib.grid_search import FACTORS
from cassie_lib.plots import prediction as plots
from cassie_lib.robot.schema import CONTROL_PERIOD_S, GROUPS, MOTOR_POSITION

mpl.use("agg")
STEPS = 10


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


def errors(scale, still=0.5):
    """Relative error ``scale * k`` at step k of every component, ``still`` for no change."""
    variance = np.linspace(0.5, 2.0, 46)
    model = scale * np.arange(1, STEPS + 1)[:, None] * variance
    return OpenLoop(model, np.tile(still * variance, (STEPS, 1)), model, model, variance,
                    variance, 9)  # fmt: skip


@pytest.fixture
def results():
    return {
        "σ = 0.01": {"window": errors(0.01), "causal": errors(0.001)},
        "σ = 0.15": {"window": errors(0.04, still=0.9), "causal": errors(0.02, still=0.9)},
    }


def test_table_holds_every_step_of_every_model_and_no_change(results):
    table = plots.relative_table(results)
    assert len(table) == 2 * 3
    assert table.loc[("σ = 0.01", "causal"), "step 10"] == "0.01"
    assert table.loc[("σ = 0.15", "window"), "step 1"] == "0.04"
    assert table.loc[("σ = 0.01", plots.NO_CHANGE), "step 7"] == "0.5"


def test_thesis_metric_stands_beside_the_thesis_number(results):
    table = plots.thesis_metric_table(results, {"σ = 0.01": 0.0013})
    row = table.loc[("σ = 0.01", "window")]
    assert row["thesis"] == 0.0013
    assert row["raw, mean of 49"] == results["σ = 0.01"]["window"].thesis_loss()
    assert row["raw, sum"] == pytest.approx(49 * row["raw, mean of 49"])
    assert np.isnan(table.loc[("σ = 0.15", "causal"), "thesis"])


def test_targets_are_compared_at_their_own_step(results):
    first, last = plots.target_lines(results["σ = 0.01"], {1: 0.002, 10: 0.006}).splitlines()
    assert first == (
        "error / variance at step 1, target 0.002: window 0.01, causal 0.001, no change 0.5"
    )
    assert "at step 10, target 0.006: window 0.1, causal 0.01" in last


def test_relative_errors_are_drawn_as_measured(results, tmp_path):
    figure, data = plots.plot_relative_errors(results, {1: 0.002, 10: 0.006})
    for axes, (name, models) in zip(figure.axes, results.items(), strict=True):
        drawn = lines(axes)
        assert axes.get_title() == name
        for label, result in models.items():
            np.testing.assert_array_equal(drawn[label], (np.arange(1, 11), result.relative))
            np.testing.assert_array_equal(data[f"{label}, {name}"]["relative"], result.relative)
        still = next(iter(models.values())).relative_no_change
        np.testing.assert_array_equal(drawn[plots.NO_CHANGE][1], still)
    assert [np.array(part).tolist() for part in lines(figure.axes[0])["target"]] == [
        [1, 10], [0.002, 0.006],
    ]  # fmt: skip
    assert "target" not in lines(figure.axes[1])
    found = saved(write_plotted_data(tmp_path, "f", data))
    np.testing.assert_allclose(found["causal, σ = 0.15"]["relative"], 0.02 * np.arange(1, 11))


def test_group_errors_leave_out_what_never_varies():
    result = errors(0.01)
    height = GROUPS[0].slice
    # Quadruple the error of one group, and let one of its neighbours' components be constant.
    result.model[:, height] *= 4.0
    result.variance[1] = 0.0
    figure, data = plots.plot_group_errors({"causal": result}, (1, 10))
    assert [axes.get_title() for axes in figure.axes] == ["step 1", "step 10"]
    for axes, step in zip(figure.axes, (1, 10), strict=True):
        values, names = lines(axes)["causal"]
        assert names[0] == GROUPS[0].name
        np.testing.assert_allclose(values[0], 4 * 0.01 * step)
        np.testing.assert_allclose(values[1:], 0.01 * step)
        np.testing.assert_array_equal(data[f"causal, step {step}"]["relative"], values)
        np.testing.assert_allclose(lines(axes)[plots.NO_CHANGE][0], 0.5)
    assert figure.axes[0].get_ylim()[0] > figure.axes[0].get_ylim()[1], "Table 4.1 from above"


def motion(drift, length=21):
    """A ghost that loses ``drift`` m per step and bends every motor by as many rad."""
    states, qpos = np.zeros((length, 49)), np.zeros((length, 35))
    qpos[:, 2], qpos[:, 1] = 1.0, np.arange(length)
    predicted, ghost = states.copy(), qpos.copy()
    predicted[:, MOTOR_POSITION] += drift * np.arange(length)[:, None]
    ghost[:, 0] += drift * np.arange(length)
    return Imagined(states, predicted, qpos, ghost)


def test_ghost_strip_shows_evenly_spread_steps_and_how_far_off(monkeypatch):
    seen = []

    def coded(qpos, *, ghost, width, height, azimuth_deg):
        seen.append((qpos, ghost))
        return np.zeros((len(qpos), height, width, 3), np.uint8), "coded"

    monkeypatch.setattr(plots, "pictures", coded)
    motions = {"causal": motion(0.01), "window": motion(0.03)}
    figure, data = plots.plot_ghosts(motions, count=5)
    assert len(figure.axes) == 10
    assert [axes.get_title() for axes in figure.axes[:5]] == [
        f"{CONTROL_PERIOD_S * step:.2f} s" for step in (0, 5, 10, 15, 20)
    ]
    labels = [axes.get_xlabel() for axes in figure.axes]
    assert labels[:5] == [f"pelvis {value}.0 cm off" for value in (0, 5, 10, 15, 20)]
    assert labels[9] == "pelvis 60.0 cm off"
    for (qpos, ghost), found in zip(seen, motions.values(), strict=True):
        assert qpos[:, 1].tolist() == [0, 5, 10, 15, 20]
        np.testing.assert_array_equal(ghost, found.ghost[::5])
    np.testing.assert_allclose(data["window"]["pelvis_distance_m"], 0.03 * np.arange(21))
    np.testing.assert_allclose(data["window"]["joint_error_rad"], 0.03 * np.arange(21))
    np.testing.assert_allclose(data["window"]["time_s"], 0.03 * np.arange(21))


def grid_rows():
    base = {"batch_size": 128, "context": 30, "learning_rate": 1e-4, "dropout": 0.1,
            "weight_decay": 1e-2}  # fmt: skip
    rows = [{**base, "seed": seed, "changed": "", "one_step_loss": loss}
            for seed, loss in enumerate((2.0, 1.0, 4.0))]  # fmt: skip
    for factor, value, loss in (("batch_size", 64, 3.0), ("batch_size", 256, 1.0),
                                ("context", 50, 0.5), ("learning_rate", 1e-3, 8.0),
                                ("dropout", 0.2, 2.0), ("weight_decay", 0.1, 2.2)):  # fmt: skip
        rows.append({**base, factor: value, "seed": 0, "changed": f"{factor} {value:g}",
                     "one_step_loss": loss})  # fmt: skip
    return rows


def test_grid_effects_are_relative_to_the_median_of_the_choice(tmp_path):
    figure, data = plots.plot_grid_effects(grid_rows())
    for axes, factor in zip(figure.axes, FACTORS, strict=True):
        near, choice = axes.get_lines()
        table = data[factor]
        assert list(near.get_xdata(orig=True)) == [f"{value:g}" for value in table["value"]]
        np.testing.assert_allclose(near.get_ydata(), np.array(table["loss"]) / 2.0)
        assert table["value"] == sorted(table["value"])
        # The choice itself is on the curve, at one.
        place = list(near.get_xdata(orig=True)).index(choice.get_xdata(orig=True)[0])
        assert near.get_ydata()[place] == choice.get_ydata()[0] == 1.0
        spread = axes.patches[0].get_bbox()
        assert (spread.y0, spread.y1) == (0.5, 2.0), "the range over the seeds of the choice"
    assert data["batch_size"] == {"value": [64, 128, 256], "loss": [3.0, 2.0, 1.0]}
    found = saved(write_plotted_data(tmp_path, "f", data))
    assert found["the thesis's choice"]["loss"] == [2.0, 1.0, 4.0]
    assert found["context"]["value"] == [30, 50]
