"""The real STL meshes of Cassie, from the optional package ``example-robot-data``."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import mujoco

from cassie_lib import paths
from cassie_lib.errors import RenderingError

_PACKAGE = "example-robot-data"
_GREY = (0.30, 0.32, 0.35, 1.0)


def description_folder() -> Path | None:
    """Folder of the package's Cassie description, or None when it is not installed."""
    try:
        files = importlib.metadata.files(_PACKAGE) or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        if file.match("cassie_description/robots/cassie_v2.sdf"):
            return Path(str(file.locate())).resolve().parent.parent
    return None


def load_mesh_model() -> mujoco.MjModel:
    """Compile the robot with its real looks; masses, joints and contacts are unchanged.

    Raises:
        RenderingError: If the package with the meshes is not installed.
    """
    folder = description_folder()
    if folder is None:
        raise RenderingError(
            f"package {_PACKAGE} is not installed: expected the extra `meshes` of this project"
        )
    spec = mujoco.MjSpec.from_file(str(paths.ROBOT_XML))
    for body in spec.bodies:
        side, _, part = body.name.partition("-")
        mesh = folder / "meshes" / f"{part}.stl"
        if not mesh.exists():
            continue
        for geom in body.geoms:
            geom.material, geom.rgba = "", (0, 0, 0, 0)
        # The right leg's frames are the left ones' reflections in z.
        spec.add_mesh(
            name=body.name,
            file=str(mesh),
            scale=(1, 1, -1 if side == "right" else 1),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=body.name,
            contype=0,
            conaffinity=0,
            mass=0,
            rgba=_GREY,
        )
    return spec.compile()
