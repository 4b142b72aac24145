"""Windows never cross an episode's end, are views, and nothing is dropped without being told."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from data_toys import toy_episodes
from hypothesis import given, settings
from hypothesis import strategies as st

from cassie_lib.data import CUT, FALL, TIME
from cassie_lib.errors import DataError, ParameterError, ShapeError, UnknownNameError
from cassie_lib.pipeline import as_transitions

lengths_of_episodes = st.lists(st.integers(1, 40), min_size=1, max_size=12)


@settings(deadline=None)
@given(lengths_of_episodes, st.integers(1, 40))
def test_every_window_is_consecutive_and_within_one_episode(lengths, length):
    episodes = toy_episodes(lengths)
    if max(lengths) < length:
        with pytest.raises(DataError, match=f"{length}.*{max(lengths)}"):
            episodes.windows(length)
        return
    windows = episodes.windows(length)
    states = windows.gather("states", slice(None))
    assert np.all(states[:, :, 0] == states[:, :1, 0])
    np.testing.assert_array_equal(np.diff(states[:, :, 1], axis=1), 1.0)
    # Every window that exists is there, once.
    assert len(windows) == sum(max(0, size - length + 1) for size in lengths)
    assert len(np.unique(windows.starts)) == len(windows)


@settings(deadline=None)
@given(lengths_of_episodes, st.integers(1, 40))
def test_lost_windows_are_counted(lengths, length):
    if max(lengths) < length:
        return
    windows = toy_episodes(lengths).windows(length)
    assert len(windows) + windows.lost == max(0, sum(lengths) - length + 1)
    assert windows.short_episodes == sum(size < length for size in lengths)
    assert f"{len(windows):,} windows" in windows.report()
    assert f"{windows.lost:,} lost" in windows.report()


@settings(deadline=None)
@given(lengths_of_episodes, st.integers(2, 40))
def test_the_models_see_the_same_windows(lengths, length):
    episodes = toy_episodes(lengths)
    if max(lengths) < length:
        return
    windows, transitions = episodes.windows(length), as_transitions(episodes)
    np.testing.assert_array_equal(transitions.window_starts(length), windows.starts)
    batch = transitions.gather(windows.starts[::3], length)
    np.testing.assert_array_equal(
        batch.states.numpy(), windows.gather("states", slice(None, None, 3))
    )


@settings(deadline=None)
@given(lengths_of_episodes, st.floats(0.1, 0.9))
def test_split_keeps_order_and_loses_no_sample(lengths, share):
    episodes = toy_episodes(lengths)
    middle = round(share * len(episodes))
    if middle in (0, len(episodes)):
        with pytest.raises(DataError, match="empty split"):
            episodes.split(share, 1.0 - share)
        return
    first, second = episodes.split(share, 1.0 - share)
    both = np.concatenate([first.actions[:, 0], second.actions[:, 0]])
    np.testing.assert_array_equal(both, np.arange(len(episodes)))
    for part in (first, second):
        # Neighbours within an episode of the part are neighbours in time.
        windows = part.windows(1)
        assert len(windows) == len(part)
        for episode in range(len(part.episode_starts)):
            rows = part.rows(episode)
            assert np.all(np.diff(part.states[rows, 1]) == 1)
            assert len(np.unique(part.states[rows, 0])) == 1


def test_an_episode_that_is_cut_through_ends_as_cut_with_the_state_that_came_next():
    episodes = toy_episodes([10, 10], [True, True])
    first, second = episodes.split(0.75, 0.25)
    assert first.episode_end.tolist() == [FALL, CUT]
    assert second.episode_end.tolist() == [FALL]
    np.testing.assert_array_equal(first.final_states[1], episodes.states[15])
    assert episodes.episode_end.tolist() == [FALL, FALL]  # the whole is not touched


@pytest.mark.parametrize("fractions", [(), (0.7, 0.4), (0.5, 0.0), (-0.1, 1.0)])
def test_impossible_fractions_are_refused(fractions):
    with pytest.raises(ParameterError, match="fractions"):
        toy_episodes([10]).split(*fractions)


def test_windows_of_the_whole_training_set_are_views():
    """90,650 windows of H = 100 need under 100 MB beside the data (issue: data collection)."""
    episodes = toy_episodes([981] * 103)
    tracemalloc.start()
    windows = episodes.windows(100)
    states, actions = windows.view("states"), windows.view("actions")
    batch = windows.gather("states", np.arange(128))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(windows) >= 90_650
    assert np.shares_memory(states, episodes.states)
    assert np.shares_memory(actions, episodes.actions)
    assert batch.shape == (128, 100, 49)
    assert peak < 10e6
    assert states.nbytes > 1e9  # what copies would have cost


def test_by_episode_is_nan_after_each_end():
    table = toy_episodes([3, 5]).by_episode("states")
    assert table.shape == (2, 5, 49)
    assert np.isnan(table[0, 3:]).all()
    assert not np.isnan(table[0, :3]).any()
    assert not np.isnan(table[1]).any()


def test_bad_requests_are_named():
    episodes = toy_episodes([5, 5])
    with pytest.raises(ParameterError, match="window length is 0"):
        episodes.windows(0)
    with pytest.raises(UnknownNameError, match="foot_force"):
        episodes.windows(2).view("force")
    with pytest.raises(ParameterError, match="episode is 2"):
        episodes.rows(2)
    with pytest.raises(DataError, match="part 4..11"):
        episodes.part(4, 11)


def test_arrays_that_do_not_fit_together_are_refused():
    good = toy_episodes([5, 5])
    arrays = {name: getattr(good, name) for name in vars(good) if name != "card"}
    with pytest.raises(ShapeError, match="actions"):
        type(good)(**{**arrays, "actions": good.actions[:-1]})
    with pytest.raises(DataError, match="episode_starts"):
        type(good)(**{**arrays, "episode_starts": np.array([0, 0])})
    with pytest.raises(DataError, match="phase reaches 28"):
        type(good)(**{**arrays, "phase": np.full(10, 28, np.uint8)})
    with pytest.raises(DataError, match="empty"):
        type(good)(**{name: values[:0] for name, values in arrays.items()})


def test_falls_are_told_from_time_limits():
    episodes = toy_episodes([40, 40], [False, True])
    assert episodes.fell.tolist() == [False, True]
    assert episodes.episode_end.tolist() == [TIME, FALL]
    assert episodes.falling.sum() == 28
    assert episodes.falling[-28:].all()
