"""Figures of notebook 02: curves of the log, forces and feet of the recording, measured speeds."""

from __future__ import annotations

import dataclasses

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from recording_toys import lines, saved, toy_recording

from cassie_lib.errors import DataError
from cassie_lib.expert import trials
from cassie_lib.figures import write_plotted_data
from cassie_lib.logs import CsvLog
from cassie_lib.plots import expert as plots
from cassie_lib.robot.schema import CONTROL_PERIOD_S, PERIOD
from cassie_lib.walking_report import walking_report

mpl.use("agg")


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


def test_log_is_read_by_metric(tmp_path):
    log = CsvLog(tmp_path / "log.csv", seed=3)
    log.write(100, 1.5, {"plain_reward": 0.5, "falls": 0.1})
    log.write(200, 3.0, {"plain_reward": 0.6, "falls": 0.0})
    found = {name: values.tolist() for name, values in plots.read_log(log.path).items()}
    assert found == {"plain_reward": [0.5, 0.6], "falls": [0.1, 0.0], "step": [100.0, 200.0],
                     "seconds": [1.5, 3.0]}  # fmt: skip


def test_logs_of_trainings_that_follow_each_other_add_up(tmp_path):
    paths = []
    for name, reward in (("a", 0.5), ("b", 0.7)):
        log = CsvLog(tmp_path / f"{name}.csv", seed=0)
        log.write(100, 2.0, {"plain_reward": reward})
        paths.append(log.path)
    found = plots.read_log(*paths)
    assert found["step"].tolist() == [100.0, 200.0]
    assert found["seconds"].tolist() == [2.0, 4.0]
    assert found["plain_reward"].tolist() == [0.5, 0.7]


@pytest.mark.parametrize("content", ["", "step,seconds,metric,value,seed\n", "a,b\n1,2\n",
                                     "step,seconds,metric,value\n1,1.0,reward,high\n"])  # fmt: skip
