"""N robots at once on ``mujoco.rollout``: one action is held for one control period of 0.03 s."""

from __future__ import annotations

import copy
import os
import warnings
from typing import NamedTuple

import mujoco
import mujoco.rollout
import numpy as np

from cassie_lib.errors import ParameterError, ShapeError
from cassie_lib.robot import model as robot
from cassie_lib.robot.kinematics import standing_qpos
from cassie_lib.robot.schema import ACTION_SIZE, GRAVITY, PERIOD
from cassie_lib.robot.state import extract_state
from cassie_lib.simulator_checks import (
    check_actions,
    check_clock,
    check_indices,
    check_models,
    check_rows,
)

#: Pelvis heights (m) between which a robot counts as upright.
UPRIGHT_M = (0.4, 3.0)
#: Phase and commanded speed of s0, Appendix A.3.
S0_PHASE = 14
S0_SPEED_MPS = 0.0509
_ACCELERATION = slice(0, 3)
_SOLES = slice(3, 15)  # left heel, left toe, right heel, right toe
_FORCES = slice(15, 21)
#: Beyond this no joint of the real robot moves (rad/s, m/s): the integration has diverged.
_DIVERGED = 1e3
#: Attributes of the simulator that a snapshot holds, in its order.
_SNAPSHOT = ("physics", "_sensors", "_force", "phase", "speed", "fallen")


class Snapshot(NamedTuple):
    """Everything that the future of a simulation depends on; see :meth:`Simulator.snapshot`."""

    physics: np.ndarray
    sensors: np.ndarray
    force: np.ndarray
    phase: np.ndarray
    speed: np.ndarray
    fallen: np.ndarray


