"""Figures of notebooks 06 and 07: what is drawn is what was recorded, falls where they were."""

from __future__ import annotations

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from recording_toys import band, lines, saved, toy_trial

from cassie_lib.figures import write_plotted_data
from cassie_lib.planning.cost_sweep import GradientCost, Sweep
from cassie_lib.plots import planning as plots
from cassie_lib.plots.planning_costs import plot_costs
from cassie_lib.reward import WEIGHTS

mpl.use("agg")
BASELINES = {"pi*": 0.97, "standing still": 0.9}


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


@pytest.fixture
def trial():
    """Three seeds of 40 steps, hand-over at 10: falls at 12 and 25, one upright to the end."""
    return toy_trial([12, 25, 40], 40, handover=10)


def test_reward_panel_draws_median_and_range_of_those_upright(trial):
    _, axes = plt.subplots()
    data = plots.reward_panel(axes, trial, BASELINES, thesis_fall=30)
    drawn, reward = lines(axes), trial.recording.reward
    steps, median = drawn["median, while half are upright"]
    np.testing.assert_array_equal(steps, np.arange(40))
    np.testing.assert_array_equal(median, data["median"])
    np.testing.assert_allclose(median[:12], np.median(reward[:, :12], axis=0))
    np.testing.assert_allclose(median[12:25], reward[1:, 12:25].mean(axis=0))
    assert np.isnan(median[25:]).all(), "one of three seeds is left"
    low, high = band(axes)
    np.testing.assert_allclose((low, high), (data["low"], data["high"]))
    assert (low <= median)[:25].all()
    assert (median <= high)[:25].all()
    assert data["seeds_upright"].tolist() == [3] * 12 + [2] * 13 + [1] * 15


def test_reward_panel_marks_falls_hand_over_and_baselines(trial):
    _, axes = plt.subplots()
    plots.reward_panel(axes, trial, BASELINES, thesis_fall=30)
    drawn = lines(axes)
    where, height = drawn["fall of a seed"]
    assert where.tolist() == [12, 25], "the seed that stays upright has no cross"
    reward = trial.recording.reward
    np.testing.assert_array_equal(height, [reward[0, 11], reward[1, 24]])
    assert drawn["hand-over to the planner"][0].tolist() == [10, 10]
    assert drawn["thesis: fall at 30"][0].tolist() == [30, 30]
    assert drawn["π*"][1].tolist() == [0.97, 0.97]
    assert drawn["standing still"][1].tolist() == [0.9, 0.9]
    _, other = plt.subplots()
    plots.reward_panel(other, trial, {})
    assert not any("thesis" in label for label in lines(other))


def test_seeds_that_fall_at_once_have_no_reward_to_mark():
    _, axes = plt.subplots()
    data = plots.reward_panel(axes, toy_trial([0, 6], 10), {})
    assert lines(axes)["fall of a seed"][0].tolist() == [6]
    assert data["seeds_upright"].tolist() == [1] * 6


@pytest.mark.filterwarnings("ignore:All-NaN")
def test_a_trial_in_which_all_fall_at_once_is_still_drawn():
    _, axes = plt.subplots()
    data = plots.reward_panel(axes, toy_trial([0, 0], 10), {})
    assert data["seeds_upright"].tolist() == [0]
    assert np.isnan(data["median"]).all()


def test_survival_counts_planner_steps_and_marks_those_who_never_fell(trial):
    _, axes = plt.subplots()
    fell = toy_trial([15, 20], 40, handover=10)
    data = plots.survival_panel(axes, {"walks": trial, "falls": fell})
    steps, share = lines(axes)["walks"]
    assert steps.tolist() == list(range(31))
    # Falls after 2 and 15 steps of the planner.
    np.testing.assert_allclose(share, [1] * 3 + [2 / 3] * 13 + [1 / 3] * 15)
    np.testing.assert_array_equal(share, data["walks"]["share_upright"])
    assert (np.diff(data["falls"]["share_upright"]) <= 0).all()
    ends = [line for line in axes.get_lines() if line.get_marker() == ">" and len(line.get_xdata())]
    assert [line.get_xdata()[0] for line in ends] == [30], "only the first trial has survivors"


def test_reward_figure_holds_both_models_and_all_means(trial, tmp_path):
    oracle = toy_trial([20], 20, handover=10, seed=5)
    figure, data = plots.plot_rewards(trial, oracle, {"warm": trial}, BASELINES, 30)
    top, middle, bottom = figure.axes
    assert "3 seeds" in top.get_title()
    assert middle.get_title().endswith("1 seed")
    np.testing.assert_array_equal(lines(middle)["median, while half are upright"][1],
                                  oracle.recording.reward[0])  # fmt: skip
    assert top.get_xlim() == middle.get_xlim(), "the shorter trial is drawn to the same scale"
    assert {"warm", "true simulator,\n1 seed"} <= set(lines(bottom)), "other seeds are told"
    shift = np.array(top.get_xlim()) - np.array(bottom.get_xlim())
    np.testing.assert_allclose(shift, 10, err_msg="the hand-over is one line down the figure")
    found = saved(write_plotted_data(tmp_path, "f", data))
    assert set(found) == {"learned", "oracle", "upright, warm", "upright, true simulator"}
    np.testing.assert_allclose(found["oracle"]["median"], oracle.recording.reward[0])


