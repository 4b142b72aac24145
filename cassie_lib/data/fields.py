"""What is recorded: one array per field, with its unit and frame."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass

from cassie_lib.robot import schema


@dataclass(frozen=True)
class Field:
    """One recorded quantity, stored as ``<name>.npy``.

    Attributes:
        name: Name of the array.
        dtype: NumPy type, little-endian.
        shape: Shape of one row.
        unit: SI unit.
        frame: Frame of reference, empty when there is none.
        text: What it is.
        per_episode: One row per episode instead of one per control step.
    """

    name: str
    dtype: str
    shape: tuple[int, ...]
    unit: str
    frame: str
    text: str
    per_episode: bool = False


_MIXED = "m, rad, m/s, rad/s, m/s^2: see schema"
_STATE_FRAME = "linear velocity and acceleration: world; angular velocity: pelvis"

SAMPLE_FIELDS = (
    Field("states", "<f4", (schema.STATE_SIZE,), _MIXED, _STATE_FRAME,
          "state s_t of Table 4.1 at which the action was applied"),
    Field("actions", "<f4", (schema.ACTION_SIZE,), "rad", "joint",
          "executed action, noise included: offset of the PD target, held for one control step"),
    Field("mean_actions", "<f4", (schema.ACTION_SIZE,), "rad", "joint",
          "what the controller asked for, before the noise"),
    Field("phase", "|u1", (), "control steps", "", "phase of the gait clock, 0..27"),
    Field("pelvis_position", "<f4", (3,), "m", "world", "pelvis; the state holds z only"),
    Field("foot_position", "<f4", (2, 3), "m", "world", "middle of the soles, left and right"),
    Field("foot_height", "<f4", (2,), "m", "world",
          "lowest point of each sole over the floor, left and right"),
    Field("foot_force", "<f4", (2, 3), "N", "world",
          "ground reaction on each foot, mean over the control step that led to the state; "
          "at s0 that of the first physics step"),
    Field("falling", "|b1", (), "", "",
          "whether the sample is among the last 28 before a fall"),
)  # fmt: skip
EPISODE_FIELDS = (
    Field("episode_starts", "<i8", (), "control steps", "",
          "row of each episode's first sample", True),
    Field("episode_end", "|u1", (), "", "",
          "why it ended: 0 time limit, 1 fall, 2 cut because enough had been collected", True),
    Field("final_states", "<f4", (schema.STATE_SIZE,), _MIXED, _STATE_FRAME,
          "state after the last action", True),
    Field("noise_std_rad", "<f8", (), "rad", "joint",
          "standard deviation of the action noise", True),
)  # fmt: skip
FIELDS = SAMPLE_FIELDS + EPISODE_FIELDS
SAMPLE_NAMES = tuple(field.name for field in SAMPLE_FIELDS)
EPISODE_NAMES = tuple(field.name for field in EPISODE_FIELDS)


def schema_card() -> dict:
    """Components of a state with units and derivative orders, and a digest of them."""
    components = [
        {"index": c.index, "name": c.name, "unit": c.unit, "order": c.order}
        for c in schema.COMPONENTS
    ]
    content = {
        "components": components,
        "motors": list(schema.MOTOR_NAMES),
        "clock": f"sin, cos of 2 pi phase / {schema.CLOCK_DIVISOR}, phase 0..{schema.PERIOD - 1}",
    }
    text = json.dumps(content, sort_keys=True)
    return {"digest": hashlib.sha256(text.encode()).hexdigest(), **content}
