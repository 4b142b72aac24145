"""Figures of notebook 08: rounds in order, errors on whose states, videos that end together."""

from __future__ import annotations

from types import SimpleNamespace

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from recording_toys import lines, saved, toy_trial

from cassie_lib.dagger import to_transitions
from cassie_lib.dynamics.evaluation import open_loop
from cassie_lib.figures import bootstrap_interval, write_plotted_data
from cassie_lib.plots import dagger as plots

mpl.use("agg")
HANDOVER, STEPS = 8, 60


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


def trial(planner_steps, seed=0):
    return toy_trial(HANDOVER + np.asarray(planner_steps), STEPS, handover=HANDOVER, seed=seed)


class Still:
    """Predicts that nothing changes."""

    def __init__(self, context=4):
        self.context = context

    def predict(self, history, actions):
        """The present state for ever."""
        return history.states[:, None, -1:].expand(*actions.shape[:3], -1)


@pytest.fixture
def walks():
    return [trial([10 * index, 10 * index + 4, 52], seed=index) for index in range(5)]


@pytest.mark.parametrize(("count", "rounds"), [(5, [0, 1, 2, 4]), (3, [0, 1, 2]), (2, [0, 1]),
                                               (1, [0])])  # fmt: skip
def test_panels_are_rounds_0_1_2_and_the_last(walks, count, rounds):
    figure, data = plots.plot_round_rewards(walks[:count], {"pi*": 0.97}, 50)
    assert list(data) == [f"round {index}" for index in rounds]
    assert len(figure.axes) == len(rounds)
    for axes, index in zip(figure.axes, rounds, strict=True):
        assert axes.get_title().startswith(f"round {index}: median of {10 * index + 4:g} ")
        drawn = lines(axes)["median, while half are upright"][1]
        np.testing.assert_array_equal(drawn, data[f"round {index}"]["median"])
        fallen = HANDOVER + np.array([10 * index, 10 * index + 4])
        assert lines(axes)["fall of a seed"][0].tolist() == fallen.tolist()
        assert axes.get_xlim()[1] >= STEPS


def test_rounds_without_a_trial_have_no_panel(walks):
    figure, data = plots.plot_round_rewards([walks[0], None, walks[2]], {"pi*": 0.97}, 50)
    assert list(data) == ["round 0", "round 2"]
    assert [axes.get_title()[:7] for axes in figure.axes] == ["round 0", "round 2"]


def test_errors_on_planner_states_are_over_the_variance_of_the_expert():
    trials = [trial([40, 52]), trial([40, 52])]
    # The second planner strays twice as far from its gait as the first.
    states = trials[1].recording.states
    states[..., :46] *= 2.0
    expert = to_transitions(trial([52] * 4, seed=7).recording)
    found = plots.planner_errors([Still(), Still()], trials, expert, 3)
    own = open_loop(Still(), expert, 3).relative[-1]
    np.testing.assert_allclose(found["expert states"], [own, own], rtol=1e-6)
    assert found["planner states"][1] == pytest.approx(4 * found["planner states"][0], rel=1e-4)


def test_errors_on_planner_states_begin_with_the_planners_first_action(monkeypatch):
    begun = []

    def noted(recorded, begin):
        begun.append(begin)
        return to_transitions(recorded, begin)

    monkeypatch.setattr(plots, "to_transitions", noted)
    expert = to_transitions(trial([52] * 2).recording)
    plots.planner_errors([Still(4), Still(HANDOVER + 5)], [trial([52])] * 2, expert, 3)
    # Present of the first window: begin + H - 1, which is the hand-over.
    assert begun == [HANDOVER - 3, 0]


def test_a_round_whose_episodes_are_too_short_has_no_error():
    expert = to_transitions(trial([52] * 2).recording)
    found = plots.planner_errors([Still(), Still()], [trial([1]), trial([52])], expert, 5)
    assert np.isnan(found["planner states"]).tolist() == [True, False]
    assert np.isfinite(found["expert states"]).all()


