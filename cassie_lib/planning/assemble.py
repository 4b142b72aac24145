"""Put a planner together from a preset's section: objective, mean and terminal value."""

from __future__ import annotations

import numpy as np

from cassie_lib import gait
from cassie_lib.controllers import Controller
from cassie_lib.dynamics.model import DynamicsModel
from cassie_lib.errors import ParameterError
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.feedforward import feedforward_cycle
from cassie_lib.planning.gradient_cem import GradientCEM
from cassie_lib.planning.objective import Objective
from cassie_lib.planning.stage_reward import WalkingReward
from cassie_lib.planning.terminal import CriticValue, CycleSpeed, TerminalSum, TerminalValue
from cassie_lib.presets import CEMParameters, GradientCEMParameters
from cassie_lib.robot.model import neutral_pose
from cassie_lib.robot.schema import ACTION_SIZE, PERIOD
from cassie_lib.simulator import S0_SPEED_MPS
from cassie_lib.walking import run_episodes

#: Cycles over which the expert settles, and over which its actions are averaged after that.
SETTLING_CYCLES = 6
AVERAGED_CYCLES = 6


def expert_cycle(
    expert: Controller, speed_mps: float = S0_SPEED_MPS, timestep_s: float = 0.0005
) -> np.ndarray:
    """The expert's actions by phase, averaged over cycles of an undisturbed walk.

    Args:
        expert: Controller to record.
        speed_mps: Commanded forward speed.
        timestep_s: Physics step.

    Returns:
        ``(28, 10)`` rad: entry p is the action taken at phase p.

    Raises:
        ParameterError: If the expert falls meanwhile.
    """
    steps = PERIOD * (SETTLING_CYCLES + AVERAGED_CYCLES)
    recording = run_episodes(
        expert,
        episodes=1,
        steps=steps,
        speed_mps=speed_mps,
        perturbation=0.0,
        timestep_s=timestep_s,
    )
    if recording.fell[0]:
        raise ParameterError(
            f"the expert fell at control step {recording.length[0]}: expected {steps} to record "
            "its action cycle"
        )
    late = slice(PERIOD * SETTLING_CYCLES, steps)
    actions = recording.actions[0, late].reshape(AVERAGED_CYCLES, PERIOD, ACTION_SIZE).mean(axis=0)
    cycle = np.empty((PERIOD, ACTION_SIZE))
    cycle[recording.phase[0, late][:PERIOD]] = actions
    return cycle


def reference_cycle(reference: gait.GaitReference) -> np.ndarray:
    """The reference gait's joint angles as actions by phase: targets of the PD drive.

    The drive sags under the robot's weight;
    :func:`~cassie_lib.planning.feedforward.feedforward_cycle` makes up for it.

    Returns:
        ``(28, 10)`` rad: entry p is the action taken at phase p, the pose of phase p + 1.
    """
    return np.roll(reference.motor_position, -1, axis=0) - neutral_pose()


def make_planner(
    model: DynamicsModel,
    parameters: CEMParameters,
    *,
    expert=None,
    reference: gait.GaitReference | None = None,
    speed_mps: float = S0_SPEED_MPS,
    max_rows: int = 0,
) -> CEM:
    """Planner of the kind that its parameters are of.

    Args:
        model: Dynamics model: learned, or the oracle.
        parameters: A preset's ``cem`` or ``gradient_cem``.
        expert: :class:`cassie_lib.expert.policy.Expert`; needed for ``mean="expert"`` and for a
            terminal value alone.
        reference: Gait that the reward compares with; default a walk at ``speed_mps``.
        speed_mps: Commanded forward speed.
        max_rows: See :class:`~cassie_lib.planning.objective.Objective`.

    Raises:
        ParameterError: If parameters contradict themselves or need an expert that is not given.
    """
    if expert is None and (parameters.terminal_weight or parameters.mean == "expert"):
        needed = "terminal_weight" if parameters.terminal_weight else 'mean = "expert"'
        raise ParameterError(f"expert is None: expected one, the parameters say {needed}")
    reference = reference or gait.walk(speed_mps)
    reward = WalkingReward(
        reference, parameters.lateral, parameters.deadband, parameters.foot_weight
    )
    terminal = _terminal_value(parameters, expert)
    objective = Objective(model, reward, parameters.discount, terminal, max_rows)
    cycle = None
    if parameters.mean == "expert":
        cycle = expert_cycle(expert, speed_mps)
    elif parameters.mean == "reference":
        cycle = reference_cycle(reference)
    elif parameters.mean == "feedforward":
        cycle = feedforward_cycle(reference)
    if isinstance(parameters, GradientCEMParameters):
        return GradientCEM(objective, parameters, cycle)
    return CEM(objective, parameters, cycle)


def _terminal_value(parameters: CEMParameters, expert) -> TerminalValue | None:
    """What parameters add beyond the horizon; ``None`` is the thesis."""
    values: list[TerminalValue] = []
    if parameters.terminal_weight:
        values.append(CriticValue(expert.policy, parameters.terminal_weight))
    if parameters.speed_weight:
        values.append(CycleSpeed(parameters.speed_weight))
    return TerminalSum(*values) if len(values) > 1 else next(iter(values), None)