def test_a_trial_without_falls_does_not_push_the_panels_together(trial):
    with plt.rc_context({"figure.constrained_layout.use": True}):
        figure, _ = plots.plot_rewards(trial, toy_trial([20], 20), {"warm": trial}, BASELINES, 30)
        figure.canvas.draw()
    assert min(axes.get_position().height for axes in figure.axes) > 0.12


def test_imagined_returns_are_paired_with_what_followed():
    found = toy_trial([30, 40], 40, handover=5, horizon=3, optimism=0.5)
    figure, data = plots.plot_imagined({"CEM": found}, 3)
    left, right = figure.axes
    points = left.get_lines()[0]
    np.testing.assert_allclose(points.get_ydata() - points.get_xdata(), 0.5)
    np.testing.assert_array_equal(points.get_xdata(), data["CEM"]["realised"])
    # Plans of steps 5..26 and 5..36: later ones look past the end.
    assert len(points.get_xdata()) == 22 + 32
    before, error = lines(right)["CEM"]
    np.testing.assert_allclose(error, 0.5)
    assert before.tolist() == list(range(35, 3, -1))
    assert right.get_xlim()[0] > right.get_xlim()[1], "the end is on the right"


def test_terms_before_a_fall_are_those_of_the_seeds_that_fell():
    reward = np.full((2, 40), 0.9)
    reward[0, 10:] = np.linspace(0.8, 0.2, 30)
    figure, data = plots.plot_fall_terms(toy_trial([20, 40], 40, reward=reward), reach=15)
    axes = figure.axes[0]
    assert "the fall (1 seeds)" in axes.get_xlabel()
    assert data["steps_before_end"].tolist() == list(range(15, 0, -1))
    for name, weight in WEIGHTS.items():
        np.testing.assert_allclose(data[name], reward[0, 5:20])
        drawn = lines(axes)[f"{name.replace('_', ' ')} ({weight:g})"]
        np.testing.assert_array_equal(drawn, (data["steps_before_end"], data[name]))
    figure, data = plots.plot_fall_terms(toy_trial([40, 40], 40, reward=reward), reach=10)
    assert "no fall" in figure.axes[0].get_xlabel()
    np.testing.assert_allclose(data["motor"], reward[:, 30:].mean(axis=0))


def test_costs_are_drawn_in_milliseconds_and_megabytes(tmp_path):
    values = np.array([10, 20, 40])
    sweeps = [Sweep("N", values, 0.002 * values), Sweep("tau", values, 1e-4 * values**2.0),
              Sweep("H", values, np.full(3, 0.3))]  # fmt: skip
    assert [sweep.exponent for sweep in sweeps] == pytest.approx([1.0, 2.0, 0.0], abs=1e-9)
    gradients = [GradientCost(50, 10**6, 0.1), GradientCost(1000, 20 * 10**6, 2.0)]
    figure, data = plot_costs(sweeps, gradients)
    for axes, sweep in zip(figure.axes, sweeps, strict=False):
        measured, proportional = (line.get_ydata() for line in axes.get_lines())
        np.testing.assert_allclose(measured, 1e3 * sweep.seconds)
        np.testing.assert_allclose(proportional[-1], measured[-1])
        assert f"{sweep.exponent:.2f}" in axes.get_title()
        np.testing.assert_array_equal(data[f"plan against {sweep.name}"]["seconds"], sweep.seconds)
    bars = figure.axes[3].patches
    assert [bar.get_height() for bar in bars] == pytest.approx([1.0, 20.0])
    found = saved(write_plotted_data(tmp_path, "f", data))["gradient"]
    assert found["memory_bytes"] == [10**6, 20 * 10**6]
    assert found["seconds"] == [0.1, 2.0]


def test_no_fall_no_mark_and_one_label_for_what_several_panels_show(trial):
    upright = toy_trial([40, 40], 40, handover=10)
    figure, (top, bottom) = plt.subplots(2)
    plots.reward_panel(top, upright, BASELINES)
    assert "fall of a seed" not in lines(top)
    plots.reward_panel(bottom, trial, BASELINES)
    plots.panels_legend(figure, (top, bottom))
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert len(labels) == len(set(labels))
    assert {"fall of a seed", "π*", "hand-over to the planner"} <= set(labels)


def test_the_thesis_fall_is_not_drawn_past_the_end_of_a_shorter_trial(trial):
    short = toy_trial([20], 20, handover=10)
    figure, _ = plots.plot_rewards(trial, short, {"warm": trial}, BASELINES, 30)
    assert "thesis: fall at 30" in lines(figure.axes[0])
    assert "thesis: fall at 30" not in lines(figure.axes[1])
    figure, _ = plots.plot_rewards(trial, short, {"warm": trial}, BASELINES, 15)
    assert "thesis: fall at 15" in lines(figure.axes[1])