class Simulator:
    """Batched, threaded simulation of Cassie with the PD drive inside the physics step.

    Each control step starts from a cold solver, so the next state depends on the physics state
    and the action alone: the same call gives the same bits on one machine, whatever came before
    and however many threads run.

    Attributes:
        count: Number of robots N.
        timestep_s: Physics step (s): 0.0005 for every reported number, 0.002 for training.
        physics: Full physics state ``(N, 68)``: time (s), qpos (35), qvel (32).
        phase: Phase of the clock ``(N,)``, 0..27.
        speed: Commanded forward speed ``(N,)``, m/s.
        fallen: Whether the pelvis has left :data:`UPRIGHT_M` since the last reset, ``(N,)``.
            A fallen robot stays where it fell until it is reset.
    """

    def __init__(
        self,
        count: int,
        timestep_s: float = 0.0005,
        threads: int | None = None,
        models: list[mujoco.MjModel] | None = None,
    ) -> None:
        """Make N robots and reset them to s0.

        Args:
            count: Number of robots.
            timestep_s: Physics step in s, a divisor of 0.03 s.
            threads: Worker threads; default one per core.
            models: One model per robot (dynamics randomisation); default the same for all.

        Raises:
            ParameterError: If ``count`` or the timestep is out of range.
            ShapeError: If ``models`` does not hold N models of the same sizes.
        """
        if count < 1:
            raise ParameterError(f"count = {count}: expected at least 1 robot")
        self.count, self.timestep_s = int(count), timestep_s
        self._substeps = robot.substeps(timestep_s)
        if models is not None:
            check_models(models, self.count)
            models = [copy.copy(model) for model in models]  # the caller's keep their time step
        self.model = models[0] if models else robot.load_model(timestep_s)
        self._models = models or [self.model] * count
        for model in self._models:
            model.opt.timestep = timestep_s
            # MuJoCo would silently reset a diverged robot to its initial pose.
            model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        threads = max(1, min(threads or os.cpu_count() or 1, count))
        self._pool = mujoco.rollout.Rollout(nthread=threads)
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]
        self.physics = np.zeros((count, robot.PHYSICS_SIZE))
        self._sensors = np.zeros((count, self.model.nsensordata))
        # Results of the physics steps of one control step, overwritten by the next one.
        self._trajectory = np.zeros((count, self._substeps, robot.PHYSICS_SIZE))
        self._readings = np.zeros((count, self._substeps, self.model.nsensordata))
        self._controls = np.zeros((count, self._substeps, ACTION_SIZE))
        self._force = np.zeros((count, 2, 3))
        self.phase, self.speed = np.zeros(count, dtype=int), np.zeros(count)
        self.fallen = np.zeros(count, dtype=bool)
        self._push, self._push_steps = np.zeros((count, 3)), np.zeros(count, dtype=int)
        self.reset()

    # -- reading ---------------------------------------------------------------------------------
    @property
    def qpos(self) -> np.ndarray:
        """Positions ``(N, 35)``, a view on :attr:`physics`."""
        return self.physics[:, 1:36]

    @property
    def qvel(self) -> np.ndarray:
        """Velocities ``(N, 32)``, a view on :attr:`physics`."""
        return self.physics[:, 36:68]

    @property
    def states(self) -> np.ndarray:
        """States ``(N, 49)`` of Table 4.1; the acceleration is that of the last physics step."""
        acceleration = self._sensors[:, _ACCELERATION] - [0.0, 0.0, GRAVITY]
        return extract_state(self.qpos, self.qvel, acceleration, self.phase, self.speed)

    @property
    def pelvis_position(self) -> np.ndarray:
        """Pelvis in the world frame, ``(N, 3)`` m."""
        return self.qpos[:, :3].copy()

    @property
    def foot_position(self) -> np.ndarray:
        """Middle of the soles (left, right) in the world frame, ``(N, 2, 3)`` m."""
        return self._sensors[:, _SOLES].reshape(-1, 2, 2, 3).mean(axis=2)

    @property
    def foot_height(self) -> np.ndarray:
        """Height of the lowest point of each sole over the floor, ``(N, 2)`` m."""
        lowest = self._sensors[:, _SOLES].reshape(-1, 2, 2, 3)[..., 2].min(axis=2)
        return lowest - robot.FOOT_RADIUS_M - robot.FLOOR_HEIGHT_M

    @property
    def foot_force(self) -> np.ndarray:
        """Ground reaction on each foot, world frame, mean over the last control step, (N,2,3) N."""
        return self._force.copy()

    # -- changing --------------------------------------------------------------------------------
    def reset(
        self, indices=None, *, qpos=None, qvel=None, phase=S0_PHASE, speed=S0_SPEED_MPS
    ) -> None:
        """Put robots into a configuration, by default s0 of Appendix A.3.

        The published height in A.3 (0.805 m) is that of a state estimator: with the published
        joint angles the soles would be 0.2 m under the floor.  Here the pelvis is at 1.01 m and
        the soles 12 mm over the floor, so that the first sample is in free fall as in A.3.

        Args:
            indices: Robots to reset; default all.
            qpos: ``(35,)`` or ``(n, 35)``; default the standing pose with closed loops.
            qvel: ``(32,)`` or ``(n, 32)``; default zero.
            phase: Phase of the clock, scalar or ``(n,)``.
            speed: Commanded forward speed in m/s, scalar or ``(n,)``.

        Raises:
            NonFiniteError: If a position, velocity or speed is not finite.
            ShapeError: If one has another shape.
            ParameterError: If a robot does not exist or a phase is no whole number.
        """
        indices = check_indices(indices, self.count)
        count = len(indices)
        if count == 0:
            return
        check_clock(phase, speed, count)
        start = np.zeros((count, robot.PHYSICS_SIZE))
        start[:, 1:36] = check_rows("qpos", standing_qpos() if qpos is None else qpos, 35, count)
        start[:, 36:68] = check_rows("qvel", np.zeros(32) if qvel is None else qvel, 32, count)
        self.physics[indices] = start
        self.phase[indices] = np.asarray(phase) % PERIOD
        self.speed[indices] = speed
        self.fallen[indices] = False
        self._push_steps[indices] = 0
        # The first physics step evaluates the sensors at the start; its result is not kept.
        _, sensors = self._rollout(indices, np.zeros((count, ACTION_SIZE)), steps=1)
        self._sensors[indices] = sensors[:, 0]
        self._force[indices] = sensors[:, 0, _FORCES].reshape(-1, 2, 3)

    def step(self, actions) -> None:
        """Hold one action per robot for 0.03 s and advance the clock.

        Args:
            actions: ``(N, 10)`` offsets of the PD targets from the neutral pose, rad.

        Raises:
            ShapeError: If ``actions`` has another shape.
            NonFiniteError: If an action is NaN or infinite.
        """
        actions = check_actions(actions, self.count)
        moving = np.flatnonzero(~self.fallen)
        if len(moving):
            self._advance(moving, actions[moving])
        self.phase = (self.phase + 1) % PERIOD
        self._push_steps = np.maximum(self._push_steps - 1, 0)

    def push(self, impulse, steps: int = 4, indices=None) -> None:
        """Push the pelvis with a constant force over the next control steps.

        Args:
            impulse: ``(3,)`` or ``(n, 3)`` N s in the world frame.
            steps: Control steps over which it is spread; 4 are 0.12 s.
            indices: Robots to push; default all.

        Raises:
            ParameterError: If ``steps`` is under 1 or a robot does not exist.
            ShapeError, NonFiniteError: If the impulse is not of that shape or not finite.
        """
        if steps < 1:
            raise ParameterError(f"steps = {steps}: expected at least 1 control step")
        indices = check_indices(indices, self.count)
        duration = steps * self._substeps * self.timestep_s
        self._push[indices] = check_rows("impulse", impulse, 3, len(indices)) / duration
        self._push_steps[indices] = steps

    def snapshot(self) -> Snapshot:
        """Copy of everything that the future depends on (pushes under way excepted)."""
        return Snapshot(*(np.copy(getattr(self, name)) for name in _SNAPSHOT))

    def restore(self, snapshot: Snapshot) -> None:
        """Return to a :meth:`snapshot` of as many robots.

        Raises:
            ShapeError: If the snapshot holds another number of robots.
        """
        if snapshot.physics.shape != self.physics.shape:
            raise ShapeError(f"snapshot has {len(snapshot.physics)} robots: expected {self.count}")
        for name, part in zip(_SNAPSHOT, snapshot, strict=True):
            setattr(self, name, np.copy(part))
        self._push_steps[:] = 0

    # -- physics ---------------------------------------------------------------------------------
    def _rollout(self, indices, actions, steps: int) -> tuple[np.ndarray, np.ndarray]:
        count, spec = len(indices), mujoco.mjtState.mjSTATE_CTRL
        controls = self._controls[:count]
        pushed = self._push_steps[indices] > 0
        if pushed.any():
            # mjSTATE order: controls come before applied forces; body 1 is the pelvis.
            spec |= mujoco.mjtState.mjSTATE_XFRC_APPLIED
            forces = np.zeros((count, self.model.nbody, 6))
            forces[:, 1, :3] = self._push[indices] * pushed[:, None]
            actions = np.concatenate([actions, forces.reshape(count, -1)], axis=1)
            controls = np.empty((count, self._substeps, actions.shape[1]))
        controls[:] = actions[:, None]
        whole = steps == self._substeps
        return self._pool.rollout(
            [self._models[i] for i in indices],
            self._data,
            self.physics[indices],
            controls[:, :steps],
            control_spec=int(spec),
            nstep=steps,
            state=self._trajectory[:count] if whole else None,
            sensordata=self._readings[:count] if whole else None,
            chunk_size=1,  # larger chunks leave a thread without work at the end
            # The checks ask every model for its sizes, each time; the constructor has done so.
            skip_checks=whole,
        )

    def _advance(self, moving: np.ndarray, actions: np.ndarray) -> None:
        trajectory, sensors = self._rollout(moving, actions, self._substeps)
        physics = trajectory[:, -1]
        good = np.isfinite(physics).all(axis=1) & (np.abs(physics[:, 36:]) < _DIVERGED).all(axis=1)
        if not good.all():
            warnings.warn(
                f"physics diverged for robot(s) {moving[~good].tolist()}: counted as falls",
                RuntimeWarning,
                stacklevel=3,
            )
        kept = moving[good]
        self.physics[kept] = physics[good]
        self._sensors[kept] = sensors[good, -1]
        # The mean, in a third of the time of ndarray.mean and with the same bits.
        force = np.einsum("nks->ns", sensors[..., _FORCES]) / self._substeps
        self._force[kept] = force[good].reshape(-1, 2, 3)
        height = physics[good, 3]
        self.fallen[moving[~good]] = True
        self.fallen[kept] = (height <= UPRIGHT_M[0]) | (height >= UPRIGHT_M[1])
