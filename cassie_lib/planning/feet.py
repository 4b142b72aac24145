"""Height of the soles in predicted states: forward kinematics that can be differentiated.

Eq 3.10 hardly tells a step from a shuffle.  The state holds every angle between pelvis and sole
(the springs' deflection included), so foot lift needs no model of its own.
"""

from __future__ import annotations

import mujoco
import numpy as np
import torch
from torch import Tensor

from cassie_lib.robot import model as robot
from cassie_lib.robot.schema import (
    JOINT_NAMES,
    JOINT_POSITION,
    MOTOR_NAMES,
    MOTOR_POSITION,
    PELVIS_HEIGHT,
    PELVIS_ORIENTATION,
)

_SIDES, _ENDS = ("left", "right"), ("heel", "toe")


def rotation_row(quaternion: Tensor) -> Tensor:
    """Third row of the rotation matrix of unit quaternions (w, x, y, z): ``(..., 4) -> (..., 3)``.

    It turns a vector of the body frame into its height in the world frame.
    """
    w, x, y, z = quaternion.unbind(-1)
    return torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=-1)


class SoleHeight:
    """Lowest point of each sole over the floor, from states of Table 4.1."""

    def __init__(self) -> None:
        """Read the chain of bodies between pelvis and soles from the robot's model."""
        model = robot.load_model()
        self._chains = [_chain(model, side) for side in _SIDES]
        self._below = robot.FOOT_RADIUS_M + robot.FLOOR_HEIGHT_M

    def __call__(self, states: Tensor) -> Tensor:
        """Heights of left and right sole.

        Args:
            states: ``(..., 49)``; the orientation need not be of exactly unit length.

        Returns:
            ``(..., 2)`` m, differentiable in the states.
        """
        quaternion = states[..., PELVIS_ORIENTATION]
        row = rotation_row(quaternion / quaternion.norm(dim=-1, keepdim=True))
        pelvis = states[..., PELVIS_HEIGHT.start]
        heights = [pelvis + _lowest(chain, states, row) - self._below for chain in self._chains]
        return torch.stack(heights, dim=-1)


def _chain(model: mujoco.MjModel, side: str) -> tuple:
    """Links from the pelvis down: offset ``(3,)``, turn ``(3, 3)``, state index and zero angle."""
    ends = [model.site(f"{side}-{end}") for end in _ENDS]
    body, links = int(ends[0].bodyid[0]), []
    while model.body(body).name != "cassie-pelvis":
        joint = model.joint(int(model.body_jntadr[body]))
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_quat[body])
        zero = float(model.qpos0[joint.qposadr[0]])
        links.append((
            torch.tensor(model.body_pos[body], dtype=torch.float32),
            torch.tensor(turn.reshape(3, 3), dtype=torch.float32), _state_index(joint.name), zero
        ))  # fmt: skip
        body = int(model.body_parentid[body])
    points = torch.tensor(np.stack([end.pos for end in ends]), dtype=torch.float32)
    return links[::-1], points


def _state_index(joint: str) -> int:
    """Where a joint's angle is in the state."""
    if joint in MOTOR_NAMES:
        return MOTOR_POSITION.start + MOTOR_NAMES.index(joint)
    return JOINT_POSITION.start + JOINT_NAMES.index(joint)


def _lowest(chain: tuple, states: Tensor, row: Tensor) -> Tensor:
    """Height of the lower end of a sole over the pelvis, ``(...)`` m.

    Only the row of the rotation that gives heights is carried down the chain.
    """
    links, points = chain
    height = torch.zeros_like(row[..., 0])
    for offset, turn, index, zero in links:
        height = height + row @ offset
        row = row @ turn
        angle = states[..., index] - zero
        cos, sin = angle.cos(), angle.sin()
        # All joints turn about the z axis of their body.
        row = torch.stack([row[..., 0] * cos + row[..., 1] * sin,
                           row[..., 1] * cos - row[..., 0] * sin, row[..., 2]], dim=-1)  # fmt: skip
    return (height[..., None] + row @ points.T).amin(dim=-1)
