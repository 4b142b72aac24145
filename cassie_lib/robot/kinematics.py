"""Inverse kinematics with closed four-bar loops and springs at rest."""

from __future__ import annotations

import functools
from typing import NamedTuple

import mujoco
import numpy as np

from cassie_lib.errors import ParameterError
from cassie_lib.robot.model import load_model, nominal_qpos

_SIDES = ("left", "right")
#: Spring joints that the kinematics hold at rest.
_SPRINGS = tuple(f"{side}-{part}" for side in _SIDES for part in ("shin", "heel-spring"))
#: Joints that the 49-component state leaves out; the loops determine them.
_UNSEEN = tuple(
    f"{side}-{part}"
    for side in _SIDES
    for part in ("achilles-rod", "heel-spring", "foot-crank", "plantar-rod")
)


class FootTarget(NamedTuple):
    """Where one sole should be.

    Attributes:
        position: Midpoint of the foot capsule in the world frame, ``(3,)`` m.
        pitch: Rise of the toe over the heel, divided by the foot's length.
        yaw: Sideways lead of the toe over the heel, divided by the foot's length.
    """

    position: np.ndarray
    pitch: float = 0.0
    yaw: float = 0.0


class LegKinematics:
    """Gauss-Newton on the configuration manifold of the whole robot.

    Free are the driven joints, the tarsi, the rods and cranks; the pelvis is given and the
    springs are at rest.  The minimum-norm step leaves the achilles rods' spin about their own
    axis, which costs nothing, where it is.
    """

    def __init__(self) -> None:
        self.model = load_model()
        self.data = mujoco.MjData(self.model)
        model = self.model
        fixed = set(range(6))
        fixed.update(int(model.joint(name).dofadr[0]) for name in _SPRINGS)
        self._free = np.array([dof for dof in range(model.nv) if dof not in fixed])
        self._spring_qpos = np.array([int(model.joint(name).qposadr[0]) for name in _SPRINGS])
        driven = [
            int(model.joint(f"{side}-{part}").dofadr[0])
            for side in _SIDES
            for part in ("hip-roll", "hip-yaw", "hip-pitch", "knee", "foot")
        ]
        self._passive = np.array([dof for dof in self._free if dof not in driven])
        self._unseen = np.array([dof for name in _UNSEEN for dof in self._dofs(name)])

    def loop_error(self, qpos: np.ndarray) -> np.ndarray:
        """Gaps of the four loop closures at ``qpos (35,)``, in m, shape ``(12,)``."""
        self._forward(qpos)
        return self._loops()[0]

    def close_loops(self, qpos: np.ndarray) -> np.ndarray:
        """Move the undriven joints only, until the loops close; springs are set to rest.

        Args:
            qpos: Configuration ``(35,)`` near the wanted one.

        Returns:
            Configuration ``(35,)`` with loop gaps under 1e-10 m.

        Raises:
            ParameterError: If the loops cannot be closed from there.
        """
        return self._solve(self._at_rest(qpos), (), self._passive)

    def complete(self, qpos: np.ndarray, gap_m: float = 0.02) -> np.ndarray:
        """Move only the joints that a state does not hold: rods, heel springs and cranks.

        The other joints, shin springs included, stay as given.  A predicted state may be one that
        no robot can take: then the loops are closed as well as they can be.

        Args:
            qpos: Configuration ``(35,)`` whose rods, heel springs and cranks are a first guess.
            gap_m: Largest gap that may remain, in m.

        Returns:
            Configuration ``(35,)``.

        Raises:
            ParameterError: If a larger gap remains.
        """
        return self._solve(np.array(qpos, dtype=float), (), self._unseen, 60, gap_m)

    def place_feet(self, qpos: np.ndarray, feet: tuple[FootTarget, FootTarget]) -> np.ndarray:
        """Bring both soles to their targets with the pelvis where ``qpos`` has it.

        Args:
            qpos: Configuration ``(35,)`` that gives the pelvis and a starting guess for the legs.
            feet: Targets of the left and right foot.

        Returns:
            Configuration ``(35,)``, loops closed, springs at rest.

        Raises:
            ParameterError: If a target is out of reach.
        """
        return self._solve(self._at_rest(qpos), feet, self._free)

    def _at_rest(self, qpos: np.ndarray) -> np.ndarray:
        qpos = np.array(qpos, dtype=float)
        qpos[self._spring_qpos] = 0.0
        return qpos

    def _dofs(self, name: str) -> range:
        joint = self.model.joint(name)
        first = int(joint.dofadr[0])
        return range(first, first + (3 if joint.type[0] == mujoco.mjtJoint.mjJNT_BALL else 1))

    def _forward(self, qpos: np.ndarray) -> None:
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_makeConstraint(self.model, self.data)

    def _loops(self) -> tuple[np.ndarray, np.ndarray]:
        count = 3 * self.model.neq
        jacobian = self.data.efc_J.reshape(-1, self.model.nv)[:count]
        return self.data.efc_pos[:count].copy(), jacobian

    def _foot(self, side: str, target: FootTarget) -> tuple[np.ndarray, np.ndarray]:
        points, jacobians = [], []
        for end in ("heel", "toe"):
            site = self.model.site(f"{side}-{end}").id
            jacobian = np.zeros((3, self.model.nv))
            mujoco.mj_jacSite(self.model, self.data, jacobian, None, site)
            points.append(self.data.site_xpos[site].copy())
            jacobians.append(jacobian)
        along, along_jacobian = points[1] - points[0], jacobians[1] - jacobians[0]
        length = np.linalg.norm(along)
        error = np.concatenate(
            [
                (points[0] + points[1]) / 2 - target.position,
                [along[2] - target.pitch * length, along[1] - target.yaw * length],
            ]
        )
        jacobian = np.vstack([(jacobians[0] + jacobians[1]) / 2, along_jacobian[[2, 1]]])
        return error, jacobian

    def _solve(self, qpos, feet, free, iterations: int = 60, tolerance_m=1e-9) -> np.ndarray:
        for _ in range(iterations):
            self._forward(qpos)
            rows = [self._loops()]
            rows += [self._foot(side, target) for side, target in zip(_SIDES, feet, strict=False)]
            error = np.concatenate([row[0] for row in rows])
            if np.abs(error).max() < 1e-11:
                return qpos
            jacobian = np.vstack([row[1] for row in rows])[:, free]
            step = np.zeros(self.model.nv)
            # The cut-off removes the spin of the rods and the planar loops' redundant row.
            step[free] = -np.linalg.lstsq(jacobian, error, rcond=1e-6)[0]
            step *= min(1.0, 0.5 / max(np.abs(step).max(), 1e-12))
            mujoco.mj_integratePos(self.model, qpos, step, 1.0)
        if np.abs(error).max() < tolerance_m:
            return qpos
        raise ParameterError(
            f"inverse kinematics stopped {np.abs(error).max():.2e} m from its targets: expected "
            "feet within reach of the pelvis and loops that can close"
        )


@functools.cache
def standing_qpos() -> tuple[float, ...]:
    """Neutral standing configuration with its loops closed: the pose of s0, Appendix A.3.

    The published one leaves gaps of up to 6 mm, which the constraint solver would close with a
    jolt in the first step.
    """
    return tuple(LegKinematics().close_loops(nominal_qpos()))
