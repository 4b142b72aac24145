"""Models with other masses, centres of mass, dampings and friction, for robust training."""

from __future__ import annotations

import mujoco
import numpy as np

from cassie_lib.errors import ParameterError
from cassie_lib.robot.model import load_model


def randomised_models(count: int, spread: float, rng: np.random.Generator) -> list[mujoco.MjModel]:
    """Draw models around the nominal one.

    Args:
        count: Number of models.
        spread: Relative half-width of the uniform factors on each body's mass and inertia, each
            joint's damping and the floor's friction; the pelvis's centre of mass moves by up to
            ``spread * 0.1`` m along each axis.
        rng: Source of the draws.

    Returns:
        ``count`` models of the same sizes.

    Raises:
        ParameterError: If ``spread`` is outside [0, 1).
    """
    if not 0.0 <= spread < 1.0:
        raise ParameterError(f"spread = {spread}: expected 0 <= spread < 1")
    models = []
    for _ in range(count):
        model = load_model()
        mass = rng.uniform(1.0 - spread, 1.0 + spread, model.nbody)
        model.body_mass *= mass
        model.body_inertia *= mass[:, None]
        model.body_ipos[1] += rng.uniform(-0.1 * spread, 0.1 * spread, 3)
        model.dof_damping *= rng.uniform(1.0 - spread, 1.0 + spread, model.nv)
        model.geom_friction[:, 0] *= rng.uniform(1.0 - spread, 1.0 + spread)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        models.append(model)
    return models
