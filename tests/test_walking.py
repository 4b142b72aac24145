"""Episodes and the report that tells walking from standing."""

import dataclasses

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from cassie_lib import gait
from cassie_lib.controllers import ReferencePlayback, StandStill
from cassie_lib.environment import CassieEnv
from cassie_lib.errors import ParameterError, UnknownNameError
from cassie_lib.recording import Recording
from cassie_lib.robot.schema import PERIOD
from cassie_lib.walking import Push, run_episodes
from cassie_lib.walking_report import walking_report

COARSE = 0.002


def _synthetic(steps=280, speed=0.5, lift=0.11, fall_at=None, both=False):
    """A recording as a perfect walk would give it, from the reference's own heights."""
    reference = gait.walk(speed)
    phase = np.arange(14, 14 + steps + 1) % PERIOD
    height = reference.foot_height_m[phase] * lift / 0.11
    contact = reference.in_contact[phase] | both
    force = np.zeros((1, steps + 1, 2, 3))
    force[0, ..., 2] = 327.0 * contact / contact.sum(axis=1, keepdims=True)
    qpos = np.zeros((1, steps + 1, 35))
    qpos[0, :, 0] = speed * 0.03 * np.arange(steps + 1)
    return Recording(
        np.zeros((1, steps + 1, 49)), np.zeros((1, steps, 10)), qpos,
        np.zeros((1, steps + 1, 2, 3)), height[None], force, phase[None],
        {"all": np.full((1, steps), 0.9)}, np.array([steps if fall_at is None else fall_at]),
        speed, "synthetic")  # fmt: skip


def test_a_perfect_walk_passes():
    report = walking_report(_synthetic(), min_reward=0.85)
    assert report.walks.all()
    assert report["left single support"].values[0] == pytest.approx(0.40, abs=0.03)
    assert "all of these" in report.to_markdown()


@pytest.mark.parametrize(("change", "measure"), [
    ({"lift": 0.04}, "least foot lift"),
    ({"both": True}, "left single support"),
    ({"fall_at": 200}, "control steps"),
])  # fmt: skip
def test_what_is_no_walk_fails_where_it_should(change, measure):
    report = walking_report(_synthetic(**change))
    assert not report.walks.any()
    assert not report[measure].passed.any()


def test_wrong_speed_and_hopping_fail():
    slow = dataclasses.replace(_synthetic(speed=0.5), speed_mps=0.6)
    assert not walking_report(slow)["mean forward"].passed.any()
    recording = _synthetic()
    recording.foot_height[...] = recording.foot_height[..., :1]
    recording.foot_force[...] = recording.foot_force[..., :1, :]
    hop = walking_report(recording)
    assert not hop["touch-downs"].passed.any()
    assert not hop["both feet"].passed.any()


def test_playback_without_feedback_falls_and_is_reported_as_such():
    recording = run_episodes(ReferencePlayback(gait.walk(0.0509)), episodes=3, steps=120,
                             timestep_s=COARSE)  # fmt: skip
    assert recording.fell.all()
    assert (recording.length < 80).all()
    assert len(set(recording.length)) > 1 or np.ptp(recording.qpos[:, 30, 1]) > 1e-4
    report = walking_report(recording, begin=0)
    assert not report.walks.any()
    assert np.isnan(recording.reward[0, recording.length[0] + 1 :]).all()


def test_same_seed_same_episodes_and_seeds_differ():
    runs = [run_episodes(StandStill(), episodes=2, steps=10, seed=seed, noise_std_rad=0.05,
                         timestep_s=COARSE) for seed in (3, 3, 4)]  # fmt: skip
    np.testing.assert_array_equal(runs[0].states, runs[1].states)
    assert np.abs(runs[0].states - runs[2].states).max() > 1e-3
    # The executed action, noise included, is what is recorded.
    assert runs[0].actions.std() == pytest.approx(0.05, rel=0.2)


def test_push_acts_when_it_should():
    still, pushed = (run_episodes(StandStill(), episodes=1, steps=12, perturbation=0.0, push=push,
                                  timestep_s=COARSE)
                     for push in (None, Push(5, (0.0, 20.0, 0.0))))  # fmt: skip
    moved = np.abs(still.states - pushed.states)[0].max(axis=1)
    assert not moved[:6].any()
    assert pushed.states[0, 10, 16] - still.states[0, 10, 16] > 0.3


def test_bad_requests():
    with pytest.raises(ParameterError, match="episodes = 0"):
        run_episodes(StandStill(), episodes=0, steps=5)
    with pytest.raises(ParameterError, match="noise_std_rad = -0.1"):
        run_episodes(StandStill(), episodes=1, steps=5, noise_std_rad=-0.1)
    with pytest.raises(ParameterError, match="expected at least 112"):
        walking_report(_synthetic(steps=80))


@pytest.mark.filterwarnings("ignore")
def test_gymnasium_checker_and_spaces():
    env = CassieEnv(timestep_s=COARSE, start="reference")
    check_env(env, skip_render_check=True)
    first, _ = env.reset(seed=1)
    again, _ = env.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    total, done, steps = 0.0, False, 0
    while not done:
        _, reward, terminated, truncated, info = env.step(np.zeros(10))
        assert reward == pytest.approx(sum(info.values()))
        total, done, steps = total + reward, terminated or truncated, steps + 1
    assert terminated
    assert steps < 80


def test_environment_refuses_bad_settings():
    with pytest.raises(UnknownNameError, match="gait"):
        CassieEnv(gait_name="moonwalk")
    with pytest.raises(ParameterError, match="start = 'mid'"):
        CassieEnv(start="mid")
    with pytest.raises(ParameterError, match="episode_steps = 0"):
        CassieEnv(episode_steps=0)
    with pytest.raises(ParameterError, match="render_mode = 'human': expected 'rgb_array' or None"):
        CassieEnv(render_mode="human")
    # Whoever forgets to reset is told by nobody, but walks at the speed that was asked for.
    env = CassieEnv(speed_mps=0.7, timestep_s=COARSE)
    assert env.step(np.zeros(10))[0][48] == 0.7
