"""Model-based DAgger: who acts when, and what is kept of it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from planning_toys import DoubleIntegrator, cem_parameters, quadratic_reward
from test_planning_control import Lazy, drive

from cassie_lib.dagger import (
    pad_starts,
    split_by_episode,
    to_transitions,
    window_shares,
)
from cassie_lib.dagger.recordings import load_transitions, save_transitions
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.errors import ArtifactError, DataError, ParameterError
from cassie_lib.packing import RELATIVE_ERROR
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.mixed import MixedController
from cassie_lib.planning.objective import Objective
from cassie_lib.walking import run_episodes


def mixed(planner_steps, cycle_steps=9):
    objective = Objective(DoubleIntegrator(), quadratic_reward, 0.9)
    planner = CEM(objective, cem_parameters(samples=4, elites=2, iterations=1, mean="warm"))
    return MixedController(planner, Lazy(), planner_steps, cycle_steps)


def recorded(lengths, seed=0):
    """Transitions whose first component tells the episode and whose second tells the step."""
    states = np.zeros((sum(lengths), 49), dtype=np.float32)
    states[:, 0] = np.repeat(np.arange(len(lengths)), lengths)
    states[:, 1] = np.concatenate([np.arange(size) for size in lengths])
    actions = np.random.default_rng(seed).normal(size=(sum(lengths), 10)).astype(np.float32)
    return Transitions(
        states, actions, np.zeros(sum(lengths), dtype=int), np.cumsum([0, *lengths[:-1]])
    )


# -- who acts --------------------------------------------------------------------------------------
@pytest.mark.parametrize("planner_steps", [1, 4, 9])
def test_planner_acts_at_n_steps_of_every_cycle(planner_steps):
    made = mixed(planner_steps)
    drive(made, 9 * 4, count=3)
    planned = made.log().planned.reshape(4, 9, 3)
    # The first cycle loses what fell before the hand-over.
    assert (planned[1:].sum(axis=1) == planner_steps).all()
    assert not planned[0, : made.handover_step].any()
    if planner_steps < 9:
        assert not (planned[1] == planned[2]).all()
        assert not (planned[1:, :, 0] == planned[1:, :, 1]).all()
    else:
        assert planned[1:].all()


def test_expert_acts_otherwise_and_sees_every_state():
    made = mixed(2)
    _, actions = drive(made, 27)
    planned = made.log().planned
    expected = 0.001 * np.arange(1, 28)
    for robot in range(2):
        free = ~planned[:, robot]
        assert actions[robot, free, 0].numpy() == pytest.approx(expected[free], abs=1e-6)
    assert made.expert.step == 27


def test_planner_forgets_a_plan_that_was_not_followed():
    made = mixed(1)
    drive(made, 27)
    last = made.log().planned[-1]
    assert not made.planner._last[torch.as_tensor(~last)].any()


def test_turns_depend_on_the_seed_alone():
    runs = []
    for seed in (3, 3, 4):
        made = mixed(3)
        drive(made, 18, seed=seed)
        runs.append(made.log().planned)
    assert (runs[0] == runs[1]).all()
    assert not (runs[0] == runs[2]).all()


@pytest.mark.parametrize("planner_steps", [0, 10])
def test_more_turns_than_steps_are_refused(planner_steps):
    with pytest.raises(ParameterError, match=f"planner_steps is {planner_steps}"):
        mixed(planner_steps)


# -- recordings ------------------------------------------------------------------------------------
def test_no_episode_is_in_two_parts():
    parts = split_by_episode(recorded([5, 3, 8, 2, 6, 4, 7, 5, 9, 3]), (0.6, 0.2, 0.2), seed=1)
    owners = [set(part.states[:, 0].tolist()) for part in parts]
    assert [len(owner) for owner in owners] == [6, 2, 2]
    assert set.union(*owners) == set(range(10))
    for part in parts:
        # Whole episodes, in order.
        assert (part.states[part.episode_starts, 1] == 0).all()
        assert (np.diff(part.states[:, 1])[np.diff(part.states[:, 0]) == 0] == 1).all()


def test_small_and_bad_splits():
    parts = split_by_episode(recorded([2, 2, 2]), (0.9, 0.05, 0.05), seed=0)
    assert [len(part) for part in parts] == [2, 2, 2]
    with pytest.raises(DataError, match="2 episodes"):
        split_by_episode(recorded([2, 2]), (0.6, 0.2, 0.2), seed=0)
    with pytest.raises(ParameterError, match="sum to 1"):
        split_by_episode(recorded([2, 2, 2]), (0.6, 0.2, 0.1), seed=0)


def test_padded_start_is_the_context_of_a_start_without_expert():
    before = recorded([3, 2])
    after = pad_starts(before, context=4)
    assert after.episode_starts.tolist() == [0, 6]
    assert after.states[:, 1].tolist() == [0, 0, 0, 0, 1, 2, 0, 0, 0, 0, 1]
    assert after.states[:, 0].tolist() == [0] * 6 + [1] * 5
    assert not after.actions[[0, 1, 2, 6, 7, 8]].any()
    np.testing.assert_array_equal(after.actions[[3, 4, 5, 9, 10]], before.actions)


def test_older_rounds_decay():
    sources = [recorded([12]), recorded([12, 12]), recorded([12])]
    kept = window_shares(sources, [2, 1, 0], 1.0, length=3)
    assert kept == pytest.approx([0.25, 0.5, 0.25])
    faded = window_shares(sources, [2, 1, 0], 0.5, length=3)
    # beta^2 * 10, beta * 20 and 10 windows.
    assert faded == pytest.approx([2.5 / 22.5, 10 / 22.5, 10 / 22.5])
    for decay in (0.0, 1.5):
        with pytest.raises(ParameterError, match="decay"):
            window_shares(sources, [2, 1, 0], decay, 3)


def test_the_rounds_may_get_a_fixed_share_of_the_batches():
    sources = [recorded([12]), recorded([22]), recorded([12, 12]), recorded([12])]
    ages = [2, 2, 1, 0]
    shares = window_shares(sources, ages, 0.5, 3, first=2, rounds_share=0.4)
    # Within each part by windows and age: 10 and 20 at one age, 20 halved and 10.
    assert shares == pytest.approx([0.2, 0.4, 0.2, 0.2])
    assert window_shares(sources, ages, 1.0, 3, first=2, rounds_share=0.0)[2:] == [0.0, 0.0]
    for share in (-0.1, 1.1, float("nan")):
        with pytest.raises(ParameterError, match="rounds_share"):
            window_shares(sources, ages, 1.0, 3, first=2, rounds_share=share)
    for first in (0, 4):
        with pytest.raises(ParameterError, match=f"first is {first}: expected 1 to 3"):
            window_shares(sources, ages, 1.0, 3, first=first, rounds_share=0.4)


def test_recording_gives_the_steps_after_the_hand_over():
    class Kick(Lazy):
        def act(self, observation):
            return np.full((self.count, 10), 0.4)

    recording = run_episodes(Kick(), episodes=2, steps=60, timestep_s=0.002)
    assert recording.fell.all()
    found = to_transitions(recording, begin=5)
    lengths = recording.length + 1 - 5
    np.testing.assert_array_equal(found.episode_lengths, lengths)
    np.testing.assert_allclose(found.states[lengths[0]], recording.states[1, 5], rtol=1e-6)
    with pytest.raises(DataError, match="longer than 60"):
        to_transitions(recording, begin=60)


def test_stored_transitions_come_back_and_damaged_ones_are_refused(tmp_path):
    made, path = recorded([4, 3]), tmp_path / "transitions.npz"
    save_transitions(path, made)
    found = load_transitions(path)
    for name, error in (
        ("states", RELATIVE_ERROR), ("actions", RELATIVE_ERROR), ("phase", 0), ("episode_starts", 0)
    ):  # fmt: skip
        np.testing.assert_allclose(getattr(found, name), getattr(made, name), rtol=error)
        assert getattr(found, name).dtype == getattr(made, name).dtype
    save_transitions(tmp_path / "again.npz", found)
    np.testing.assert_array_equal(load_transitions(tmp_path / "again.npz").states, found.states)
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b""):
        path.write_bytes(content)
        with pytest.raises(ArtifactError, match=r"transitions\.npz holds no transitions"):
            load_transitions(path)
    np.savez_compressed(path, states=made.states)
    with pytest.raises(ArtifactError, match="holds no transitions"):
        load_transitions(path)
    short = {name: getattr(made, name) for name in ("states", "phase", "episode_starts")}
    np.savez_compressed(path, actions=made.actions, **short)  # not packed: read as it is
    np.testing.assert_array_equal(load_transitions(path).states, made.states)
    np.savez_compressed(path, actions=made.actions[:-1], **short)
    with pytest.raises(ArtifactError, match=r"actions has shape \(6, 10\): expected \(7, 10\)"):
        load_transitions(path)
