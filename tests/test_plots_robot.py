"""Figures of notebook 01: the state table, the drive, the reference gait and its reward."""

from __future__ import annotations

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from recording_toys import lines

from cassie_lib import gait
from cassie_lib.errors import ParameterError
from cassie_lib.physics_checks import TimestepComparison, pd_step_response
from cassie_lib.plots import robot as plots
from cassie_lib.reward import WEIGHTS
from cassie_lib.robot.kinematics import standing_qpos
from cassie_lib.robot.model import neutral_pose
from cassie_lib.robot.schema import (
    CLOCK,
    MOTOR_NAMES,
    MOTOR_POSITION,
    PELVIS_VELOCITY,
    PERIOD,
    SPEED,
    clock,
    mirror_action,
)

mpl.use("agg")


@pytest.fixture(autouse=True)
def close():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def response():
    return pd_step_response(0.2, 0.5)


@pytest.fixture(scope="module")
def walk():
    return gait.walk(0.5)


def test_state_table_covers_all_49_components_once():
    table = plots.state_table()
    bounds = [tuple(map(int, row.strip("[]").split(", "))) for row in table.index]
    assert [i for first, last in bounds for i in range(first, last + 1)] == list(range(49))
    labels = [len(of.split(", ")) for of in table["of"]]
    assert labels == [last - first + 1 for first, last in bounds]


def test_robot_is_shown_from_three_sides(monkeypatch):
    seen = []

    def coded(qpos, *, azimuth_deg, width, height, distance_m):
        seen.append(azimuth_deg)
        return np.full((1, height, width, 3), len(seen), np.uint8), "coded"

    monkeypatch.setattr(plots, "pictures", coded)
    figure, data, how = plots.plot_robot(standing_qpos())
    assert dict(zip([axes.get_title() for axes in figure.axes], seen, strict=True)) == {
        "oblique": 125.0, "side": 90.0, "front": 180.0,
    }  # fmt: skip
    assert [axes.images[0].get_array().max() for axes in figure.axes] == [1, 2, 3]
    assert data["qpos"].shape == (35,)
    assert how == "coded"


def test_drive_follows_a_step_without_leaving_its_limits(response):
    before = response.time_s < 0.05
    np.testing.assert_allclose(response.target_rad[:, before], 0.0)
    # The legs step to opposite sides, so that they do not meet.
    step = response.target_rad[:, -1]
    np.testing.assert_allclose(step, mirror_action(step))
    np.testing.assert_allclose(np.abs(step), 0.2)
    np.testing.assert_allclose(response.position_rad[:, -1], step, atol=0.04)
    assert (np.abs(response.torque_Nm) <= response.limit_Nm[:, None] + 1e-9).all()
    left, right = response.position_rad[:5], response.position_rad[5:]
    mirrored = mirror_action(response.position_rad.T).T[5:]
    # The neutral pose is not quite mirrored: the right hip starts 0.009 rad from it.
    np.testing.assert_allclose(right, mirrored, atol=0.01)
    assert np.abs(left[:, before]).max() < 1e-3, "nothing pulls on the test stand"
    with pytest.raises(ParameterError, match=r"duration_s = 0\.05: expected more than 0\.05 s"):
        pd_step_response(0.2, 0.05)


def test_drive_figure_has_left_leg_over_right_and_torque_under_angle(response):
    figure, data = plots.plot_pd_tracking(response)
    axes = np.array(figure.axes).reshape(4, 5)
    for motor, name in enumerate(MOTOR_NAMES):
        side, column = divmod(motor, 5)
        angle, torque = axes[2 * side, column], axes[2 * side + 1, column]
        assert angle.get_title() == name
        target, position = (line.get_ydata() for line in angle.get_lines())
        np.testing.assert_array_equal(target, response.target_rad[motor])
        np.testing.assert_array_equal(position, response.position_rad[motor])
        np.testing.assert_array_equal(torque.get_lines()[0].get_ydata(), response.torque_Nm[motor])
        assert f"{response.limit_Nm[motor]:g}" in torque.texts[0].get_text()
        # Every tenth sample is saved.
        np.testing.assert_array_equal(data[name]["position_rad"], position[::10])


def test_reference_is_drawn_as_offsets_and_closes_after_a_cycle(walk):
    figure, data = plots.plot_reference(walk)
    strip, left, right, feet = figure.axes
    for side, axes in enumerate((left, right)):
        drawn = lines(axes)
        assert len(drawn) == 5
        for joint in range(5):
            motor = 5 * side + joint
            phases, offset = drawn[MOTOR_NAMES[joint][5:]]
            assert phases.tolist() == list(range(PERIOD + 1))
            angle = offset + neutral_pose()[motor]
            np.testing.assert_allclose(angle[:-1], walk.motor_position[:, motor])
            assert offset[-1] == offset[0]
            np.testing.assert_array_equal(data[f"{MOTOR_NAMES[motor]}_offset_rad"], offset)
    for index, side in enumerate(("left", "right")):
        height = lines(feet)[side][1]
        np.testing.assert_array_equal(height[:-1], walk.foot_height_m[:, index])
        np.testing.assert_array_equal(data[f"{side}_foot_height_m"], height)
    assert [text.get_text() for text in strip.texts] == [f"phase {p}" for p in range(0, 28, 4)]


def test_states_along_the_reference_are_those_of_the_gait(walk):
    states = plots.reference_states(walk)
    assert states.shape == (PERIOD, 49)
    np.testing.assert_allclose(states[:, CLOCK], clock(np.arange(PERIOD)))
    np.testing.assert_allclose(states[:, SPEED], 0.5)
    np.testing.assert_allclose(states[:, MOTOR_POSITION], walk.motor_position, atol=1e-9)
    assert states[:, PELVIS_VELOCITY][:, 0].mean() == pytest.approx(0.5, abs=0.01)


def test_reward_bars_are_stacked_to_the_total(walk):
    figure, data, total = plots.plot_reward_terms(walk)
    bars = figure.axes[0].containers
    assert len(bars) == len(WEIGHTS)
    tops = np.array([[bar.get_y() + bar.get_height() for bar in term] for term in bars])
    np.testing.assert_allclose(tops[-1], total)
    for (name, weight), term in zip(WEIGHTS.items(), bars, strict=True):
        heights = np.array([bar.get_height() for bar in term])
        np.testing.assert_allclose(heights, data[name], atol=1e-12)
        assert (heights <= weight + 1e-12).all()
        assert f"{weight:g}" in term.get_label()
    np.testing.assert_allclose(sum(data[name] for name in WEIGHTS), data["total"])
    # The reference hits its own angles exactly.
    np.testing.assert_allclose(data["motor"], WEIGHTS["motor"])


def test_timesteps_are_compared_in_millimetres():
    fine = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.1], [0.0, 0.0, 1.2]])
    coarse = fine + [[0.0, 0.0, 0.0], [0.003, 0.004, 0.0], [0.0, 0.0, 0.02]]
    comparison = TimestepComparison(np.array([0.0, 0.03, 0.06]), fine, coarse)
    figure, data = plots.plot_timesteps(comparison)
    left, right = figure.axes
    np.testing.assert_array_equal(lines(left)["0.5 ms"][1], fine[:, 2])
    np.testing.assert_array_equal(lines(left)["2 ms"][1], coarse[:, 2])
    np.testing.assert_allclose(right.get_lines()[0].get_ydata(), [0.0, 5.0, 20.0], atol=1e-9)
    np.testing.assert_allclose(data["distance_m"], [0.0, 0.005, 0.02], atol=1e-12)
