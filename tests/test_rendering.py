"""Pictures of the robot: with OpenGL where there is a context, as a stick figure where not."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest

from cassie_lib import gait
from cassie_lib.errors import RenderingError, ShapeError
from cassie_lib.robot import rendering
from cassie_lib.robot.kinematics import standing_qpos
from cassie_lib.robot.model import FLOOR_HEIGHT_M

mpl.use("agg")
SIZE = {"width": 96, "height": 80}
#: Heel and toe are middles of round ends, so high over the lowest point of a sole.
RADIUS_M = 0.02


@pytest.fixture(scope="module")
def standing():
    return np.array(standing_qpos())


@pytest.fixture(scope="module")
def shown(standing):
    """One picture by OpenGL; skips where there is no context."""
    try:
        return rendering.render(standing, **SIZE)[0]
    except RenderingError as error:
        pytest.skip(str(error))


def moved(qpos, **changes):
    found = np.array(qpos)
    for index, value in changes.items():
        found[int(index[1:])] += value
    return found


def test_stick_figure_stands_on_the_floor_and_is_symmetric(standing):
    chains = rendering.body_positions(standing)
    left, right = chains["left"], chains["right"]
    assert left.shape == right.shape == (9, 3)
    np.testing.assert_allclose(left * [1, -1, 1], right, atol=1e-6)
    np.testing.assert_array_equal(left[0], standing[:3])
    # Heel and toe are the last two points; the robot is about to touch down.
    np.testing.assert_allclose(left[-2:, 2] - RADIUS_M, FLOOR_HEIGHT_M, atol=0.015)
    assert (np.diff(left[:3, 2]) <= 0.1).all()


def test_stick_figure_moves_with_the_pelvis(standing):
    chains = rendering.body_positions(moved(standing, q0=0.3, q2=0.2))
    before = rendering.body_positions(standing)
    for side in ("left", "right"):
        np.testing.assert_allclose(chains[side] - before[side], np.tile([0.3, 0, 0.2], (9, 1)),
                                   atol=1e-9)  # fmt: skip


def test_feet_of_the_stick_figure_rise_as_the_reference_says():
    walk = gait.walk(0.5)
    for phase in range(0, 28, 5):
        chains = rendering.body_positions(walk.qpos[phase])
        for index, side in enumerate(("left", "right")):
            sole = chains[side][-2:, 2].min() - RADIUS_M - FLOOR_HEIGHT_M
            assert sole == pytest.approx(walk.foot_height_m[phase, index], abs=1e-6)


def test_drawn_skeleton_is_the_side_view_over_the_floor(standing):
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    rendering.draw_skeleton(axes, standing, offset_m=1.5)
    for line, points in zip(axes.get_lines(), rendering.body_positions(standing).values(),
                            strict=False):  # fmt: skip
        np.testing.assert_allclose(line.get_xdata(), points[:, 0] + 1.5)
        np.testing.assert_allclose(line.get_ydata(), points[:, 2] - FLOOR_HEIGHT_M)


def test_without_opengl_the_caption_says_so(standing, monkeypatch):
    monkeypatch.setenv(rendering.SKELETON_VARIABLE, "1")
    with pytest.raises(RenderingError, match="CASSIE_SKELETON is set"):
        rendering.render(standing, **SIZE)
    motion = np.stack([standing, moved(standing, q2=0.2)])
    frames, how = rendering.pictures(motion, ghost=motion[::-1], azimuth_deg=90.0, **SIZE)
    assert how.startswith("stick figure, because CASSIE_SKELETON is set")
    assert frames.shape == (2, 80, 96, 3)
    assert frames.dtype == np.uint8
    assert (frames[0] != frames[1]).any()
    plain, _ = rendering.pictures(motion, **SIZE)
    assert (plain[0] != frames[0]).any(), "the ghost is drawn, too"


def test_a_failing_context_is_a_typed_error(standing, monkeypatch):
    def fail(*_):
        raise RuntimeError("no display")

    monkeypatch.delenv(rendering.SKELETON_VARIABLE, raising=False)
    monkeypatch.setattr(rendering.mujoco, "Renderer", fail)
    with pytest.raises(RenderingError, match=r"no OpenGL context \(RuntimeError\)"):
        rendering.render(standing)


@pytest.mark.parametrize("bad", [np.zeros(34), np.zeros((2, 2, 35)), np.zeros((3, 49))])
def test_bad_configurations_are_refused(bad, standing):
    for make in (rendering.render, rendering.skeleton_frames, rendering.pictures):
        with pytest.raises(ShapeError, match=r"expected \(T, 35\)"):
            make(bad)
        with pytest.raises(ShapeError, match=r"expected \(T, 35\)"):
            make(standing, ghost=bad)


def test_pictures_by_opengl_show_pose_ghost_and_side(shown, standing):
    assert shown.shape == (80, 96, 3)
    pose = moved(standing, q7=0.3)
    ghosts = np.stack([standing, pose])
    frames = rendering.render(np.stack([standing, standing]), ghost=ghosts, **SIZE)
    alone = rendering.render(np.stack([standing, pose]), **SIZE)
    np.testing.assert_array_equal(alone[0], shown)
    assert (alone[1] != shown).any()
    assert (frames[1] != shown).any()
    # The ghost is orange: it adds red, not blue.
    extra = frames[1].astype(int) - shown
    assert extra[..., 0].sum() > extra[..., 2].sum()
    side = rendering.render(standing, azimuth_deg=90.0, **SIZE)[0]
    assert (side != shown).any()
    frames, how = rendering.pictures(standing, **SIZE)
    assert how == "rendered by MuJoCo"
    np.testing.assert_array_equal(frames[0], shown)
