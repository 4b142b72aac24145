"""Recordings, windows, sampling, normalisation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from dynamics_toys import oscillators

from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.sampler import Sampler
from cassie_lib.dynamics.windows import Transitions, concatenate, mirror_window
from cassie_lib.errors import DataError, NonFiniteError, ParameterError, ShapeError
from cassie_lib.robot import schema


def test_windows_never_cross_an_episode_end():
    data = oscillators(episodes=3, length=10)
    starts = data.window_starts(7)
    assert starts.tolist() == [0, 1, 2, 3, 10, 11, 12, 13, 20, 21, 22, 23]
    window = data.gather(starts, 7)
    steps = window.phase.diff(dim=1) % schema.PERIOD
    assert (steps == 1).all()
    assert torch.equal(window.states[5], torch.from_numpy(data.states[11:18]))


def test_window_longer_than_every_episode():
    with pytest.raises(DataError, match="longest episode has 10 states"):
        oscillators(episodes=3, length=10).window_starts(11)
    with pytest.raises(ParameterError, match="at least 2"):
        oscillators().window_starts(1)


def test_bad_recordings_are_named():
    good = oscillators()
    fields = [good.states, good.actions, good.phase, good.episode_starts]
    with pytest.raises(ShapeError, match="actions has shape"):
        Transitions(fields[0], fields[1][:-1], *fields[2:])
    with pytest.raises(DataError, match="increase from 0"):
        Transitions(*fields[:3], np.array([0, 50, 40]))
    with pytest.raises(DataError, match="empty"):
        Transitions(*(part[:0] for part in fields))
    broken = good.states.copy()
    broken[3, 3] = np.nan
    with pytest.raises(NonFiniteError, match="states"):
        Transitions(broken, *fields[1:])
    with pytest.raises(DataError, match="nothing to concatenate"):
        concatenate([])


def test_concatenated_recordings_keep_their_episodes():
    first, second = oscillators(2, 10), oscillators(3, 8, seed=1)
    both = concatenate([first, second])
    assert both.episode_lengths.tolist() == [10, 10, 8, 8, 8]
    assert np.array_equal(both.states[20:], second.states)


def test_mirroring_twice_is_the_identity():
    window = oscillators().gather([0, 7], 9)
    once, twice = mirror_window(window), mirror_window(mirror_window(window))
    for before, after in zip(window, twice, strict=True):
        assert torch.allclose(before.double(), after.double(), atol=1e-6)
    assert np.allclose(
        once.states.numpy(), schema.mirror_state(window.states, window.phase.numpy()), atol=1e-6
    )
    assert np.allclose(once.actions.numpy(), schema.mirror_action(window.actions), atol=1e-6)


def test_batches_depend_on_their_number_alone():
    sources = [oscillators(), oscillators(seed=5)]
    one = Sampler(sources, (0.0, 1.0), 6, 16, seed=3, mirror=True)
    other = Sampler(sources, (0.0, 1.0), 6, 16, seed=3, mirror=True)
    one.batch(0)
    for a, b in zip(one.batch(4), other.batch(4), strict=True):
        assert torch.equal(a, b)
    plain = Sampler(sources, (0.0, 1.0), 6, 16, seed=3, mirror=False).batch(4)
    recorded = {row.tobytes() for row in sources[1].states}
    assert all(row.numpy().tobytes() in recorded for row in plain.states.flatten(0, 1))
    with pytest.raises(ParameterError, match="shares"):
        Sampler(sources, (1.0,), 6, 16, 0, False)


def test_normalised_data_has_unit_spread_and_comes_back():
    data = oscillators(episodes=5)
    normalisation = Normalisation.from_transitions(data)
    states = normalisation.states(torch.from_numpy(data.states))
    assert torch.allclose(states[:, :46].std(0), torch.ones(46), atol=1e-2)
    assert (states[:, 48] == 0).all()
    inside = torch.from_numpy(data.states[:40]).diff(dim=0)
    back = normalisation.to_differences(normalisation.differences(inside))
    assert torch.allclose(back, inside, atol=1e-5)


def test_differences_across_episode_ends_do_not_count():
    data = oscillators(episodes=2, length=30)
    shifted = data.states.copy()
    shifted[30:, 5] += 1000.0
    moved = Transitions(shifted, data.actions, data.phase, data.episode_starts)
    one, other = Normalisation.from_transitions(data), Normalisation.from_transitions(moved)
    assert torch.allclose(one.difference_std, other.difference_std, atol=1e-3)
    assert one.digest() != other.digest()


def test_bad_statistics_are_refused():
    normalisation = Normalisation()
    with pytest.raises(ShapeError, match="state mean"):
        normalisation.set("state", np.zeros(48), np.ones(49))
    with pytest.raises(NonFiniteError, match="action std"):
        normalisation.set("action", np.zeros(10), np.zeros(10))
