"""Collection: the same bits from a seed, resumed or not; what is recorded is what happened."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cassie_lib.artifacts import WORK
from cassie_lib.controllers import StandStill
from cassie_lib.data import CUT, FALL, TIME, collect, collect_noise_study
from cassie_lib.data import collect as collect_function
from cassie_lib.data.fields import FIELDS
from cassie_lib.errors import DataError, ParameterError
from cassie_lib.expert.policy import Expert, ExpertPolicy
from cassie_lib.presets import (
    CollectionParameters,
    NoiseStudyParameters,
    SimulationParameters,
    get_preset,
    replace,
)
from cassie_lib.robot.schema import CLOCK, GRAVITY, SPEED, clock
from cassie_lib.simulator import S0_PHASE, Simulator

COARSE = SimulationParameters(timestep_s=0.002)
SMALL = CollectionParameters("small", 150, 0.2, seed=3, episode_steps=60, robots=3)


def same_bits(a, b) -> bool:
    return all(
        np.asarray(getattr(a, f.name)).tobytes() == np.asarray(getattr(b, f.name)).tobytes()
        for f in FIELDS
    )


@pytest.fixture(scope="module")
def policy():
    torch.manual_seed(0)
    return ExpertPolicy(hidden_size=16)


@pytest.fixture(scope="module")
def small(policy, tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "small"
    return collect(Expert(policy), SMALL, COARSE, folder, threads=1, progress=False)


def test_counts_are_exact_and_the_last_episode_is_cut(small):
    assert len(small) == SMALL.transitions
    assert small.card["counts"]["transitions"] == SMALL.transitions
    assert small.episode_end[-1] in (CUT, FALL)
    assert set(small.episode_end[:-1].tolist()) <= {0, FALL}


def test_every_episode_starts_at_s0(small):
    first = small.states[small.episode_starts]
    np.testing.assert_array_equal(first, np.broadcast_to(first[0], first.shape))
    assert np.all(small.phase[small.episode_starts] == S0_PHASE)
    np.testing.assert_allclose(first[0, CLOCK], clock(14), atol=1e-6)
    np.testing.assert_allclose(first[0, SPEED], 0.0509, atol=1e-7)
    np.testing.assert_allclose(first[0, 33], -GRAVITY, atol=0.05)
    np.testing.assert_array_equal(small.foot_force[small.episode_starts], 0.0)


def test_replaying_the_recorded_actions_gives_the_recorded_episode(small):
    """The recorded action is the executed one: s0 and the actions are the whole episode."""
    rows = small.rows(0)
    robot = Simulator(1, COARSE.timestep_s, threads=1)
    robot.reset(speed=COARSE.speed_mps)
    for row in range(rows.start, rows.stop):
        assert robot.states[0].astype(np.float32).tobytes() == small.states[row].tobytes()
        assert robot.foot_force[0].astype(np.float32).tobytes() == small.foot_force[row].tobytes()
        assert robot.phase[0] == small.phase[row]
        robot.step(small.actions[row][None].astype(np.float64))
    np.testing.assert_array_equal(robot.states[0].astype(np.float32), small.final_states[0])
    assert bool(robot.fallen[0]) == bool(small.fell[0])


def test_falls_end_episodes_and_their_last_samples_are_marked(small):
    assert small.fell.any()
    for episode in np.flatnonzero(small.fell):
        rows = small.rows(int(episode))
        marks = small.falling[rows]
        assert marks[-28:].all()
        assert not marks[:-28].any()
        # The fall itself is the outcome of the last action; until then the robot was upright.
        assert small.final_states[episode, 0] <= 0.4
        assert np.all(small.states[rows, 0] > 0.4)
    for episode in np.flatnonzero(small.episode_end == TIME):
        assert not small.falling[small.rows(int(episode))].any()


def test_noise_is_gaussian_with_the_stated_deviation(tmp_path):
    parameters = CollectionParameters("noisy", 400, 0.06, seed=0, episode_steps=25, robots=8)
    data = collect(StandStill(), parameters, COARSE, tmp_path / "d", progress=False)
    noise = np.asarray(data.actions - data.mean_actions, dtype=float)
    # Standard errors of mean and deviation over 4,000 draws; 5 of them.
    assert abs(noise.mean()) < 5 * 0.06 / np.sqrt(noise.size)
    assert abs(noise.std() / 0.06 - 1.0) < 5 / np.sqrt(2 * noise.size)
    correlation = np.corrcoef(noise.T) - np.eye(10)
    assert np.abs(correlation).max() < 5 / np.sqrt(len(noise))
    np.testing.assert_array_equal(data.mean_actions, 0.0)


def test_without_noise_all_episodes_are_equal(tmp_path):
    parameters = CollectionParameters("still", 40, 0.0, seed=0, episode_steps=10, robots=4)
    data = collect(StandStill(), parameters, COARSE, tmp_path / "d", progress=False)
    table = data.by_episode("states")
    np.testing.assert_array_equal(table, np.broadcast_to(table[0], table.shape))
    np.testing.assert_array_equal(data.actions, data.mean_actions)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_same_seed_same_bits_with_any_number_of_threads(small, policy, tmp_path, threads):
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    again = collect(
        Expert(policy), SMALL, COARSE, tmp_path / "d", threads=threads, progress=False
    )
    assert torch.get_num_threads() == threads  # the caller's setting is put back
    torch.set_num_threads(before)
    assert same_bits(small, again)
    assert small.card == again.card


def test_other_seed_other_noise(small, policy, tmp_path):
    other = collect(
        Expert(policy), replace(SMALL, seed=4), COARSE, tmp_path / "d", progress=False
    )
    assert not np.array_equal(small.actions[:10], other.actions[:10])


class KilledError(Exception):
    """Stands for a kill between two steps."""


class Dying(Expert):
    """Dies at its ``calls``-th action."""

    def __init__(self, policy, calls):
        super().__init__(policy)
        self.calls = calls

    def act(self, observation):
        self.calls -= 1
        if self.calls < 0:
            raise KilledError
        return super().act(observation)


Dying.__name__ = "Expert"  # the name is part of the protocol


def test_a_killed_collection_goes_on_to_the_same_bits(small, policy, tmp_path):
    folder = tmp_path / "d"
    with pytest.raises(KilledError):
        collect(Dying(policy, 50), SMALL, COARSE, folder, progress=False)
    batches = sorted((folder / WORK / "batches").glob("*.npz"))
    assert batches, "expected at least one finished batch before the kill"
    assert not (folder / "card.json").exists()
    # 50 calls do not make the whole, but do when the finished batch is not run again.
    again = collect(Dying(policy, 50), SMALL, COARSE, folder, progress=False)
    assert same_bits(small, again)
    assert not (folder / WORK).exists()


def test_a_damaged_batch_is_run_again(small, policy, tmp_path):
    folder = tmp_path / "d"
    with pytest.raises(KilledError):
        collect(Dying(policy, 50), SMALL, COARSE, folder, progress=False)
    batch = sorted((folder / WORK / "batches").glob("*.npz"))[0]
    batch.write_bytes(batch.read_bytes()[:500])
    assert same_bits(small, collect(Expert(policy), SMALL, COARSE, folder, progress=False))


def test_batches_of_another_collection_are_refused(policy, tmp_path):
    folder = tmp_path / "d"
    with pytest.raises(KilledError):
        collect(Dying(policy, 50), SMALL, COARSE, folder, progress=False)
    with pytest.raises(DataError, match="another collection"):
        collect(Expert(policy), replace(SMALL, noise_std_rad=0.1), COARSE, folder, progress=False)


def test_a_finished_folder_is_opened_not_collected_again(small, policy, tmp_path):
    folder = tmp_path / "d"
    collect(Expert(policy), SMALL, COARSE, folder, progress=False)
    # A controller that dies at its first action is never asked for one.
    assert same_bits(small, collect(Dying(policy, 0), SMALL, COARSE, folder, progress=False))
    with pytest.raises(DataError, match="another collection"):
        collect(Expert(policy), replace(SMALL, seed=9), COARSE, folder, progress=False)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"noise_std_rad": -0.01}, "noise_std_rad is -0.01"),
        ({"noise_std_rad": float("nan")}, "noise_std_rad is nan"),
        ({"transitions": 0}, "transitions is 0"),
        ({"episode_steps": 0}, "episode_steps is 0"),
        ({"robots": 0}, "robots is 0"),
    ],
)
def test_bad_parameters_are_named(tmp_path, change, message):
    with pytest.raises(ParameterError, match=message):
        collect_function(StandStill(), replace(SMALL, **change), COARSE, tmp_path / "d")
    assert not (tmp_path / "d").exists()


def test_noise_study_runs_whole_episodes_at_each_level(tmp_path):
    levels = NoiseStudyParameters((0.0, 0.25), robots=3, episode_steps=20)
    study = collect_noise_study(StandStill(), levels, COARSE, tmp_path / "d", progress=False)
    assert study.noise_std_rad.tolist() == [0.0] * 3 + [0.25] * 3
    assert CUT not in study.episode_end
    for bad in ((), (0.1, -0.1)):
        with pytest.raises(ParameterError, match="noise"):
            collect_noise_study(
                StandStill(), replace(levels, noise_std_rad=bad), COARSE, tmp_path / "e"
            )


@pytest.mark.parametrize("name", ["laptop", "thesis"])
def test_presets_hold_the_numbers_of_the_thesis(name):
    data = get_preset(name).data
    sets = [data.train, data.validation, data.test, data.baseline, data.baseline_test]
    assert [(s.transitions, s.noise_std_rad) for s in sets] == [
        (90_650, 0.06), (41_650, 0.03), (41_650, 0.01), (10_000, 0.01), (4_000, 0.03),
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["smoke", "laptop", "thesis"])
def test_no_two_data_sets_share_noise(name):
    preset = get_preset(name)
    seeds = [item.seed for item in vars(preset.data).values()]
    assert len(set(seeds)) == len(seeds)
