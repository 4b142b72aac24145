"""Recurrent PPO: memory, advantages, exact resume, storage, training reward."""

import csv
import json

import numpy as np
import pytest
import torch

from cassie_lib import gait
from cassie_lib.checkpoints import load_checkpoint, save_checkpoint
from cassie_lib.controllers import Observation
from cassie_lib.errors import CheckpointError, ParameterError, ShapeError, TrainingError
from cassie_lib.expert.guidance import gait_term, long_swing, velocity_term
from cassie_lib.expert.policy import Expert, ExpertPolicy, load_expert, save_expert
from cassie_lib.expert.ppo import RecurrentPPO
from cassie_lib.expert.rollout import generalised_advantages
from cassie_lib.expert.task import WalkingTask
from cassie_lib.logs import CsvLog
from cassie_lib.presets import get_preset, replace
from cassie_lib.robot.model import load_model
from cassie_lib.robot.randomisation import randomised_models

SMALL = replace(get_preset("smoke").expert, hidden_size=8, robots=3, total_steps=3 * 84,
    refinement_steps=84,
                rollout_steps=28, sequence_steps=14, epochs=2, minibatches=2,
                checkpoint_seconds=0.0)  # fmt: skip
COARSE = 0.002


def _policy(seed=0):
    torch.manual_seed(seed)
    policy = ExpertPolicy(8, 2)
    torch.nn.init.normal_(policy.actor.head.weight)
    return policy


def test_memory_is_cleared_where_an_episode_starts():
    network = _policy().actor
    inputs = torch.randn(10, 2, 49)
    starts = torch.zeros(10, 2)
    starts[6, 1] = 1.0
    whole, _ = network(inputs, network.initial_memory(2), starts)
    fresh, _ = network(inputs[6:, 1:], network.initial_memory(1), torch.zeros(4, 1))
    torch.testing.assert_close(whole[6:, 1:], fresh)
    unbroken, _ = network(inputs, network.initial_memory(2), torch.zeros(10, 2))
    torch.testing.assert_close(whole[:, 0], unbroken[:, 0])
    assert (whole[6:, 1] - unbroken[6:, 1]).abs().max() > 1e-4


def test_cut_sequences_with_stored_memory_give_the_same_outputs():
    network = _policy().actor
    inputs, starts = torch.randn(12, 3, 49), torch.zeros(12, 3)
    whole, final = network(inputs, network.initial_memory(3), starts)
    first, memory = network(inputs[:5], network.initial_memory(3), starts[:5])
    second, last = network(inputs[5:], memory, starts[5:])
    torch.testing.assert_close(whole, torch.cat([first, second]))
    torch.testing.assert_close(final, last)


def test_advantages_are_the_discounted_sums_of_their_definition():
    generator = torch.Generator().manual_seed(0)
    rewards, values = (torch.randn(7, 2, generator=generator) for _ in range(2))
    last, ends = torch.randn(2, generator=generator), torch.zeros(7, 2)
    ends[3, 0] = 1.0
    found = generalised_advantages(rewards, values, last, ends, 0.9, 0.8)
    following = torch.cat([values[1:], last[None]])
    delta = rewards + 0.9 * (1 - ends) * following - values
    for robot in (0, 1):
        for step in range(7):
            total, weight = 0.0, 1.0
            for later in range(step, 7):
                total += weight * delta[later, robot]
                weight *= 0.9 * 0.8 * (1 - ends[later, robot])
            assert found[step, robot] == pytest.approx(float(total), abs=1e-5)
    # lambda = 1 without ends is the Monte-Carlo return minus the value.
    returns = sum(0.9**k * rewards[k, 1] for k in range(7)) + 0.9**7 * last[1]
    full = generalised_advantages(rewards, values, last, ends * 0, 0.9, 1.0)
    assert full[0, 1] == pytest.approx(float(returns - values[0, 1]), abs=1e-4)


def _rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


class _KilledError(Exception):
    pass


