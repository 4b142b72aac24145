"""PD targets with which a reference gait carries its weight: inverse dynamics of the cycle.

A PD drive holds a load only by lagging behind its target, by 0.45 rad at the hip roll and 0.9 rad
at the knee of the standing leg, and its damping acts against the reference's own velocity.  Plans
that begin at the reference's joint angles must find all of that anew at every control step; plans
that begin here need corrections only.  Nothing learned goes in: neither policy nor model.
"""

from __future__ import annotations

import mujoco
import numpy as np

from cassie_lib.gait import GaitReference
from cassie_lib.robot.model import gains, load_model, motor_qvel, neutral_pose
from cassie_lib.robot.schema import ACTION_SIZE, CONTROL_PERIOD_S, GRAVITY, PERIOD

_SIDES = ("left", "right")
_SPRINGS = tuple(f"{side}-{part}" for side in _SIDES for part in ("shin", "heel-spring"))
_BASE = 6  # degrees of freedom of the pelvis
#: Sizes of the unknowns, so that the least-squares solution spreads them by what is usual: motor
#: torques (N m), forces in the loops (N), forces under a foot that carries everything (N).
_TORQUE, _LOOP, _CONTACT = 10.0, 300.0, 300.0
_REGULARISATION = 1e-4


def feedforward_cycle(reference: GaitReference) -> np.ndarray:
    """Actions by phase whose PD torques drive the reference along its path.

    With the inverse dynamics' torque tau and the deflected pose q, the target is ``q + (tau +
    kd dq/dt) / kp``, averaged over the two ends of the control step that holds it.

    Args:
        reference: Gait of which one foot at least carries load at every phase.

    Returns:
        ``(28, 10)`` rad: entry p is the action taken at phase p.
    """
    dynamics = _InverseDynamics()
    share = load_share(reference.in_contact)
    acceleration = np.roll(reference.qvel, -1, axis=0) - np.roll(reference.qvel, 1, axis=0)
    acceleration /= 2.0 * CONTROL_PERIOD_S
    kp, kd = gains()
    target = np.empty((PERIOD, ACTION_SIZE))
    for phase in range(PERIOD):
        qpos, qvel = reference.qpos[phase], reference.qvel[phase]
        torque, deflection = dynamics.solve(qpos, qvel, acceleration[phase], share[phase])
        lag = (torque + kd * qvel[motor_qvel()]) / kp
        target[phase] = reference.motor_position[phase] + deflection + lag
    return 0.5 * (target + np.roll(target, -1, axis=0)) - neutral_pose()


def load_share(in_contact: np.ndarray) -> np.ndarray:
    """Share of the weight on the left foot; it moves linearly while both feet are down.

    Args:
        in_contact: ``(28, 2)`` booleans, left and right.  A phase of flight counts as both.

    Returns:
        ``(28,)``, 0 to 1.
    """
    left, right = np.asarray(in_contact, dtype=bool).T
    shared = left == right
    share = np.where(shared, 0.5, left.astype(float))
    if shared.all() or not shared.any():
        return share
    phases = np.arange(PERIOD)
    alone = phases[~shared]
    # Continued over the neighbouring cycles, so that a change across phase 0 is linear, too.
    around = np.concatenate([alone - PERIOD, alone, alone + PERIOD])
    return np.interp(phases, around, np.tile(share[alone], 3))


class _InverseDynamics:
    """Torques of the motors and bending of the springs at one instant of a walk."""

    def __init__(self) -> None:
        self.model = load_model()
        self.data = mujoco.MjData(self.model)
        self.springs = np.array([int(self.model.joint(name).dofadr[0]) for name in _SPRINGS])
        joints = [self.model.joint(name).id for name in _SPRINGS]
        self.stiffness = self.model.jnt_stiffness[joints]
        dofs = np.arange(self.model.nv)
        self.stiff = np.setdiff1d(dofs, self.springs)
        self.legs = self.stiff[self.stiff >= _BASE]
        self.motors = np.eye(self.model.nv)[motor_qvel()]

    def solve(self, qpos, qvel, acceleration, left_share) -> tuple[np.ndarray, np.ndarray]:
        """Motor torques and the change of the motors' angles that makes up for the springs.

        Args:
            qpos: ``(35,)``, springs at rest.
            qvel: ``(32,)``.
            acceleration: ``(32,)``; that of the pelvis is not used, see :meth:`_required`.
            left_share: Share of the weight on the left foot.

        Returns:
            ``(10,)`` N m and ``(10,)`` rad.
        """
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, self.data)
        required = self._required(acceleration, left_share)
        loops, soles = self._loops(), self._soles()
        ends = np.repeat([left_share, 1.0 - left_share], len(soles) // 2)
        forces = np.concatenate([self.motors, loops, soles]).T
        size = np.concatenate(
            [np.full(ACTION_SIZE, _TORQUE), np.full(len(loops), _LOOP), _CONTACT * ends]
        )
        matrix = forces[self.stiff] * size
        damped = np.vstack([matrix, _REGULARISATION * np.eye(len(size))])
        wanted = np.concatenate([required[self.stiff], np.zeros(len(size))])
        found = size * np.linalg.lstsq(damped, wanted, rcond=None)[0]
        # What no motor or contact gives on a spring's axis is the torque of the spring.
        spring = required[self.springs] - forces[self.springs] @ found
        return found[:ACTION_SIZE], self._deflection(-spring / self.stiffness, loops, soles)

    def _required(self, acceleration: np.ndarray, left_share: float) -> np.ndarray:
        """Generalised force ``(32,)`` that the motion takes.

        The robot as a whole accelerates sideways as an inverted pendulum over its centre of
        pressure: without that no force under one foot could balance the trunk, because the ankle
        cannot roll.
        """
        model, data = self.model, self.data
        feet = [0.5 * (self._site(side, "heel") + self._site(side, "toe")) for side in _SIDES]
        pressure = left_share * feet[0] + (1.0 - left_share) * feet[1]
        lever = data.subtree_com[1] - pressure
        moving = np.array(acceleration)
        moving[:_BASE] = 0.0
        moving[1] = GRAVITY * lever[1] / lever[2]
        inertial = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, inertial, moving)
        return inertial + data.qfrc_bias

    def _deflection(self, angle: np.ndarray, loops: np.ndarray, soles: np.ndarray) -> np.ndarray:
        """Motor angles ``(10,)`` that keep the soles in place while the springs bend."""
        rows = np.vstack([10.0 * loops, soles])
        change = np.zeros(self.model.nv)
        change[self.legs] = np.linalg.lstsq(
            rows[:, self.legs], -rows[:, self.springs] @ angle, rcond=1e-8
        )[0]
        return change[motor_qvel()]

    def _site(self, side: str, end: str) -> np.ndarray:
        return self.data.site(f"{side}-{end}").xpos

    def _loops(self) -> np.ndarray:
        """Jacobian of the loop closures, ``(12, 32)``; they come first among the constraints."""
        return self.data.efc_J.reshape(-1, self.model.nv)[: 3 * self.model.neq].copy()

    def _soles(self) -> np.ndarray:
        """Jacobian of heels and toes, left before right, ``(12, 32)``."""
        rows = []
        for side in _SIDES:
            for end in ("heel", "toe"):
                row = np.zeros((3, self.model.nv))
                site = self.model.site(f"{side}-{end}").id
                mujoco.mj_jacSite(self.model, self.data, row, None, site)
                rows.append(row)
        return np.concatenate(rows)


__all__ = ["feedforward_cycle", "load_share"]
