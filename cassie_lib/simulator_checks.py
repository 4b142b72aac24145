"""What the simulator refuses: each check raises or does nothing, and none changes a result."""

from __future__ import annotations

import mujoco
import numpy as np

from cassie_lib.errors import NonFiniteError, ParameterError, ShapeError
from cassie_lib.robot.schema import ACTION_SIZE

_SIZES = ("nq", "nv", "na", "nu", "nbody", "nsensordata")


def _sizes(model: mujoco.MjModel) -> str:
    return ", ".join(f"{name} = {getattr(model, name)}" for name in _SIZES)


def check_models(models: list[mujoco.MjModel], count: int) -> None:
    """One model per robot, all of the same sizes.

    ``mujoco.rollout`` would read past the end of an array: its own checks are off.

    Raises:
        ShapeError: If there are others.
    """
    if len(models) != count:
        raise ShapeError(f"models has {len(models)} entries: expected one per robot, {count}")
    expected = _sizes(models[0])
    for i, model in enumerate(models):
        if (found := _sizes(model)) != expected:
            raise ShapeError(f"models[{i}] has {found}: expected {expected} as models[0]")


def check_indices(indices, count: int) -> np.ndarray:
    """Numbers of robots as an array; None is all of them.

    Raises:
        ParameterError: If one is no robot.
    """
    if indices is None:
        return np.arange(count)
    found = np.atleast_1d(indices)
    if found.size and not (found.dtype.kind in "iu" and 0 <= found.min() <= found.max() < count):
        raise ParameterError(f"indices = {found.tolist()}: expected robots 0 to {count - 1}")
    return found.astype(int)


def check_rows(name: str, value, width: int, count: int) -> np.ndarray:
    """``(width,)`` or ``(count, width)`` finite numbers.

    Raises:
        ShapeError: If they have another shape.
        NonFiniteError: If one is NaN or infinite.
    """
    found = np.asarray(value, dtype=float)
    if found.shape not in ((width,), (count, width)):
        raise ShapeError(f"{name} has shape {found.shape}: expected {(width,)} or {(count, width)}")
    if not np.isfinite(found).all():
        raise NonFiniteError(f"{name} holds {found[~np.isfinite(found)][0]}: expected finite")
    return found


def check_clock(phase, speed, count: int) -> None:
    """Whole phases and finite speeds, one for all or one for each.

    Raises:
        ShapeError: If there are more or fewer than robots.
        ParameterError: If a phase is no whole number.
        NonFiniteError: If a speed is NaN or infinite.
    """
    for name, value in {"phase": np.asarray(phase), "speed": np.asarray(speed)}.items():
        if value.shape not in ((), (count,)):
            raise ShapeError(f"{name} has shape {value.shape}: expected () or {(count,)}")
    whole = np.asarray(phase, dtype=float)
    if not (np.isfinite(whole).all() and (whole == np.round(whole)).all()):
        raise ParameterError(f"phase = {phase}: expected whole numbers, 0 to 27")
    if not np.isfinite(np.asarray(speed, dtype=float)).all():
        raise NonFiniteError(f"speed = {speed}: expected finite m/s")


def check_actions(actions, count: int) -> np.ndarray:
    """Actions as ``(count, 10)`` floats.

    Raises:
        ShapeError: If they have another shape.
        NonFiniteError: If one is NaN or infinite.
    """
    found = np.asarray(actions, dtype=float)
    if found.shape != (count, ACTION_SIZE):
        raise ShapeError(f"actions have shape {found.shape}: expected {(count, ACTION_SIZE)}")
    if not np.isfinite(found).all():
        row, column = np.argwhere(~np.isfinite(found))[0]
        raise NonFiniteError(
            f"action[{row}, {column}] = {found[row, column]}: expected a finite angle in rad"
        )
    return found


__all__ = ["check_actions", "check_clock", "check_indices", "check_models", "check_rows"]