def test_killed_training_resumes_to_the_same_bits(tmp_path, monkeypatch):
    straight, broken = tmp_path / "straight", tmp_path / "broken"
    straight.mkdir()
    broken.mkdir()
    wanted = RecurrentPPO(SMALL, COARSE).train(straight, progress=False).state_dict()

    original = RecurrentPPO._update

    def dies(self):
        if self.steps >= 2 * 84:
            raise _KilledError
        return original(self)

    monkeypatch.setattr(RecurrentPPO, "_update", dies)
    with pytest.raises(_KilledError):
        RecurrentPPO(SMALL, COARSE).train(broken, progress=False)
    monkeypatch.setattr(RecurrentPPO, "_update", original)
    with open(broken / "log.csv", "a") as file:
        file.write("99999,1.0,reward")  # half a line, and beyond the checkpoint
    found = RecurrentPPO(SMALL, COARSE).train(broken, progress=False).state_dict()
    assert all(torch.equal(found[name], wanted[name]) for name in wanted)
    logs = [
        [(row["step"], row["metric"], row["value"]) for row in _rows(folder / "log.csv")]
        for folder in (straight, broken)
    ]
    assert logs[0] == logs[1]


def test_checkpoints_of_other_runs_and_damaged_ones_are_refused(tmp_path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, {"a": torch.ones(2)}, "one")
    assert torch.equal(load_checkpoint(path, "one")["a"], torch.ones(2))
    with pytest.raises(CheckpointError, match="belongs to run 'one': expected 'two'"):
        load_checkpoint(path, "two")
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(CheckpointError, match="cannot be read"):
        load_checkpoint(path, "one")
    assert load_checkpoint(tmp_path / "none.pt", "one") is None


def test_other_parameters_do_not_resume(tmp_path):
    RecurrentPPO(replace(SMALL, total_steps=84, refinement_steps=0), COARSE).train(
        tmp_path, progress=False
    )
    with pytest.raises(CheckpointError, match="belongs to run"):
        RecurrentPPO(replace(SMALL, learning_rate=1e-5), COARSE).train(tmp_path, progress=False)


def test_nan_loss_stops_with_the_last_checkpoint_kept(tmp_path):
    run = RecurrentPPO(replace(SMALL, total_steps=84, refinement_steps=0), COARSE)
    run.train(tmp_path, progress=False)
    kept = (tmp_path / "checkpoint.pt").read_bytes()
    run.parameters = replace(SMALL, total_steps=10_000)
    with torch.no_grad():
        run.policy.critic.head.bias.fill_(float("nan"))
    with pytest.raises(TrainingError, match="loss is nan"):
        run._update()
    assert (tmp_path / "checkpoint.pt").read_bytes() == kept


def test_rollout_must_hold_whole_sequences():
    with pytest.raises(ParameterError, match="multiple of sequence_steps"):
        RecurrentPPO(replace(SMALL, rollout_steps=30), COARSE)


def test_stored_expert_acts_the_same_and_damage_is_found(tmp_path):
    policy = _policy()
    save_expert(policy, tmp_path, {"seed": 0})
    states = np.random.default_rng(0).normal(size=(4, 49))
    observation = Observation(states, np.zeros((4, 68)), np.zeros(4, int), np.zeros((4, 3)), 0)
    actions = []
    for expert in (Expert(policy), load_expert(tmp_path)):
        expert.reset(4)
        actions.append([expert.act(observation) for _ in range(3)])
    np.testing.assert_array_equal(*actions)
    # It has a memory: the same state twice gives two actions.
    assert np.abs(actions[0][0] - actions[0][1]).max() > 1e-6
    expert.reset(2)
    with pytest.raises(ShapeError, match="states of 4 robots: expected 2"):
        expert.act(observation)


@pytest.mark.parametrize("damage", ["truncate", "other size", "no card", "card", "not finite"])
def test_unusable_expert_files(tmp_path, damage):
    policy = _policy()
    if damage == "not finite":
        policy.actor.head.bias.data[3] = float("nan")
    save_expert(policy, tmp_path, {})
    weights, card = tmp_path / "expert.safetensors", tmp_path / "card.json"
    if damage == "truncate":
        weights.write_bytes(weights.read_bytes()[:100])
    elif damage == "other size":
        card.write_text(json.dumps({"architecture": {"hidden_size": 16, "layers": 2}}))
    elif damage == "no card":
        card.unlink()
    elif damage == "card":
        card.write_text("{")
    with pytest.raises(CheckpointError, match="no usable expert"):
        load_expert(tmp_path)


