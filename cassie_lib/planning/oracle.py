"""The true simulator behind ``predict``: what a planner would reach with a perfect model.

Its gradient is by finite differences of whole rollouts.  An action changes nothing before its own
control step, so the rollout of a perturbed action starts there: T (T + 1) / 2 * 10 control steps
per candidate and gradient with forward differences, twice that with central ones.  At T = 10 that
is 550 control steps, or 33,000 physics steps of 0.5 ms (about 0.4 s a candidate on two cores);
a coarse ``timestep_s`` of 2 ms costs a quarter and is not quite the truth any more.
"""

from __future__ import annotations

import warnings

import numpy as np
import torch

from cassie_lib.dynamics.model import History, check_actions, check_history, phase_of
from cassie_lib.errors import NonFiniteError, ParameterError, ShapeError
from cassie_lib.robot.model import PHYSICS_SIZE
from cassie_lib.robot.schema import (
    ACTION_SIZE,
    CLOCK,
    SPEED,
    STATE_SIZE,
    phase_from_clock,
)
from cassie_lib.simulator import Simulator

#: Rows simulated at once; MuJoCo returns every physics step, 32 kB a row and control step.
MAX_ROWS = 512


class OracleModel:
    """Exact dynamics from ``History.physics``.

    Args:
        context: H that planners should keep, so that the hand-over is that of a learned model.
        timestep_s: Physics step, s; 0.0005 is the truth of every reported number.
        difference_rad: Step of the finite differences.  Wide enough to look past single contacts.
        central: Central instead of forward differences: twice the cost, second order.
        threads: Worker threads; default one per core.

    Raises:
        ParameterError: If the context, the timestep or the step of differences is out of range.
    """

    kind = "oracle"

    def __init__(
        self,
        context: int = 1,
        timestep_s: float = 0.0005,
        difference_rad: float = 1e-3,
        central: bool = False,
        threads: int | None = None,
    ):
        if context < 1:
            raise ParameterError(f"context is {context}: expected at least 1")
        if not 0.0 < difference_rad < 1.0:
            raise ParameterError(f"difference_rad is {difference_rad}: expected 0 to 1 rad")
        self.context, self.timestep_s = context, timestep_s
        self.difference_rad, self.central, self._threads = difference_rad, central, threads
        self._simulator = Simulator(1, timestep_s, threads)
        #: Control steps of single robots simulated so far, gradients included.
        self.control_steps = 0

    @property
    def settings(self) -> dict[str, float | bool]:
        """What decides its predictions and gradients, for recipes of stored results."""
        return {
            "context": self.context,
            "timestep_s": self.timestep_s,
            "difference_rad": self.difference_rad,
            "central": self.central,
        }

    def prepare(self, history: History) -> History:
        """Nothing to prepare: the history itself."""
        return history

    def predict(self, history: History, actions: torch.Tensor) -> torch.Tensor:
        """Simulate ``actions (E, N, T, 10)`` from the physics of the history: ``(E, N, T, 49)``.

        A robot that falls stays where it fell, as in the simulator.

        Raises:
            ParameterError: If the history has no physics.
            ShapeError, NonFiniteError, SchemaError: If history, physics or actions are bad.
        """
        check_history(history, self.context)
        check_actions(actions, history.states.shape[0], actions.device)
        if history.physics is None:
            raise ParameterError("history.physics is None: the oracle needs the simulator's state")
        physics = np.asarray(history.physics, dtype=float)
        if physics.shape != (len(actions), PHYSICS_SIZE):
            raise ShapeError(
                f"history.physics is {physics.shape}: expected {(len(actions), PHYSICS_SIZE)}"
            )
        if not np.isfinite(physics).all():
            raise NonFiniteError("history.physics holds NaN or infinity: expected finite values")
        speed = history.states[:, -1, SPEED.start].detach().cpu().numpy()
        return _Rollout.apply(actions, self, physics, _phase(history), speed)

    # -- simulation ------------------------------------------------------------------------------
    def rollout(self, physics, phase, speed, actions, first=None):
        """Simulate rows that may start at different control steps.

        Args:
            physics: ``(R, 68)`` state of each row at its own first step.
            phase: ``(R,)`` phase at step 0.
            speed: ``(R,)`` m/s.
            actions: ``(R, T, 10)`` rad.
            first: ``(R,)`` control step at which a row starts; default 0.

        Returns:
            States ``(R, T, 49)`` (of no meaning before ``first``), physics ``(R, T, 68)`` and
            whether the robot has fallen ``(R, T)``, each after every step.
        """
        rows, horizon = actions.shape[:2]
        first = np.zeros(rows, dtype=int) if first is None else first
        states = np.empty((rows, horizon, STATE_SIZE))
        after = np.empty((rows, horizon, PHYSICS_SIZE))
        fallen = np.zeros((rows, horizon), dtype=bool)
        for start in range(0, rows, MAX_ROWS):
            part = slice(start, min(start + MAX_ROWS, rows))
            states[part], after[part], fallen[part] = self._rollout(
                physics[part], phase[part], speed[part], actions[part], first[part]
            )
        self.control_steps += int((horizon - first).sum())
        return states, after, fallen

    def _rollout(self, physics, phase, speed, actions, first):
        rows, horizon = actions.shape[:2]
        simulator = self._of_size(rows)
        start = simulator.snapshot()
        start.sensors[:] = 0.0
        start.physics[:rows], start.phase[:rows], start.speed[:rows] = physics, phase, speed
        # Fallen rows are not simulated: those that are spare and those that start later.
        start.fallen[:] = True
        simulator.restore(start)
        states = np.empty((rows, horizon, STATE_SIZE))
        after = np.empty((rows, horizon, PHYSICS_SIZE))
        fallen = np.zeros((rows, horizon), dtype=bool)
        command = np.zeros((simulator.count, ACTION_SIZE))
        for step in range(horizon):
            simulator.fallen[:rows][first == step] = False
            command[:rows] = actions[:, step]
            with warnings.catch_warnings():
                # A wild candidate may diverge; it then counts as fallen and scores accordingly.
                warnings.simplefilter("ignore", RuntimeWarning)
                simulator.step(command)
            states[:, step], after[:, step] = simulator.states[:rows], simulator.physics[:rows]
            fallen[:, step] = simulator.fallen[:rows]
        return states, after, fallen

    def _of_size(self, rows: int) -> Simulator:
        """The simulator, made larger when more rows are asked for than ever before."""
        if self._simulator.count < rows:
            self._simulator = Simulator(rows, self.timestep_s, self._threads)
        return self._simulator


