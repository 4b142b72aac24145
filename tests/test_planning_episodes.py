"""Planners put together from presets, on the robot, and episodes that are stored."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cassie_lib import gait
from cassie_lib.artifacts.manifest import content_digest, list_files
from cassie_lib.dynamics.model import History
from cassie_lib.errors import ArtifactError, ParameterError
from cassie_lib.expert.policy import Expert, ExpertPolicy
from cassie_lib.packing import RELATIVE_ERROR
from cassie_lib.planning import assemble
from cassie_lib.planning.assemble import expert_cycle, make_planner
from cassie_lib.planning.control import PlannerController
from cassie_lib.planning.episodes import load_episodes, plan_episodes, save_episodes
from cassie_lib.planning.gradient_cem import GradientCEM
from cassie_lib.planning.oracle import OracleModel
from cassie_lib.planning.terminal import CriticValue
from cassie_lib.presets import get_preset, replace
from cassie_lib.robot.model import neutral_pose
from cassie_lib.simulator import Simulator

COARSE = 0.002
SMOKE = get_preset("smoke")


class PhaseCoded:
    """Stands, and tells the phase by a tiny offset of every target."""

    def reset(self, count, seed=0):
        self.count = count

    def act(self, observation):
        return np.repeat(1e-4 * observation.phase[:, None].astype(float), 10, axis=1)


@pytest.fixture(scope="module")
def episodes():
    planner = make_planner(OracleModel(2, COARSE), SMOKE.gradient_cem)
    controller = PlannerController(planner, PhaseCoded())
    return plan_episodes(controller, episodes=2, steps=6, timestep_s=COARSE)


def test_cycle_holds_each_phases_action(monkeypatch):
    # Without feedback the robot falls at step 33: one cycle is what there is.
    monkeypatch.setattr(assemble, "SETTLING_CYCLES", 0)
    monkeypatch.setattr(assemble, "AVERAGED_CYCLES", 1)
    cycle = expert_cycle(PhaseCoded(), timestep_s=COARSE)
    np.testing.assert_allclose(cycle, 1e-4 * np.arange(28)[:, None].repeat(10, axis=1))


def test_expert_that_falls_gives_no_cycle():
    class Kick(PhaseCoded):
        def act(self, observation):
            return np.full((self.count, 10), 0.5)

    with pytest.raises(ParameterError, match="the expert fell"):
        expert_cycle(Kick(), timestep_s=COARSE)


def test_reference_mean_aims_at_the_reference_pose_of_the_next_step():
    """No policy has seen it: with nothing to search for, the plan is the reference played back."""
    reference = gait.walk(0.3)
    parameters = replace(
        SMOKE.cem, mean="reference", variance=(0.0,) * 10, std_floor_rad=0.0, horizon=3
    )
    planner = make_planner(OracleModel(1, COARSE), parameters, reference=reference)
    planner.reset([0])
    robot = Simulator(1, COARSE)
    robot.reset()
    history = History(
        torch.as_tensor(robot.states, dtype=torch.float32)[:, None], torch.zeros(1, 0, 10),
        robot.physics.copy(), torch.tensor([26]),
    )  # fmt: skip
    plan = planner.plan(history, [26], [0.0])
    targets = plan.actions[0].numpy() + neutral_pose()
    np.testing.assert_allclose(targets, reference.motor_position[[27, 0, 1]], atol=1e-6)
    assert plan.actions.abs().max() > 0.05


def test_planner_is_of_the_kind_of_its_parameters():
    expert = Expert(ExpertPolicy(hidden_size=8, layers=1))
    plain = make_planner(OracleModel(), SMOKE.cem)
    assert not isinstance(plain, GradientCEM)
    assert plain.objective.discount == SMOKE.cem.discount
    whole = make_planner(
        OracleModel(), replace(SMOKE.gradient_cem, terminal_weight=0.5), expert=expert
    )
    assert isinstance(whole, GradientCEM)
    assert isinstance(whole.objective.terminal_value, CriticValue)
    for changes in ({"terminal_weight": 0.5}, {"mean": "expert"}):
        with pytest.raises(ParameterError, match="expert is None"):
            make_planner(OracleModel(), replace(SMOKE.cem, **changes))


def test_planner_drives_the_robot_after_the_hand_over(episodes):
    recording, log = episodes
    assert log.planned.all(axis=1).tolist() == [False, False, True, True, True, True]
    assert (recording.length == 6).all()
    assert episodes.planner_steps.tolist() == [4, 4]
    assert episodes.planner_limit == 4
    assert episodes.plan_time_s > 0
    imagined, realised = episodes.imagined_and_realised()
    assert len(imagined) == len(realised) == 2
    # The planner's own stage reward is Eq 3.10 without deadbands: never above the plain one.
    assert (log.stage_reward[1:] <= recording.reward[:, :-1].T + 1e-6).all()


def test_episodes_survive_storing(episodes, tmp_path):
    path = tmp_path / "episodes.npz"
    save_episodes(path, episodes)
    recording, log = load_episodes(path)
    assert recording.protocol == episodes.recording.protocol
    assert recording.speed_mps == episodes.recording.speed_mps
    assert log.handover_step == 2
    for name in ("states", "actions", "qpos", "foot_force", "reward"):
        stored, given = getattr(recording, name), getattr(episodes.recording, name)
        # Packed, and before that single precision.
        np.testing.assert_allclose(stored, given, rtol=1.1 * RELATIVE_ERROR, atol=1e-7)
    np.testing.assert_array_equal(recording.phase, episodes.recording.phase)
    np.testing.assert_allclose(log.imagined_return, episodes.log.imagined_return, atol=1e-5)
    np.testing.assert_array_equal(recording.length, episodes.recording.length)
    np.testing.assert_allclose(log.plan_time_s, episodes.log.plan_time_s, rtol=1e-6)


def test_wall_times_are_no_part_of_the_content(episodes, tmp_path):
    slower = episodes._replace(log=episodes.log._replace(plan_time_s=7 * episodes.log.plan_time_s))
    for name, found in {"a": episodes, "b": slower}.items():
        (tmp_path / name).mkdir()
        save_episodes(tmp_path / name / "episodes.npz", found)
    files = [list_files(tmp_path / name) for name in "ab"]
    assert "timing_episodes.npy" in files[0]
    assert content_digest(files[0]) == content_digest(files[1])
    assert files[0] != files[1]


def test_damaged_episodes_are_refused(episodes, tmp_path):
    path = tmp_path / "episodes.npz"
    save_episodes(path, episodes)
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"PK\x03\x04 nothing"):
        path.write_bytes(content)
        with pytest.raises(ArtifactError, match="episodes.npz"):
            load_episodes(path)
    with pytest.raises(ArtifactError):
        load_episodes(tmp_path / "missing.npz")
    path.write_bytes(whole)
    times = tmp_path / "timing_episodes.npy"
    np.save(times, np.zeros(3))
    with pytest.raises(ArtifactError, match=r"plan times of shape \(3,\): expected \(6,\)"):
        load_episodes(path)
    times.unlink()
    with pytest.raises(ArtifactError, match="episodes.npz"):
        load_episodes(path)
