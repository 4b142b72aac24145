"""A user's own recorded trajectory in the open 2 kHz ``stepdata`` format as a gait reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cassie_lib.errors import TrajectoryError
from cassie_lib.gait import PERIOD_S, GaitReference
from cassie_lib.robot import model as robot
from cassie_lib.robot.rendering import body_positions
from cassie_lib.robot.schema import PERIOD

#: One row: time, 35 positions, 32 velocities, 10 torques, 10 motor positions, 10 velocities.
COLUMNS = 98
_RATE_HZ = 2000
_ROWS_PER_STEP = 60
_CONTACT_HEIGHT_M = 0.005
#: Where the quaternions begin among the 35 positions.
_QUATERNIONS = {"pelvis": 3, "left achilles rod": 10, "right achilles rod": 24}


def _read(path: Path) -> np.ndarray:
    try:
        raw = Path(path).read_bytes()
    except OSError as error:
        raise TrajectoryError(
            f"{path} cannot be read ({error.strerror}): expected a file"
        ) from error
    width = 8 * COLUMNS
    if len(raw) == 0 or len(raw) % width:
        raise TrajectoryError(
            f"{path} has {len(raw)} bytes: expected rows of {COLUMNS} little-endian doubles"
        )
    rows = np.frombuffer(raw, dtype="<f8").reshape(-1, COLUMNS)
    if not np.isfinite(rows).all():
        raise TrajectoryError(f"{path} holds a value that is not finite: expected finite doubles")
    return rows


def load_stepdata(path: Path) -> GaitReference:
    """Read one cycle of a recorded motion.

    Args:
        path: Binary file of 1,680 rows or one more (28 control steps at 2 kHz), 98 doubles each.

    Returns:
        The reference, sampled at the 28 phases of the clock.

    Raises:
        TrajectoryError: If the file is unreadable or of another shape, rate or period, or if a
            value is not finite or a quaternion not of unit length.
    """
    rows = _read(path)
    expected = PERIOD * _ROWS_PER_STEP
    if len(rows) not in (expected, expected + 1):
        raise TrajectoryError(
            f"{path} has {len(rows)} rows: expected {expected} ({PERIOD_S} s at {_RATE_HZ} Hz)"
        )
    step = np.diff(rows[:, 0])
    if np.abs(step - 1.0 / _RATE_HZ).max() > 1e-5:
        raise TrajectoryError(
            f"{path} has time steps of {step.min():g} to {step.max():g} s: expected {1 / _RATE_HZ}"
        )
    for name, begin in _QUATERNIONS.items():
        norm = np.linalg.norm(rows[:, 1 + begin : 5 + begin], axis=1)
        if np.abs(norm - 1.0).max() > 1e-3:
            raise TrajectoryError(
                f"{path} has a quaternion of the {name} of length "
                f"{norm[np.abs(norm - 1).argmax()]:g}: expected 1"
            )
    sampled = rows[:expected:_ROWS_PER_STEP]
    qpos, qvel = sampled[:, 1:36].copy(), sampled[:, 36:68].copy()
    height = np.array(
        [
            [
                chain[-2:, 2].min() - robot.FOOT_RADIUS_M - robot.FLOOR_HEIGHT_M
                for chain in body_positions(row).values()
            ]
            for row in qpos
        ]
    )
    speed = (rows[expected - 1, 1] - rows[0, 1]) / (rows[expected - 1, 0] - rows[0, 0])
    return GaitReference(
        Path(path).stem, float(speed), qpos, qvel, height, height < _CONTACT_HEIGHT_M
    )