def test_training_reward_prefers_stepping_to_standing():
    reference = gait.walk(0.0)
    swing = ~reference.in_contact
    load = reference.in_contact / reference.in_contact.sum(axis=1, keepdims=True)
    stepping = gait_term(reference.foot_height_m, load, reference.foot_height_m, swing).mean()
    standing = gait_term(np.zeros((28, 2)), np.full((28, 2), 0.5), reference.foot_height_m, swing)
    assert stepping > 0.95
    assert standing.mean() < 0.75
    # 3.10 pays 0.99 for standing against stepping; with the term stepping wins clearly.
    assert velocity_term(np.array([[0.5, 0.0]]), np.array([0.5]))[0] == 1.0
    assert velocity_term(np.array([[0.0, 0.0]]), np.array([0.5]))[0] < 0.2


def test_long_swing_adds_a_step_on_either_side_and_leaves_a_foot_down():
    swing = ~gait.walk(0.5).in_contact
    longer = long_swing(~swing)
    assert (longer.sum(axis=0) == swing.sum(axis=0) + 2).all()
    assert longer[swing].all()
    assert not longer.all(axis=1).any()
    # A hop has both feet in the air, and is not cut short.
    hop = np.zeros((28, 2), dtype=bool)
    hop[5:9] = True
    assert long_swing(~hop).sum() == 2 * 4


def test_a_push_is_forgiven_for_a_while_and_moves_the_line_of_the_walk():
    parameters = replace(SMALL, robots=64, push_interval_steps=1, recovery_steps=10)
    task = WalkingTask(parameters, COARSE, np.random.default_rng(0))
    task.progress = 1.0
    task.step(np.zeros((64, 10)))
    pushes = task.pushes
    assert pushes.recovering.all()
    np.testing.assert_allclose(pushes.indulgence, 0.9)
    np.testing.assert_array_equal(pushes.line_m, task.simulator.qpos[:, 1])
    for step in range(2, 11):
        before = task.simulator._push_steps.copy()
        task.step(np.zeros((64, 10)))
        assert (task.simulator._push_steps <= before).all(), "no push during a recovery"
        np.testing.assert_allclose(pushes.indulgence, 1.0 - step / 10)
    line = pushes.line_m.copy()
    pushes.advance(task.simulator.qpos[:, 1] + 1.0)
    np.testing.assert_array_equal(pushes.line_m, line)
    pushes.forget(np.array([3]))
    assert pushes.line_m[3] == 0.0
    assert not pushes.recovering[3]


def test_half_of_the_robots_become_quiet():
    run = RecurrentPPO(replace(SMALL, robots=4), COARSE)
    assert run.action_std_rad.flatten().tolist() == pytest.approx([SMALL.action_std_rad] * 4)
    run.steps = SMALL.total_steps + SMALL.refinement_steps
    quiet, loud = SMALL.final_action_std_rad, SMALL.loud_action_std_rad
    assert run.action_std_rad.flatten().tolist() == pytest.approx([quiet, quiet, loud, loud])


def test_task_ends_failed_episodes_and_starts_them_anew():
    task = WalkingTask(replace(SMALL, robots=8, guidance_weight=0.0), COARSE,
                       np.random.default_rng(0))  # fmt: skip
    ended = np.zeros(8, dtype=bool)
    for _ in range(60):
        _, plain, failed, expired = task.step(np.zeros((8, 10)))
        assert not (failed & expired).any()
        assert failed[plain < SMALL.termination_reward].all()
        task.restart(failed | expired)
        assert (task.age[failed | expired] == 0).all()
        assert not task.simulator.fallen.any()
        ended |= failed
    assert ended.all()


def test_randomised_models_differ_within_the_spread():
    models = randomised_models(6, 0.2, np.random.default_rng(0))
    nominal = load_model()
    ratio = np.array([model.body_mass[1:] / nominal.body_mass[1:] for model in models])
    assert np.abs(ratio - 1.0).max() <= 0.2
    assert ratio.std() > 0.05
    with pytest.raises(ParameterError, match="spread = 1.0"):
        randomised_models(1, 1.0, np.random.default_rng(0))


def test_log_is_long_form_and_cuts_repeated_work(tmp_path):
    log = CsvLog(tmp_path / "log.csv", seed=7)
    for step in (10, 20, 30):
        log.write(step, step / 2, {"reward": step / 100})
    CsvLog(tmp_path / "log.csv", seed=7, resume_step=20)
    rows = _rows(tmp_path / "log.csv")
    assert [row["step"] for row in rows] == ["10", "20"]
    assert set(rows[0]) == {"step", "seconds", "metric", "value", "seed"}
