"""Learning curves of notebook 05: values, times and increments as the log holds them."""

from __future__ import annotations

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from recording_toys import lines, saved

from cassie_lib.errors import DataError
from cassie_lib.figures import write_plotted_data
from cassie_lib.plots import transformer as plots
from cassie_lib.plots.transformer import CAUSAL_LABEL, THESIS_LABEL, Curve

mpl.use("agg")
EPOCHS = np.arange(1, 9)
MINUTES = 0.5 * EPOCHS
THESIS_VALUES = {"train": 0.0018, "test": 0.0013, "validation": 0.0016}


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


def curve(values):
    return Curve(EPOCHS[-len(values) :], MINUTES[-len(values) :], np.asarray(values, float))


@pytest.fixture
def thesis():
    falling = 1.0 / EPOCHS
    log = {f"{name}/state_prediction_raw": curve(scale * falling)
           for name, scale in (("train", 3), ("test", 1), ("validation", 2))}  # fmt: skip
    log |= {f"train/{name}": curve(scale * falling) for name, scale in
            (("penalised", 3.0), ("state_prediction", 2.0), ("gradient_penalty", 1.0))}  # fmt: skip
    log["horizon"] = curve([1, 1, 1, 1, 2, 2, 3, 3])
    log["increment"] = Curve(np.array([4, 6]), MINUTES[[3, 5]], np.array([2, 3]))
    for step, begun in ((1, 8), (2, 4), (3, 2)):
        log[f"train/raw_step_{step}"] = curve(step * falling[-begun:])
    return log


@pytest.fixture
def causal():
    log = {f"{name}/state_prediction_raw": Curve(np.ones(3), MINUTES[:3], np.array([0.3, 0.2, 0.1]))
           for name in ("train", "test", "validation")}  # fmt: skip
    return log | {"train/raw_step_1": Curve(np.ones(1), MINUTES[:1], np.array([0.4]))}


def marks_increment(line):
    return len(line.get_xdata()) == 2 and line.get_xdata()[0] == line.get_xdata()[1]


def increments(axes):
    return [line.get_xdata()[0] for line in axes.get_lines() if marks_increment(line)]


def test_log_is_read_by_metric_in_minutes_and_from_epoch_one(tmp_path):
    path = tmp_path / "timing_log.csv"
    path.write_text(
        "epoch,step,seconds,metric,value\n0,5,30.0,horizon,1\n0,5,30.0,train/loss,0.5\n"
        "1,9,90.0,horizon,2\n"
    )
    found = plots.read_log(path)
    assert set(found) == {"horizon", "train/loss"}
    assert found["horizon"].epoch.tolist() == [1, 2]
    assert found["horizon"].minutes.tolist() == [0.5, 1.5]
    assert found["train/loss"].value.tolist() == [0.5]


@pytest.mark.parametrize(
    "content",
    ["a,b\n1,2\n", "epoch,seconds,metric,value\n0,x,loss,1\n", "epoch,seconds,metric,value\n0\n",
     "", "epoch,seconds,metric,value\n"],
)  # fmt: skip
def test_what_is_no_log_is_refused_by_name(content, tmp_path):
    path = tmp_path / "timing_log.csv"
    path.write_text(content)
    with pytest.raises(DataError, match=r"timing_log\.csv cannot be read: expected a training log"):
        plots.read_log(path)
    with pytest.raises(DataError, match=r"missing\.csv"):
        plots.read_log(tmp_path / "missing.csv")


@pytest.mark.parametrize("other", ["test", "validation"])
def test_losses_are_drawn_as_logged_beside_the_thesis(thesis, causal, other, tmp_path):
    figure, data = plots.plot_state_prediction(thesis, causal, other, THESIS_VALUES)
    axes = figure.axes[0]
    drawn = lines(axes)
    for label, log in ((THESIS_LABEL, thesis), (CAUSAL_LABEL, causal)):
        for name in ("train", other):
            expected = log[f"{name}/state_prediction_raw"]
            x, y = drawn[f"{label}, {name}"]
            np.testing.assert_array_equal((x, y), (expected.minutes, expected.value))
            np.testing.assert_array_equal(data[f"{label}, {name}"]["value"], expected.value)
    for name in ("train", other):
        value = THESIS_VALUES[name]
        assert drawn[f"thesis's {name}, {value:g} (unit unknown)"][1].tolist() == [value, value]
    assert increments(axes) == MINUTES[[3, 5]].tolist()
    assert axes.get_yscale() == "log"
    found = saved(write_plotted_data(tmp_path, "f", data))
    np.testing.assert_allclose(found[f"{THESIS_LABEL}, train"]["minutes"], MINUTES)


def test_upper_edge_tells_the_epoch_at_its_time(thesis):
    _, axes = plt.subplots()
    plots.add_epochs(axes, thesis)
    above = axes.child_axes[0]
    epochs = [int(text.get_text()) for text in above.get_xticklabels()]
    assert epochs[0] == 1
    assert epochs[-1] == 8
    np.testing.assert_allclose(above.get_xticks(), 0.5 * np.array(epochs))


def test_loss_of_training_is_drawn_with_its_two_parts(thesis):
    figure, data = plots.plot_penalised(thesis)
    drawn = lines(figure.axes[0])
    values = {label.split(" ")[0]: y for label, (_, y) in drawn.items() if label[0] != "_"}
    np.testing.assert_array_equal(values["Eq"], thesis["train/penalised"].value)
    np.testing.assert_array_equal(values["state"], thesis["train/state_prediction"].value)
    np.testing.assert_array_equal(values["penalty,"], thesis["train/gradient_penalty"].value)
    np.testing.assert_array_equal(data["penalised"]["value"], thesis["train/penalised"].value)
    assert increments(figure.axes[0]) == MINUTES[[3, 5]].tolist()


def test_each_predicted_step_has_its_curve_from_its_increment_on(thesis, causal):
    figure, data = plots.plot_steps(thesis, causal, "train")
    left, right = figure.axes[:2]
    curves = [line for line in left.get_lines() if not marks_increment(line)]
    assert [len(line.get_xdata()) for line in curves] == [8, 4, 2]
    for step, line in enumerate(curves, start=1):
        expected = thesis[f"train/raw_step_{step}"]
        np.testing.assert_array_equal(line.get_xdata(), expected.minutes)
        np.testing.assert_array_equal(line.get_ydata(), expected.value)
    (single,) = right.get_lines()
    assert single.get_marker() == ".", "one point would not show as a line"
    assert list(data) == [f"{THESIS_LABEL}, step {step}" for step in (1, 2, 3)] + [
        f"{CAUSAL_LABEL}, step 1"
    ]
    # The same shade is the same step in both panels.
    assert np.allclose(mpl.colors.to_rgba(single.get_color()),
                       mpl.colors.to_rgba(curves[0].get_color()))  # fmt: skip
    assert increments(left) == MINUTES[[3, 5]].tolist()
    assert increments(right) == []


def test_a_log_without_increments_marks_none(thesis):
    del thesis["increment"]
    figure, _ = plots.plot_penalised(thesis)
    assert increments(figure.axes[0]) == []
