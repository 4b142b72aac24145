"""Measures of what planning costs: memory of gradients, and rollouts that the history does not
multiply."""

from __future__ import annotations

import torch
from planning_toys import DoubleIntegrator, cem_parameters, quadratic_reward

from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.cost import (
    Uncached,
    gradient_memory,
    gradient_seconds,
    plan_seconds,
    standing_history,
)
from cassie_lib.planning.objective import Objective
from cassie_lib.presets import get_preset


def causal():
    torch.manual_seed(0)
    made = CausalModel(get_preset("smoke").causal).eval().requires_grad_(False)
    # The head starts near zero; predictions have to depend on the context for this test.
    torch.nn.init.normal_(made.head.weight, std=0.1)
    return made


def test_memory_of_gradients_grows_with_the_sequences_that_are_improved():
    objective = Objective(causal(), quadratic_reward)
    elites, everything = (gradient_memory(objective, count, 4) for count in (10, 200))
    # Issue: Gradient-CEM needs at most 1/15 of the memory of gradients on all N, at K/N = 1/20.
    assert everything / elites > 15
    # At least the predicted states themselves, 49 numbers of 4 bytes a step.
    assert elites > 10 * 4 * 49 * 4


def test_uncached_model_plans_the_same():
    model = causal()
    actions = 0.1 * torch.randn(2, 3, 4, 10, generator=torch.Generator().manual_seed(0))
    history = standing_history(2, model.context)
    slow = Uncached(model)
    torch.testing.assert_close(
        slow.predict(slow.prepare(history), actions),
        model.predict(model.prepare(history), actions),
        rtol=1e-4, atol=1e-5,
    )


def test_times_are_those_of_work_that_was_done():
    model = DoubleIntegrator()
    objective = Objective(model, quadratic_reward)
    assert plan_seconds(CEM(objective, cem_parameters(iterations=2)), 2, repeats=2) > 0
    # Three rounds a plan; one plan is not counted.
    assert model.predictions == 9
    assert gradient_seconds(objective, 3, 2, repeats=1) > 0
