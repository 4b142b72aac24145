"""Imagined motions: a perfect model is its own ghost, and nothing of the future leaks in."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cassie_lib.dynamics.imagination import imagine, pick_start
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.errors import DataError, ParameterError
from cassie_lib.simulator import Simulator


class Recalls:
    """Predicts what really followed, shifted by an offset of pelvis height."""

    def __init__(self, states, context=4, offset=0.0):
        self.states, self.context, self.offset = states, context, offset

    def predict(self, history, actions):
        steps = actions.shape[2]
        now = history.states[0, -1].numpy()
        row = int(np.abs(self.states - now).max(axis=1).argmin())
        found = torch.tensor(self.states[row + 1 : row + 1 + steps])[None, None].clone()
        found[..., 0] += self.offset
        return found


@pytest.fixture(scope="module")
def recording():
    simulator, random = Simulator(1), np.random.default_rng(0)
    states, actions, phase = [], 0.05 * random.normal(size=(16, 10)), []
    for action in actions:
        states.append(simulator.states[0].copy())
        phase.append(int(simulator.phase[0]))
        simulator.step(action[None])
    return Transitions(
        np.array(states, np.float32), actions.astype(np.float32), np.array(phase), np.array([0])
    )


def test_a_perfect_model_is_its_own_ghost(recording):
    found = imagine(Recalls(recording.states), recording, 6, 5)
    assert found.qpos.shape == found.ghost.shape == (6, 35)
    assert np.abs(found.qpos - found.ghost).max() < 1e-9
    assert found.pelvis_distance_m.max() == found.joint_error_rad.max() == 0.0


def test_an_error_of_height_is_seen_as_such(recording):
    found = imagine(Recalls(recording.states, offset=0.1), recording, 6, 5)
    assert found.pelvis_distance_m[0] == 0.0
    assert found.pelvis_distance_m[1:] == pytest.approx(np.full(5, 0.1), abs=1e-6)


def test_it_stays_within_one_episode(recording):
    model = Recalls(recording.states)
    for start, steps in ((2, 5), (12, 5)):
        with pytest.raises(ParameterError, match="of its episode"):
            imagine(model, recording, start, steps)
    with pytest.raises(ParameterError):
        imagine(model, recording, 6, 5, context=8)


def test_a_start_is_one_that_can_be_imagined(recording):
    model = Recalls(recording.states)
    for wanted, steps in ((5, 5), (100, 12)):
        start, found = pick_start(recording, model.context, wanted)
        assert found == steps
        assert len(imagine(model, recording, start, found).ghost) == steps + 1
    with pytest.raises(DataError, match="longest episode"):
        pick_start(recording, 16, 5)