def test_progress_draws_medians_intervals_and_errors(walks, tmp_path):
    runs = {"keep": walks[:3], "decay": walks[:2]}
    errors = {
        "expert states": np.array([0.1, 0.2, 0.3]),
        "planner states": np.array([9, 4, np.nan]),
    }
    rounds = [
        SimpleNamespace(index=i, report={"relative_error": {"round": {
            "before": [0.0, 1.0 * i], "after": [0.0, 0.5 * i]}}})
        for i in (1, 2)
    ]  # fmt: skip
    zero = {"decay": [trial([2, 3, 9]), None]}
    figure, data = plots.plot_progress(runs, {"keep": errors}, {"keep": rounds}, 155, zero)
    left, middle, right = figure.axes
    assert data["keep"]["median"].tolist() == [4, 14, 24]
    bounds = np.array([bootstrap_interval(found.planner_steps) for found in walks[:3]]).T
    np.testing.assert_array_equal((data["keep"]["low"], data["keep"]["high"]), bounds)
    drawn = {box.get_label(): box for box in left.containers}
    np.testing.assert_array_equal(drawn["keep"].lines[0].get_ydata(), [4, 14, 24])
    np.testing.assert_array_equal(drawn["keep"].lines[0].get_xdata(), [0, 1, 2])
    assert (np.array(drawn["decay"].lines[0].get_xdata()) > [0, 1]).all(), "beside each other"
    dotted = left.containers[-1].lines[0]
    assert (dotted.get_ydata().tolist(), data["decay, zero mean"]["median"].tolist()) == ([3], [3])
    assert dotted.get_color() == drawn["decay"].lines[0].get_color(), "the same run"
    assert dotted.get_linestyle() != drawn["decay"].lines[0].get_linestyle()
    assert left.get_ylim()[0] <= 2, "the worst seed is within the picture"
    caps = [line.get_ydata() for line in drawn["keep"].lines[1]]
    np.testing.assert_allclose(caps, bounds)
    assert lines(left)["thesis (total)"] == ([2], [155])
    for curve, values in zip(middle.get_lines(), errors.values(), strict=False):
        np.testing.assert_array_equal(curve.get_ydata(), values)
    before, after = right.get_lines()[:2]
    assert before.get_ydata().tolist() == [1.0, 2.0]
    assert after.get_ydata().tolist() == [0.5, 1.0]
    # Colour tells the run, the line whose states or when; the same colour in every panel.
    assert before.get_color() == after.get_color() == middle.get_lines()[0].get_color()
    assert before.get_color() == drawn["keep"].lines[0].get_color()
    assert [text.get_text() for text in right.get_legend().get_texts()] == ["before", "after"]
    assert [text.get_text() for text in middle.get_legend().get_texts()] == ["expert", "planner"]
    found = saved(write_plotted_data(tmp_path, "f", data))
    assert found["keep"]["median"] == [4, 14, 24]
    assert found["round's data, after retraining, keep"]["relative_error"] == [0.5, 1.0]


def test_videos_end_together_at_the_shortest_and_the_longest_episode(monkeypatch):
    def coded(qpos, width, height):
        frames = np.zeros((len(qpos), height, width, 3), np.uint8)
        frames[...] = qpos[:, None, None, :3]
        return frames, "coded"

    monkeypatch.setattr(plots, "pictures", coded)
    left, right = trial([30, 3, 9]), trial([20, 52])
    assert plots.longest(right) == 1
    frames = plots.side_by_side(left, right, steps=20, stride=2, size=4)
    assert frames.shape == (10, 4, 8, 3)
    assert frames.dtype == np.uint8
    rows = frames[:, 0, :, 1]
    # Episode 1 on both sides; the short one (it falls at 11) waits at its start.
    assert (frames[:, 0, [0, 4], 0] == 1).all()
    assert rows[:, 0].tolist() == [1, 1, 1, 1, 1, 3, 5, 7, 9, 11]
    assert rows[:, 4].tolist() == list(range(42, 61, 2))
