"""Analytic dynamics embedded in the 49-d state, so that planners have known answers."""

from __future__ import annotations

import numpy as np
import torch

from cassie_lib.dynamics.model import History
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.gradient_cem import GradientCEM
from cassie_lib.planning.objective import Objective
from cassie_lib.presets import CEMParameters, GradientCEMParameters
from cassie_lib.robot.schema import CONTROL_PERIOD_S, MOTOR_POSITION, MOTOR_VELOCITY, STATE_SIZE

# Tensors are tiny: more threads only wait for each other.
torch.set_num_threads(1)

CONTEXT = 3
TARGET = torch.linspace(-0.05, 0.05, 10)
EFFORT = 0.02


class DoubleIntegrator:
    """Ten point masses: each action is a force on one motor position."""

    def __init__(self, gain: float = 400.0, context: int = CONTEXT):
        self.gain, self.context, self.predictions = gain, context, 0

    def prepare(self, history):
        """Nothing to prepare."""
        return history

    def predict(self, history, actions):
        """Semi-implicit Euler over one control period a step."""
        self.predictions += 1
        state = history.states[:, None, -1].expand(-1, actions.shape[1], -1)
        rest = state
        position, velocity = state[..., MOTOR_POSITION], state[..., MOTOR_VELOCITY]
        found = []
        for step in range(actions.shape[2]):
            velocity = velocity + CONTROL_PERIOD_S * self.gain * actions[:, :, step]
            position = position + CONTROL_PERIOD_S * velocity
            parts = [rest[..., :5], position, rest[..., 15:21], velocity, rest[..., 31:]]
            found.append(torch.cat(parts, dim=-1))
        return torch.stack(found, dim=2)


class Spoiled(DoubleIntegrator):
    """Predicts NaN wherever the first action of the first motor exceeds a threshold."""

    def __init__(self, threshold: float, **options):
        super().__init__(**options)
        self.threshold = threshold

    def predict(self, history, actions):
        """NaN is multiplied in, so that it also spoils the gradient of that candidate."""
        bad = actions[:, :, 0, 0] > self.threshold
        factor = torch.where(bad, float("nan"), 1.0)[..., None, None]
        return super().predict(history, actions) * factor


def quadratic_reward(states, phase, lateral_m):
    """Minus the squared distance to :data:`TARGET` and a price on velocity: ``(E, N, T)``."""
    position, velocity = states[..., MOTOR_POSITION], states[..., MOTOR_VELOCITY]
    return -(position - TARGET).square().sum(-1) - EFFORT * velocity.square().sum(-1)


def history(episodes: int = 1, context: int = CONTEXT, seed: int = 0) -> History:
    """Histories with a valid quaternion and clock and random motor positions."""
    generator = torch.Generator().manual_seed(seed)
    states = torch.zeros(episodes, context, STATE_SIZE)
    states[..., 1], states[..., 47] = 1.0, 1.0
    states[..., MOTOR_POSITION] = 0.05 * torch.randn(episodes, 1, 10, generator=generator)
    return History(states, torch.zeros(episodes, context - 1, 10))


def best_sequence(model, start: History, horizon: int, discount: float) -> torch.Tensor:
    """Exact maximiser of the discounted quadratic return, ``(10 T,)``, by linear algebra."""
    size = horizon * 10

    def residuals(flat):
        states = model.predict(start, flat.view(1, 1, horizon, 10))[0, 0]
        weight = (discount ** torch.arange(1, horizon + 1).double()).sqrt()[:, None]
        position = (states[:, MOTOR_POSITION] - TARGET.double()) * weight
        velocity = EFFORT**0.5 * states[:, MOTOR_VELOCITY] * weight
        return torch.cat([position.flatten(), velocity.flatten()])

    start = History(start.states.double(), start.actions.double())
    zero = torch.zeros(size, dtype=torch.float64)
    matrix = torch.autograd.functional.jacobian(residuals, zero)
    return torch.linalg.lstsq(matrix, -residuals(zero)[:, None]).solution[:, 0]


def cem_parameters(**changes) -> CEMParameters:
    """Small CEM; every motor alike."""
    settings = {
        "samples": 64,
        "elites": 8,
        "iterations": 4,
        "horizon": 4,
        "variance": (0.01,) * 10,
        **changes,
    }
    return CEMParameters(**settings)


def gradient_parameters(**changes) -> GradientCEMParameters:
    """Small Gradient-CEM; every motor alike."""
    settings = {
        "samples": 16,
        "elites": 4,
        "iterations": 2,
        "horizon": 4,
        "gradient_iterations": 10,
        "learning_rate": 0.05,
        "momentum": 0.5,
        "variance": (0.01,) * 10,
        **changes,
    }
    return GradientCEMParameters(**settings)


def planner(parameters, model=None, cycle=None, **options):
    """CEM or Gradient-CEM, as the parameters say, on the double integrator."""
    kind = GradientCEM if hasattr(parameters, "momentum") else CEM
    objective = Objective(model or DoubleIntegrator(), quadratic_reward, discount=0.9, **options)
    return kind(objective, parameters, cycle)


def solve(parameters, episodes=1, seeds=None, **options):
    """One plan from the start that :func:`history` gives."""
    made = planner(parameters, **options)
    made.reset(seeds or list(range(episodes)))
    return made.plan(history(episodes), np.zeros(episodes, int), np.zeros(episodes))


def gap(plan, horizon=4):
    """Return lost against the exact optimum, as a share of what doing nothing loses."""
    model, start = DoubleIntegrator(), history(1)
    score = Objective(model, quadratic_reward, 0.9).bind(
        start, torch.zeros(1, dtype=torch.long), torch.zeros(1)
    )
    best = best_sequence(model, start, horizon, 0.9).float().view(1, 1, horizon, 10)
    assert best.abs().max() < 0.5, "the optimum must lie inside the bounds"
    optimum, nothing = score(best).value.item(), score(torch.zeros_like(best)).value.item()
    return (optimum - plan.imagined_return.item()) / (optimum - nothing)