def test_what_is_no_log_is_refused_by_name(content, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(content)
    with pytest.raises(DataError, match=r"log\.csv cannot be read: expected a training log"):
        plots.read_log(path)
    with pytest.raises(DataError, match=r"none\.csv"):
        plots.read_log(tmp_path / "none.csv")


def log_of(updates, slope=0.01):
    steps = np.arange(updates)
    return {"seconds": 60.0 * steps, "plain_reward": 0.5 + slope * steps,
            "falls": np.where(steps < 15, 0.1, 0.0)}  # fmt: skip


def test_learning_curves_are_running_means_of_log_and_clock(tmp_path):
    figure, data = plots.plot_learning_curves({"pi*": log_of(40), "alone": log_of(30, 0.0)}, 0.9)
    left, right = figure.axes
    minutes, reward = lines(left)["pi*"]
    # A straight line stays on itself when both axes are averaged over the same ten updates.
    np.testing.assert_allclose(reward, 0.5 + 0.01 * minutes)
    assert len(minutes) == 31
    np.testing.assert_allclose((minutes[0], minutes[-1]), (4.5, 34.5))
    np.testing.assert_array_equal(data["pi*"]["reward"], reward)
    np.testing.assert_array_equal(lines(right)["pi*"][0], minutes)
    assert lines(right)["pi*"][1].min() == 1e-5, "no failure at all still shows on a log axis"
    assert data["pi*"]["failures_per_step"].min() == pytest.approx(0.0, abs=1e-12)
    levels = [line.get_ydata()[0] for line in left.get_lines() if len(line.get_ydata()) == 2]
    assert levels == [0.9]
    assert len(saved(write_plotted_data(tmp_path, "f", data))["alone"]["minutes"]) == 21


def test_a_log_shorter_than_the_window_is_averaged_whole():
    _, data = plots.plot_learning_curves({"short": log_of(4)}, 0.9)
    np.testing.assert_allclose(data["short"]["reward"], [0.515])


@pytest.mark.parametrize("steps", [slice(10, 40), slice(50, None), slice(0, 60, 3)])
def test_contact_forces_are_those_of_the_left_foot_at_their_time(steps):
    recording = toy_recording([60, 60], 60)
    figure, data = plots.plot_contact_forces(recording, steps, episode=1)
    expected = recording.foot_force[1, steps, 0]
    time = CONTROL_PERIOD_S * np.arange(61)[steps]
    for axes, axis, name in zip(figure.axes, range(3), ("x_N", "y_N", "z_N"), strict=True):
        x, y = axes.get_lines()[0].get_data()
        np.testing.assert_allclose(x, time)
        np.testing.assert_array_equal(y, expected[:, axis])
        np.testing.assert_array_equal(data[name], y)
    weight = figure.axes[2].get_lines()[1].get_ydata()[0]
    # Cassie weighs a little over 31 kg.
    assert 300.0 < weight < 340.0


@pytest.mark.filterwarnings("ignore:Mean of empty slice")
def test_feet_and_reward_stand_side_by_side():
    walks, falls = toy_recording([60, 60], 60), toy_recording([0, 0], 60, lift_m=0.0)
    figure, data = plots.plot_foot_heights({"walks": walks, "falls": falls}, slice(20, 61), 1)
    axes = np.array(figure.axes).reshape(2, 2)
    for column, recording, label in ((0, walks, "walks"), (1, falls, "falls")):
        top, bottom = axes[:, column]
        left, right = (line.get_ydata() for line in top.get_lines())
        # In cm, and no longer than there are control steps.
        np.testing.assert_allclose(left, 100 * recording.foot_height[1, 20:60, 0])
        np.testing.assert_allclose(right, 100 * recording.foot_height[1, 20:60, 1])
        np.testing.assert_array_equal(bottom.get_lines()[0].get_ydata(), recording.reward[1, 20:])
        np.testing.assert_array_equal(data[label]["reward"], recording.reward[1, 20:])
        np.testing.assert_allclose(data[label]["time_s"], CONTROL_PERIOD_S * np.arange(20, 60))
    assert axes[1, 0].get_title() == f"mean {walks.reward.mean():.3f}"
    assert axes[1, 1].get_title() == "fell"


def test_a_single_policy_can_be_drawn_too():
    figure, data = plots.plot_foot_heights({"walks": toy_recording([60], 60)}, slice(0, 60))
    assert list(data) == ["walks"]
    assert len(figure.axes) == 2


def test_speeds_are_drawn_less_their_command_as_median_and_range_of_the_upright(tmp_path):
    measured = [np.array([0.04, 0.05, 0.09]), np.array([0.4, np.nan, 0.6])]
    figure, data = plots.plot_speed_tracking((0.05, 0.5), measured)
    bars = figure.axes[0].containers[0]
    np.testing.assert_allclose(bars.lines[0].get_xydata(), [[0.05, 0.0], [0.5, 0.0]], atol=1e-12)
    low, high = (line.get_xydata()[:, 1] for line in bars.lines[1])
    np.testing.assert_allclose(low, [-0.01, -0.1])
    np.testing.assert_allclose(high, [0.04, 0.1])
    below, above = figure.axes[0].get_ylim()
    assert below < -0.1 < 0.1 < above, "every seed is within the picture"
    accepted = figure.axes[0].patches[0].get_extents().transformed(
        figure.axes[0].transData.inverted()
    )
    np.testing.assert_allclose([accepted.y0, accepted.y1], [-0.05, 0.05])
    found = saved(write_plotted_data(tmp_path, "f", data))[""]
    assert found["least_mps"] == [0.04, 0.4]
    assert found["greatest_mps"] == [0.09, 0.6]


def test_rows_of_the_trials_count_who_passed():
    steps = 5 * PERIOD
    quiet = toy_recording([steps] * 4, steps)
    noisy, pushed = toy_recording([steps, 9, 9, 9], steps), toy_recording([steps] * 3 + [9], steps)
    moving = quiet.qpos.copy()
    # Two of four walk at 0.25 m/s, one of them sideways as well.
    moving[..., 0] = 0.25 * CONTROL_PERIOD_S * np.arange(steps + 1) * [[1], [1], [0], [0]]
    moving[..., 1] = 0.5 * CONTROL_PERIOD_S * np.arange(steps + 1) * [[0], [1], [0], [0]]
    report = walking_report(dataclasses.replace(quiet, qpos=moving, speed_mps=0.25))
    found = trials.ExpertTrials(quiet, noisy, pushed, {0.25: report}, walking_report(quiet))
    rows = {row["trial"]: (row["target"], row["episodes"]) for row in found.rows()}
    assert rows["no fall, no noise"] == ("4/4", "4/4")
    assert rows["no fall, action noise 0.06 rad"] == ("≥ 3/4", "1/4")
    assert rows["upright after a sideways push of 40 N s"] == ("≥ 3/4", "3/4")
    assert rows["speed within 0.05 m/s of 0.25 m/s"] == ("4/4", "2/4")
    assert rows["sideways drift < 0.1 m/s at 0.25 m/s"] == ("4/4", "3/4")
    # Nothing bears on the floor in a toy: upright is not walking.
    assert rows["all measures of the walking report"] == ("4/4", "0/4")
    np.testing.assert_allclose(found.speeds()[0], [0.25, 0.25, 0.0, 0.0], atol=1e-12)
