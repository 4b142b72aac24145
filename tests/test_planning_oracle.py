"""The true simulator behind predict."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from planning_toys import gradient_parameters

from cassie_lib.dynamics.model import DynamicsModel, History
from cassie_lib.errors import NonFiniteError, ParameterError, ShapeError
from cassie_lib.gait import walk
from cassie_lib.planning import oracle as module
from cassie_lib.planning.gradient_cem import GradientCEM
from cassie_lib.planning.objective import Objective
from cassie_lib.planning.oracle import OracleModel
from cassie_lib.planning.stage_reward import WalkingReward
from cassie_lib.simulator import Simulator

COARSE = 0.002


@pytest.fixture(scope="module")
def simulator():
    made = Simulator(2, COARSE, threads=1)
    made.reset(phase=[26, 5])
    generator = np.random.default_rng(0)
    for _ in range(6):
        made.step(0.1 * generator.standard_normal((2, 10)))
    return made


def now(simulator):
    return History(
        torch.as_tensor(simulator.states[:, None], dtype=torch.float32),
        torch.zeros(simulator.count, 0, 10),
        simulator.physics.copy(),
        torch.as_tensor(simulator.phase),
    )


def candidates(count, horizon, scale=0.1, seed=1):
    generator = torch.Generator().manual_seed(seed)
    return scale * torch.randn(2, count, horizon, 10, generator=generator)


def test_oracle_is_the_simulator(simulator):
    actions = candidates(3, 4)
    model = OracleModel(timestep_s=COARSE, threads=1)
    assert isinstance(model, DynamicsModel)
    found = model.predict(now(simulator), actions)
    snapshot = simulator.snapshot()
    for index in range(3):
        simulator.restore(snapshot)
        for step in range(4):
            simulator.step(actions[:, index, step].double().numpy())
            np.testing.assert_array_equal(
                found[:, index, step], simulator.states.astype(np.float32)
            )
    simulator.restore(snapshot)


def test_batches_do_not_change_the_answer(simulator, monkeypatch):
    actions = candidates(5, 2)
    whole = OracleModel(timestep_s=COARSE, threads=1).predict(now(simulator), actions)
    monkeypatch.setattr(module, "MAX_ROWS", 3)
    model = OracleModel(timestep_s=COARSE, threads=2)
    assert torch.equal(whole, model.predict(now(simulator), actions))
    assert torch.equal(whole, model.predict(now(simulator), actions))


@pytest.mark.parametrize("central", [True, False])
def test_gradient_is_the_directional_derivative(simulator, central):
    model = OracleModel(timestep_s=COARSE, difference_rad=1e-4, central=central, threads=1)
    weight = torch.randn(2, 2, 3, 49, generator=torch.Generator().manual_seed(2))
    # Accelerations jump with every contact; everything else is smooth enough.
    weight[..., 31:34] = 0.0
    actions = candidates(2, 3).double().requires_grad_(True)
    value = (model.predict(now(simulator), actions) * weight).sum()
    (gradient,) = torch.autograd.grad(value, actions)
    direction = torch.randn(
        actions.shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64
    )
    step = 1e-5
    upper, lower = (
        (model.predict(now(simulator), actions.detach() + sign * step * direction) * weight).sum()
        for sign in (1, -1)
    )
    expected = (upper - lower) / (2 * step)
    assert (gradient * direction).sum().item() == pytest.approx(expected.item(), rel=0.05)


def test_gradient_of_an_early_state_ignores_later_actions(simulator):
    model = OracleModel(timestep_s=COARSE, threads=1)
    actions = candidates(1, 3).requires_grad_(True)
    states = model.predict(now(simulator), actions)
    before = model.control_steps
    (gradient,) = torch.autograd.grad(states[:, :, 0, 5:15].sum(), actions)
    assert gradient[:, :, 0].abs().sum() > 0
    assert torch.equal(gradient[:, :, 1:], torch.zeros(2, 1, 2, 10))
    # Forward differences: 10 T (T + 1) / 2 control steps a candidate, as documented.
    assert model.control_steps - before == 2 * 10 * 3 * 4 // 2


def test_fallen_candidate_has_no_gradient_after_the_fall(simulator):
    low = now(simulator)
    physics = low.physics.copy()
    physics[:, 3] = 3.5  # above the upright range, in free flight
    actions = candidates(1, 3).requires_grad_(True)
    states = OracleModel(timestep_s=COARSE, threads=1).predict(
        low._replace(physics=physics), actions
    )
    assert torch.equal(states[:, :, 0, :34], states[:, :, 2, :34])
    (gradient,) = torch.autograd.grad(states[..., 5:15].sum(), actions)
    assert torch.equal(gradient[:, :, 1:], torch.zeros(2, 1, 2, 10))


def test_gradient_planner_improves_on_the_truth(simulator):
    objective = Objective(
        OracleModel(timestep_s=COARSE, threads=1), WalkingReward(walk(0.0509)), 0.99
    )
    planner = GradientCEM(
        objective,
        gradient_parameters(
            samples=4,
            elites=2,
            horizon=3,
            iterations=1,
            gradient_iterations=3,
            learning_rate=0.05,
            momentum=0.0,
            normalise_gradient=True,
            keep_best=True,
        ),
    )
    planner.reset([0, 1])
    plan = planner.plan(now(simulator), simulator.phase, simulator.pelvis_position[:, 1])
    assert (plan.imagined_return > plan.best_by_round[0]).all()


def test_bad_input_is_refused(simulator):
    model, start, actions = OracleModel(timestep_s=COARSE), now(simulator), candidates(1, 2)
    with pytest.raises(ParameterError, match="physics is None"):
        model.predict(start._replace(physics=None), actions)
    with pytest.raises(ShapeError, match="physics is"):
        model.predict(start._replace(physics=start.physics[:, :60]), actions)
    spoiled = start.physics.copy()
    spoiled[0, 4] = np.nan
    with pytest.raises(NonFiniteError, match="physics"):
        model.predict(start._replace(physics=spoiled), actions)
    with pytest.raises(ParameterError, match="difference_rad"):
        OracleModel(difference_rad=0.0)
    with pytest.raises(ParameterError, match="timestep_s"):
        OracleModel(timestep_s=0.0007)
