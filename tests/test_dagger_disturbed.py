"""Rounds collected under bursts: the planner's history is what the robot did."""

from __future__ import annotations

import numpy as np
import pytest
from planning_toys import DoubleIntegrator, cem_parameters, quadratic_reward
from test_planning_control import Lazy, drive

from cassie_lib.dagger.disturbed import DisturbedController, make_driver
from cassie_lib.errors import ParameterError
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.mixed import MixedController
from cassie_lib.planning.objective import Objective
from cassie_lib.presets import BurstParameters, DAggerParameters

OFTEN = BurstParameters(strongest_rad=0.4, longest_steps=4, pause_steps=(1, 6))


def planner():
    objective = Objective(DoubleIntegrator(), quadratic_reward, 0.9)
    return CEM(objective, cem_parameters(samples=4, elites=2, iterations=1, mean="warm"))


def disturbed(bursts=OFTEN, planner_steps=3):
    return DisturbedController(planner(), Lazy(), planner_steps, 9, bursts)


def run(made, seed=0):
    """Driven actions ``(N, 27, 10)`` and what the planner's history says of them."""
    _, actions = drive(made, 27, count=3, seed=seed)
    history = np.stack([item.numpy() for item in made._context._actions], axis=1)
    return actions.numpy(), history


def test_history_holds_the_disturbed_actions():
    made = disturbed()
    actions, history = run(made)
    assert history == pytest.approx(actions[:, -history.shape[1] :], abs=1e-6)


def test_bursts_come_on_top_of_either_driver_after_a_pause():
    plain, _ = run(MixedController(planner(), Lazy(), 9, 9))
    actions, _ = run(disturbed(planner_steps=9))
    apart = np.abs(actions - plain).max(axis=2) > 1e-6
    first = apart.argmax(axis=1)
    assert apart.any(axis=1).all(), "every robot is disturbed"
    assert (first >= OFTEN.pause_steps[0]).all()
    assert (first <= OFTEN.pause_steps[1]).all()
    assert len(set(first)) > 1, "each at its own time"


def test_without_strength_it_is_the_mixed_controller():
    still = BurstParameters(strongest_rad=0.0)
    assert (run(disturbed(still))[0] == run(MixedController(planner(), Lazy(), 3, 9))[0]).all()


def test_seed_decides_the_bursts():
    first, again, other = (run(disturbed(), seed)[0] for seed in (3, 3, 4))
    assert (first == again).all()
    assert not (first == other).all()


def test_parameters_choose_the_driver():
    assert type(make_driver(planner(), Lazy(), 1, DAggerParameters())) is MixedController
    made = make_driver(planner(), Lazy(), 1, DAggerParameters(bursts=OFTEN))
    assert isinstance(made, DisturbedController)
    wrong = DAggerParameters(bursts=BurstParameters(longest_steps=0))
    with pytest.raises(ParameterError, match="bursts last 0 steps"):
        make_driver(planner(), Lazy(), 1, wrong)
