"""Numbers and figures of notebooks 03 and 04 on data whose answers are known."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
from data_toys import toy_episodes

from cassie_lib.data import Episodes
from cassie_lib.dynamics.evaluation import open_loop
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.errors import DataError, ParameterError
from cassie_lib.pipeline import as_transitions
from cassie_lib.plots import data as plots
from cassie_lib.plots import data_statistics as statistics
from cassie_lib.plots import mlp
from cassie_lib.plots.mean_gait import MeanGait
from cassie_lib.robot.schema import CLOCK, PERIOD, PHYSICAL, clock

mpl.use("agg")


def gait_episodes(spread: float, seed: int = 0, length: int = 140, count: int = 4) -> Episodes:
    """A periodic gait with white noise around it, the same gait for every seed."""
    toy = toy_episodes([length] * count)
    phase = np.asarray(toy.phase)
    gait = np.random.default_rng(99).normal(size=(PERIOD, 49))
    noise = np.random.default_rng(seed).normal(0.0, spread, (len(toy), 49))
    arrays = {name: getattr(toy, name) for name in vars(toy)}
    states = (gait[phase] + noise).astype(np.float32)
    states[:, 1:5] = [1.0, 0.0, 0.0, 0.0]
    states[:, CLOCK] = clock(phase)
    return Episodes(**{**arrays, "states": states})


@pytest.mark.parametrize(
    ("hits", "trials", "low", "high"), [(0, 302, 0.0, 0.0126), (5, 10, 0.237, 0.763)]
)
def test_wilson_interval_matches_published_values(hits, trials, low, high):
    found = statistics.wilson_interval(hits, trials)
    np.testing.assert_allclose(found, (low, high), atol=5e-4)
    with pytest.raises(ParameterError, match="11 hits of 10"):
        statistics.wilson_interval(11, 10)


def test_settled_leaves_out_the_start_and_the_fall():
    episodes = toy_episodes([100, 100, 20], [False, True, True])
    mask = statistics.settled(episodes)
    assert mask[:100].sum() == 100 - statistics.SETTLED
    assert mask[100:200].sum() == 100 - statistics.SETTLED - 28
    assert mask[200:].sum() == 0
    # Where nothing settles all counts, so that a test run has something to draw.
    assert statistics.settled(toy_episodes([20], [True])).all()


def test_foot_paths_do_not_depend_on_heading_or_place():
    rng = np.random.default_rng(0)
    toy = toy_episodes([50])
    arrays = {name: getattr(toy, name).copy() for name in vars(toy) if name != "card"}
    arrays["states"][:, 1:5] = [1.0, 0.0, 0.0, 0.0]
    arrays["foot_position"][:] = rng.normal(size=(50, 2, 3))
    before = statistics.foot_paths(Episodes(**arrays))
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    arrays["states"][:, 1:5] = [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]
    arrays["foot_position"][..., :2] = arrays["foot_position"][..., :2] @ turn.T + [3.0, -2.0]
    arrays["pelvis_position"][:, :2] = [3.0, -2.0]
    np.testing.assert_allclose(statistics.foot_paths(Episodes(**arrays)), before, atol=1e-5)


def test_path_spread_of_known_noise():
    rng = np.random.default_rng(0)
    phase = rng.integers(0, PERIOD, 20_000)
    mean = rng.normal(size=(PERIOD, 2, 3))
    paths = mean[phase] + rng.normal(0.0, 0.01, (20_000, 2, 3))
    # Three components of 10 mm each.
    np.testing.assert_allclose(statistics.path_spread(paths, phase), 0.01 * np.sqrt(3), rtol=0.02)
    np.testing.assert_allclose(statistics.path_spread(mean[phase], phase), 0.0, atol=1e-12)


def test_distance_from_the_mean_gait_is_one_inside_and_scales_with_noise():
    train = gait_episodes(0.1)
    cloud = statistics.GaitCloud(train)
    own = cloud.distance(train)
    # Orientation does not vary here, hence the 42 of 46 components.
    np.testing.assert_allclose(np.sqrt(np.mean(own**2)), np.sqrt(42 / 46), rtol=1e-5)
    wide, narrow = gait_episodes(0.3, seed=1), gait_episodes(0.03, seed=2)
    assert cloud.outside(wide, own) == 1.0
    assert cloud.outside(narrow, own) == 0.0
    groups = cloud.group_distance(wide)
    assert len(groups) == 9
    np.testing.assert_allclose(groups["motor position"], 3.0, rtol=0.15)


def test_projection_explains_and_coordinates_are_centred():
    train = gait_episodes(0.1)
    projection = statistics.fit_projection(train.states)
    assert np.all(np.diff(projection.explained) <= 0)
    coordinates = projection(np.asarray(train.states))
    np.testing.assert_allclose(coordinates.mean(axis=0), 0.0, atol=1e-6)
    np.testing.assert_allclose(projection.axes @ projection.axes.T, np.eye(3), atol=1e-10)
    noisy = projection(np.asarray(gait_episodes(1.0, seed=3).states))
    few, many = (statistics.occupied_cells(c, 500) for c in (coordinates, noisy))
    assert few < many <= 500


def test_mean_gait_predicts_the_gait_and_nothing_else():
    train = as_transitions(gait_episodes(0.1))
    model = MeanGait(train)
    quiet = open_loop(model, as_transitions(gait_episodes(0.0)), horizon=5, windows=50, context=3)
    noisy = open_loop(model, as_transitions(gait_episodes(0.2, seed=5)), horizon=5, windows=400)
    assert quiet.relative.max() < 1e-2
    # Its error is the noise itself, at every step the same.
    motor = np.sqrt(noisy.model[:, 5:15].mean(axis=1))
    np.testing.assert_allclose(motor, 0.2, rtol=0.15)
    few = as_transitions(toy_episodes([5]))
    np.testing.assert_allclose(MeanGait(few).table[20], few.states.mean(axis=0))


def test_no_change_costs_one_in_units_of_the_training_differences():
    train = as_transitions(gait_episodes(0.1))
    result = open_loop(MeanGait(train), train, horizon=1, windows=len(train))
    loss = mlp.no_change_loss(result, Normalisation.from_transitions(train))
    # 42 varying components of 49, each with a mean difference near zero.
    np.testing.assert_allclose(loss, 42 / 49, rtol=0.01)
    assert PHYSICAL.stop == 46


def test_curves_are_read_by_metric_and_other_files_refused(tmp_path):
    path = tmp_path / "timing_log.csv"
    path.write_text("epoch,step,seconds,metric,value\n0,5,1.0,a/b,2.0\n1,10,2.0,a/b,1.0\n")
    epochs, values = mlp.read_curves(path)["a/b"]
    assert epochs.tolist() == [1, 2]
    assert values.tolist() == [2.0, 1.0]
    path.write_text("something,else\n1,2\n")
    with pytest.raises(DataError, match="expected a training log"):
        mlp.read_curves(path)
    with pytest.raises(DataError, match="missing.csv"):
        mlp.read_curves(tmp_path / "missing.csv")


def test_every_figure_comes_with_its_data_and_units_on_its_axes():
    sets = {"wide": gait_episodes(0.5, 1), "train": gait_episodes(0.2), "test": gait_episodes(0.1)}
    study = sets["train"]
    train = as_transitions(sets["train"])
    errors = {
        name: {"mean gait": open_loop(MeanGait(train), as_transitions(sets[name]), 3, 40)}
        for name in ("train", "test")
    }
    epochs = np.arange(1, 4)
    curves = {
        f"{name}/state_prediction": (epochs, 1.0 / epochs)
        for name in ("train", "validation", "test")
    }
    still = dict.fromkeys(("train", "validation", "test"), 1.0)
    drawn = [
        plots.plot_noise(statistics.noise_levels(study), study, [0.0]),
        plots.plot_coverage(statistics.fit_projection(study.states), sets, points=100),
        plots.plot_shift({"a": (study, sets["test"]), "b": (study, sets["wide"])}),
        mlp.plot_single_step([curves, curves], still),
        mlp.plot_curriculum(curves, {"test": epochs}, {"test": epochs}),
        mlp.plot_group_errors(errors),
    ]
    for figure, data in drawn:
        assert data
        for axes in figure.axes:
            assert axes.get_xlabel()
        mpl.pyplot.close(figure)
    figure, data = plots.draw_pipeline()
    assert data["from"][0] == "s0"
    table = mlp.error_table(errors["test"]["mean gait"], errors["test"]["mean gait"], 3)
    assert table.count("\n") == 2 + 9
