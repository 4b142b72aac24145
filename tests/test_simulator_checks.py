"""Bad input to the simulator: a typed error that names the value, and nothing has changed."""

from __future__ import annotations

import numpy as np
import pytest

from cassie_lib.errors import NonFiniteError, ParameterError, ShapeError
from cassie_lib.robot import model as robot
from cassie_lib.simulator import Simulator

COARSE = 0.002


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"phase": np.nan}, ParameterError, "phase = nan: expected whole numbers"),
        ({"phase": 3.7}, ParameterError, "phase = 3.7"),
        ({"phase": [1, 2]}, ShapeError, r"phase has shape \(2,\)"),
        ({"speed": np.inf}, NonFiniteError, "speed = inf"),
        ({"qpos": np.zeros(34)}, ShapeError, r"qpos has shape \(34,\): expected \(35,\)"),
        ({"qvel": np.full(32, np.nan)}, NonFiniteError, "qvel holds nan"),
        ({"qvel": 0.0}, ShapeError, "qvel has shape"),
        ({"indices": [0, 3]}, ParameterError, r"indices = \[0, 3\]: expected robots 0 to 2"),
        ({"indices": [-1]}, ParameterError, r"indices = \[-1\]"),
        ({"indices": np.array([True, False, True])}, ParameterError, "indices = "),
    ],
)
def test_reset_refuses(arguments, error, text):
    simulator = Simulator(3, COARSE)
    before = simulator.snapshot()
    with pytest.raises(error, match=text):
        simulator.reset(**arguments)
    for old, new in zip(before, simulator.snapshot(), strict=True):
        np.testing.assert_array_equal(old, new)


@pytest.mark.parametrize(
    ("impulse", "indices", "error"),
    [
        ([np.nan, 0, 0], None, NonFiniteError),
        ([1.0, 2.0], None, ShapeError),
        (np.zeros((3, 3)), [0, 1], ShapeError),
        ([1.0, 2.0, 3.0], [7], ParameterError),
    ],
)
def test_push_refuses(impulse, indices, error):
    with pytest.raises(error):
        Simulator(3, COARSE).push(impulse, indices=indices)


def test_no_robots_are_reset_or_pushed_without_complaint():
    simulator = Simulator(2, COARSE)
    before = simulator.physics.copy()
    simulator.reset([])
    simulator.push([9.0, 0.0, 0.0], indices=np.array([], dtype=int))
    np.testing.assert_array_equal(simulator.physics, before)


def test_whole_phases_of_any_type_are_taken_round_the_clock():
    simulator = Simulator(3, COARSE)
    simulator.reset(phase=np.array([0.0, 29.0, -1.0]))
    assert simulator.phase.tolist() == [0, 1, 27]


def test_the_callers_models_keep_their_time_step():
    models = [robot.load_model(0.0005) for _ in range(2)]
    fine = Simulator(2, 0.0005, models=models)
    Simulator(2, COARSE, models=models)
    fine.step(np.zeros((2, 10)))
    assert fine.physics[:, 0] == pytest.approx(0.03), "one control step lasts 0.03 s"
    assert models[0].opt.timestep == 0.0005
