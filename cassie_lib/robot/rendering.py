"""Pictures of Cassie: OpenGL where there is a context, a drawn skeleton where there is none."""

from __future__ import annotations

import functools
import os

import mujoco
import numpy as np

from cassie_lib.errors import RenderingError, ShapeError
from cassie_lib.robot.meshes import description_folder, load_mesh_model
from cassie_lib.robot.model import FLOOR_HEIGHT_M, load_model

#: Environment variable that forces the skeleton, for machines whose OpenGL hangs.
SKELETON_VARIABLE = "CASSIE_SKELETON"
#: Bodies whose origins make the stick figure of one leg, hip to foot.
_CHAIN = ("hip-roll", "hip-pitch", "knee", "shin", "tarsus", "foot")
_COLOURS = {"left": "#0072B2", "right": "#D55E00"}


@functools.cache
def _looks() -> mujoco.MjModel:
    return load_mesh_model() if description_folder() else load_model()


def _check(qpos) -> np.ndarray:
    qpos = np.atleast_2d(np.asarray(qpos, dtype=float))
    if qpos.ndim != 2 or qpos.shape[1] != 35:
        raise ShapeError(f"qpos has shape {qpos.shape}: expected (T, 35)")
    return qpos


def render(
    qpos,
    *,
    ghost=None,
    width: int = 640,
    height: int = 480,
    distance_m: float = 2.6,
    azimuth_deg: float = 125.0,
    elevation_deg: float = -10.0,
) -> np.ndarray:
    """Render configurations with OpenGL; the camera follows the pelvis.

    Args:
        qpos: ``(T, 35)`` configurations.
        ghost: ``(T, 35)`` of a second, translucent robot, or None.
        width: Picture width, pixels.
        height: Picture height, pixels.
        distance_m: Distance of the camera from the robot's middle.
        azimuth_deg: Direction of view about the vertical; 90 looks along +y.
        elevation_deg: Negative looks down.

    Returns:
        ``(T, height, width, 3)`` uint8.

    Raises:
        ShapeError: If ``qpos`` or ``ghost`` has another shape.
        RenderingError: If no OpenGL context is to be had.
    """
    qpos = _check(qpos)
    ghost = None if ghost is None else _check(ghost)
    model = _looks()
    if os.environ.get(SKELETON_VARIABLE):
        raise RenderingError(f"{SKELETON_VARIABLE} is set: expected it unset for OpenGL pictures")
    try:
        renderer = mujoco.Renderer(model, height, width)
    except Exception as error:
        raise RenderingError(
            f"no OpenGL context ({type(error).__name__}): expected MUJOCO_GL=egl or osmesa on a "
            "machine without a screen"
        ) from error
    data, other, option = mujoco.MjData(model), mujoco.MjData(model), mujoco.MjvOption()
    camera = mujoco.MjvCamera()
    camera.distance, camera.azimuth, camera.elevation = distance_m, azimuth_deg, elevation_deg
    frames = np.empty((len(qpos), height, width, 3), dtype=np.uint8)
    with renderer:
        for index, configuration in enumerate(qpos):
            data.qpos[:] = configuration
            mujoco.mj_forward(model, data)
            camera.lookat[:] = (*configuration[:2], 0.55)
            renderer.update_scene(data, camera)
            if ghost is not None:
                _add_ghost(renderer.scene, model, other, option, ghost[index])
            frames[index] = renderer.render()
    return frames


def _add_ghost(scene, model, data, option, configuration) -> None:
    data.qpos[:] = configuration
    mujoco.mj_forward(model, data)
    first = scene.ngeom
    mujoco.mjv_addGeoms(
        model, data, option, mujoco.MjvPerturb(), mujoco.mjtCatBit.mjCAT_DYNAMIC, scene
    )
    for index in range(first, scene.ngeom):
        if scene.geoms[index].rgba[3] > 0.0:
            scene.geoms[index].rgba[:] = (0.84, 0.37, 0.0, 0.45)


def body_positions(qpos) -> dict[str, np.ndarray]:
    """World positions of the leg joints and soles, for stick figures.

    Args:
        qpos: ``(35,)``.

    Returns:
        ``{"left": (n, 3), "right": (n, 3)}`` from the pelvis down to the toe, in m.
    """
    model = load_model()
    data = mujoco.MjData(model)
    data.qpos[:] = _check(qpos)[0]
    mujoco.mj_kinematics(model, data)
    chains = {}
    for side in ("left", "right"):
        points = [data.body("cassie-pelvis").xpos]
        points += [data.body(f"{side}-{part}").xpos for part in _CHAIN]
        points += [data.site(f"{side}-{end}").xpos for end in ("heel", "toe")]
        chains[side] = np.array(points)
    return chains


def draw_skeleton(axes, qpos, alpha: float = 1.0, offset_m: float = 0.0) -> None:
    """Draw a side view as a stick figure.

    Args:
        axes: Matplotlib axes.
        qpos: ``(35,)``.
        alpha: Opacity.
        offset_m: Horizontal shift, to set poses side by side.
    """
    for side, points in body_positions(qpos).items():
        axes.plot(
            points[:, 0] + offset_m,
            points[:, 2] - FLOOR_HEIGHT_M,
            "-o",
            ms=2.5,
            lw=1.8,
            color=_COLOURS[side],
            alpha=alpha,
            solid_capstyle="round",
        )
    axes.axhline(0.0, color="0.6", lw=0.8, zorder=0)
    axes.set_aspect("equal")


def skeleton_frames(qpos, ghost=None, width: int = 640, height: int = 480) -> np.ndarray:
    """The stick figure as pictures ``(T, height, width, 3)`` uint8, for machines without GL.

    Args:
        qpos: ``(T, 35)``.
        ghost: ``(T, 35)`` of a second, paler robot, or None.
        width: Picture width, pixels.
        height: Picture height, pixels.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    del matplotlib
    frames = []
    ghost = None if ghost is None else _check(ghost)
    for index, configuration in enumerate(_check(qpos)):
        figure = Figure(figsize=(width / 100, height / 100), dpi=100)
        canvas = FigureCanvasAgg(figure)
        axes = figure.add_subplot()
        draw_skeleton(axes, configuration)
        if ghost is not None:
            draw_skeleton(axes, ghost[index], alpha=0.35)
        axes.set_xlim(configuration[0] - 0.8, configuration[0] + 0.8)
        axes.set_ylim(-0.1, 1.3)
        axes.set_xlabel("x (m)")
        axes.set_ylabel("height over the floor (m)")
        canvas.draw()
        frames.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
    return np.stack(frames)


def pictures(qpos, **options) -> tuple[np.ndarray, str]:
    """Pictures by OpenGL or, where there is none, as stick figures.

    Args:
        qpos: ``(T, 35)``.
        **options: As for :func:`render`.

    Returns:
        Frames ``(T, height, width, 3)`` uint8 and a word on how they were made, for the caption.
    """
    try:
        return render(qpos, **options), "rendered by MuJoCo"
    except RenderingError as error:
        size = {key: options[key] for key in ("ghost", "width", "height") if key in options}
        return skeleton_frames(qpos, **size), f"stick figure, because {error}"