class _Rollout(torch.autograd.Function):
    """Simulation forwards, finite differences of it backwards."""

    @staticmethod
    def forward(ctx, actions, oracle, physics, phase, speed):
        """Simulate every candidate from its episode's physics."""
        count = actions.shape[1]
        flat = actions.detach().flatten(0, 1).cpu().double().numpy()
        start = [np.repeat(value, count, axis=0) for value in (physics, phase, speed)]
        states, after, fallen = oracle.rollout(*start, flat)
        ctx.oracle, ctx.problem = oracle, (start, flat, states, after, fallen)
        return torch.as_tensor(states, dtype=actions.dtype).unflatten(0, actions.shape[:2])

    @staticmethod
    def backward(ctx, gradient):
        """Vector-Jacobian product: ``(E, N, T, 49)`` to ``(E, N, T, 10)``."""
        weight = gradient.detach().flatten(0, 1).cpu().double().numpy()
        start, flat, states, after, fallen = ctx.problem
        product = _vector_jacobian(ctx.oracle, start, flat, states, after, fallen, weight)
        product = torch.as_tensor(product, dtype=gradient.dtype).unflatten(0, gradient.shape[:2])
        return product, None, None, None, None


def _phase(history: History) -> np.ndarray:
    """Phase ``(E,)``; a history of one state does not tell 27 from 0, which have one clock."""
    if history.phase is None and history.states.shape[1] == 1:
        return phase_from_clock(history.states[:, -1, CLOCK].detach().cpu().numpy())
    return phase_of(history).cpu().numpy()


def _vector_jacobian(oracle, start, actions, states, after, fallen, weight):
    """Derivative of ``sum(weight * states)`` in every action, ``(R, T, 10)``."""
    physics, phase, speed = start
    rows, horizon = actions.shape[:2]
    before = np.concatenate([physics[:, None], after[:, :-1]], axis=1)
    signs = (1.0, -1.0) if oracle.central else (1.0,)
    # One row per candidate, perturbed step, motor and sign; all in one batch.
    row, step, motor, sign = (
        index.ravel()
        for index in np.meshgrid(
            np.arange(rows),
            np.arange(horizon),
            np.arange(ACTION_SIZE),
            np.array(signs),
            indexing="ij",
        )
    )
    order = np.argsort(step, kind="stable")
    row, step, motor, sign = row[order], step[order], motor[order], sign[order]
    changed = actions[row].copy()
    changed[np.arange(len(row)), step, motor] += sign * oracle.difference_rad
    # A robot that has fallen stays as it is, whatever it is told: its row never starts.
    first = np.where((step > 0) & fallen[row, step - 1], horizon, step)
    found, _, _ = oracle.rollout(before[row, step], phase[row], speed[row], changed, first)
    difference = found - states[row]
    difference[np.arange(horizon)[None, :] < first[:, None]] = 0.0
    value = np.einsum("rts,rts->r", difference, weight[row])
    product = np.zeros_like(actions)
    np.add.at(product, (row, step, motor), sign * value)
    return product / (oracle.difference_rad * len(signs))
