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
    """Lowest point of each sole over the floor, from states of Table 4.1.

    Both legs are one chain of L links, computed side by side: many small products in a row are
    what a planner waits for.
    """

    def __init__(self) -> None:
        """Read the chain of bodies between pelvis and soles from the robot's model."""
        model = robot.load_model()
        links, points = zip(*(_chain(model, side) for side in _SIDES), strict=True)
        # From (side, link, quantity) to one array (link, side, ...) of each quantity.
        offsets, turns, indices, zeros = (
            np.stack([np.stack([link[part] for link in chain]) for chain in links], axis=1)
            for part in range(4)
        )
        self._offset = torch.as_tensor(offsets, dtype=torch.float32)  # (L, 2, 3)
        self._turn = torch.as_tensor(turns, dtype=torch.float32)  # (L, 2, 3, 3)
        self._index = torch.as_tensor(indices)  # (L, 2)
        self._zero = torch.as_tensor(zeros, dtype=torch.float32)  # (L, 2)
        self._points = torch.as_tensor(np.stack(points), dtype=torch.float32)  # (2, ends, 3)
        self._below = robot.FOOT_RADIUS_M + robot.FLOOR_HEIGHT_M

    def __call__(self, states: Tensor) -> Tensor:
        """Heights of left and right sole.

        Args:
            states: ``(..., 49)``; the orientation need not be of exactly unit length.

        Returns:
            ``(..., 2)`` m, differentiable in the states.
        """
        quaternion = states[..., PELVIS_ORIENTATION]
        row = rotation_row(quaternion / quaternion.norm(dim=-1, keepdim=True))[..., None, :]
        height = states[..., PELVIS_HEIGHT] - self._below
        angles = states[..., self._index] - self._zero
        cos, sin = angles.cos(), angles.sin()
        # Only the row of each rotation that gives heights is carried down the chain.
        for link in range(len(self._index)):
            height = height + (row * self._offset[link]).sum(dim=-1)
            row = (row[..., None, :] @ self._turn[link])[..., 0, :]
            # All joints turn about the z axis of their body.
            x, y, z = row.unbind(-1)
            c, s = cos[..., link, :], sin[..., link, :]
            row = torch.stack([x * c + y * s, y * c - x * s, z], dim=-1)
        ends = (row[..., None, :] * self._points).sum(dim=-1)
        return height + ends.amin(dim=-1)


def _chain(model: mujoco.MjModel, side: str) -> tuple:
    """Links from the pelvis down: offset ``(3,)``, turn ``(3, 3)``, state index and zero angle."""
    ends = [model.site(f"{side}-{end}") for end in _ENDS]
    body, links = int(ends[0].bodyid[0]), []
    while model.body(body).name != "cassie-pelvis":
        joint = model.joint(int(model.body_jntadr[body]))
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_quat[body])
        zero = float(model.qpos0[joint.qposadr[0]])
        links.append((model.body_pos[body], turn.reshape(3, 3), _state_index(joint.name), zero))
        body = int(model.body_parentid[body])
    return links[::-1], np.stack([end.pos for end in ends])


def _state_index(joint: str) -> int:
    """Where a joint's angle is in the state."""
    if joint in MOTOR_NAMES:
        return MOTOR_POSITION.start + MOTOR_NAMES.index(joint)
    return JOINT_POSITION.start + JOINT_NAMES.index(joint)
