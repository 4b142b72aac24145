"""Recurrent PPO for the expert pi* (thesis section 4.3.1), readable from top to bottom.

One update: every robot acts for ``rollout_steps`` control steps; advantages by GAE; the rollout
is cut into sequences of ``sequence_steps`` whose first LSTM memories were stored on the way;
clipped policy gradients through each sequence, the memory cleared where an episode starts.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from cassie_lib.checkpoints import load_checkpoint, save_checkpoint
from cassie_lib.errors import ParameterError, TrainingError
from cassie_lib.expert.policy import ExpertPolicy
from cassie_lib.expert.rollout import Rollout, Sequences
from cassie_lib.expert.task import WalkingTask
from cassie_lib.expert.training_state import capture, reinstate
from cassie_lib.logs import CsvLog, Progress
from cassie_lib.presets import ExpertParameters
from cassie_lib.robot.schema import ACTION_SIZE

_CHECKPOINT = "checkpoint.pt"
#: Critic outputs are in units of this reward, so that values stay of order one.
_VALUE_SCALE = 10.0


class RecurrentPPO:
    """Trains an :class:`ExpertPolicy` on a :class:`WalkingTask`; resumes exactly."""

    def __init__(self, parameters: ExpertParameters, timestep_s: float) -> None:
        """Prepare a run from its seed.

        Args:
            parameters: All hyper-parameters.
            timestep_s: Physics step of training, s.

        Raises:
            ParameterError: If the rollout is not a whole number of sequences.
        """
        p = parameters
        if p.rollout_steps % p.sequence_steps:
            raise ParameterError(
                f"rollout_steps = {p.rollout_steps}: expected a multiple of sequence_steps = "
                f"{p.sequence_steps}"
            )
        self.parameters, self.timestep_s = p, timestep_s
        torch.manual_seed(p.seed)
        self.generator = torch.Generator().manual_seed(p.seed)
        self.policy = ExpertPolicy(p.hidden_size, p.layers)
        self.optimiser = torch.optim.Adam(self.policy.parameters(), lr=p.learning_rate, eps=1e-5)
        self.task = WalkingTask(p, timestep_s, np.random.default_rng(p.seed))
        self.memory = self.policy.initial_memory(p.robots)
        self.starts = torch.ones(p.robots)
        # Actor and critic share nothing: the critic is computed beside the actor.
        self._beside = ThreadPoolExecutor(max_workers=1)
        self.steps, self.seconds, self.input_count = 0, 0.0, 0.0

    @property
    def action_std_rad(self) -> Tensor:
        """Exploration noise of each robot ``(N, 1)``: it fades from 45 % to 90 % of the run.

        A policy trained to the end with 0.13 rad tracks its speed with that noise and walks
        0.1 m/s too fast without it; one trained with 0.05 rad no longer finds the steps that
        save it from a push.  So half of the robots become quiet, the others less so.
        """
        p = self.parameters
        share = self.steps / (p.total_steps + p.refinement_steps)
        late = float(np.clip((share - 0.45) / 0.45, 0.0, 1.0))
        last = torch.full((p.robots, 1), p.final_action_std_rad)
        last[p.robots // 2 :] = p.loud_action_std_rad
        return p.action_std_rad + late * (last - p.action_std_rad)

    @property
    def learning_rate(self) -> float:
        """Falls linearly to a tenth, in the training and again in the refinement."""
        p = self.parameters
        if self.steps < p.total_steps:
            return p.learning_rate * (1.0 - 0.9 * self.steps / p.total_steps)
        done = (self.steps - p.total_steps) / max(p.refinement_steps, 1)
        return p.refinement_learning_rate * (1.0 - 0.9 * done)

    @property
    def identity(self) -> str:
        """What must agree for a checkpoint to be resumed."""
        return f"expert {self.parameters} timestep_s={self.timestep_s}"

    def train(self, folder: Path, progress: bool = True) -> ExpertPolicy:
        """Train to the end, or resume where a killed run stopped.

        Args:
            folder: Where the checkpoint and ``log.csv`` live.
            progress: Whether to print a line with the time left now and then.

        Raises:
            TrainingError: On a loss that is not finite; the last good checkpoint stays.
            CheckpointError: If the folder holds a checkpoint of another run.
        """
        p, path = self.parameters, folder / _CHECKPOINT
        stored = load_checkpoint(path, self.identity)
        if stored is not None:
            reinstate(self, stored)
        log = CsvLog(folder / "log.csv", seed=p.seed, resume_step=self.steps)
        last = p.total_steps + p.refinement_steps
        meter = Progress("expert", last, self.steps, quiet=not progress)
        saved = began = time.monotonic()
        while self.steps < last:
            before = self.seconds
            measures = self._update()
            self.seconds = before + time.monotonic() - began
            began = time.monotonic()
            log.write(self.steps, self.seconds, measures)
            meter.update(self.steps, measures)
            if began - saved > p.checkpoint_seconds or self.steps >= last:
                save_checkpoint(path, capture(self), self.identity)
                saved = time.monotonic()
        return self.policy

    def _update(self) -> dict[str, float]:
        p = self.parameters
        self.task.progress = min(1.0, self.steps / p.total_steps)
        self.task.refining = self.steps >= p.total_steps
        for group in self.optimiser.param_groups:
            group["lr"] = self.learning_rate
        rollout, measures = self._collect()
        self.steps += p.rollout_steps * p.robots
        measures.update(self._improve(rollout))
        return measures

    @torch.no_grad()
    def _collect(self) -> tuple[Rollout, dict[str, float]]:
        p, task, policy = self.parameters, self.task, self.policy
        rows: dict[str, list[Tensor]] = {name: [] for name in (
            "inputs", "actions", "log_probability", "values", "rewards", "starts", "ends"
        )}  # fmt: skip
        memories, totals = [], {"reward": 0.0, "plain_reward": 0.0, "falls": 0.0}
        states = torch.as_tensor(task.simulator.states, dtype=torch.float32)
        if self.steps < p.total_steps // 2:
            self._learn_statistics(states)
        std = self.action_std_rad
        for step in range(p.rollout_steps):
            if step % p.sequence_steps == 0:
                memories.append(self.memory)
            inputs = policy.normalise(states).unsqueeze(0)
            starts = self.starts.unsqueeze(0)
            beside = self._beside.submit(_value, policy, inputs, self.memory[1], starts)
            mean, actor = policy.actor(inputs, self.memory[0], starts)
            noise = torch.randn(p.robots, ACTION_SIZE, generator=self.generator)
            action = mean[0] + std * noise
            reward, plain, failed, expired = task.step(action.double().numpy())
            reward = torch.as_tensor(reward / _VALUE_SCALE, dtype=torch.float32)
            value, critic = beside.result()
            self.memory = (actor, critic)
            states = torch.as_tensor(task.simulator.states, dtype=torch.float32)
            if expired.any():
                # A time limit is no failure: add what the critic expects from there on.
                beyond, _ = policy.critic(
                    policy.normalise(states).unsqueeze(0), critic, torch.zeros(1, p.robots)
                )
                reward = reward + p.discount * beyond[0, :, 0] * torch.as_tensor(
                    expired, dtype=torch.float32
                )
            ends = torch.as_tensor(failed | expired, dtype=torch.float32)
            for name, item in zip(rows, (
                inputs[0], action, _log_probability(action, mean[0], std), value[0, :, 0], reward,
                self.starts, ends
            ), strict=True):  # fmt: skip
                rows[name].append(item)
            totals["reward"] += float(reward.mean()) * _VALUE_SCALE
            totals["plain_reward"] += float(plain.mean())
            totals["falls"] += float(failed.mean())
            if (failed | expired).any():
                task.restart(failed | expired)
                states = torch.as_tensor(task.simulator.states, dtype=torch.float32)
            self.starts = ends
        last, _ = policy.critic(
            policy.normalise(states).unsqueeze(0), self.memory[1], self.starts.unsqueeze(0)
        )
        stacked = {name: torch.stack(items) for name, items in rows.items()}
        rollout = Rollout(**stacked, std=std, memories=memories, last_value=last[0, :, 0])
        return rollout, {name: total / p.rollout_steps for name, total in totals.items()}

    def _learn_statistics(self, states: Tensor) -> None:
        """Running mean and standard deviation of the inputs (Welford, batched)."""
        policy, count = self.policy, float(len(states))
        total = self.input_count + count
        shift = states.mean(0) - policy.input_mean
        old = policy.input_std**2 * self.input_count
        spread = old + states.var(0, unbiased=False) * count
        spread = spread + shift**2 * self.input_count * count / total
        policy.input_mean += shift * (count / total)
        policy.input_std.copy_((spread / total).sqrt().clamp_min(1e-2))
        self.input_count = total

    def _improve(self, rollout: Rollout) -> dict[str, float]:
        p = self.parameters
        rollout.judge(p.discount, p.gae_lambda)
        order = rollout.all_sequences(p.sequence_steps)
        sums = {"policy_loss": 0.0, "value_loss": 0.0, "kl": 0.0}
        batches = 0
        for _ in range(p.epochs):
            shuffled = order[torch.randperm(len(order), generator=self.generator)]
            for chosen in shuffled.chunk(p.minibatches):
                losses = self._minibatch(rollout.sequences(chosen, p.sequence_steps))
                batches += 1
                for name in sums:
                    sums[name] += losses[name]
            if losses["kl"] > 1.5 * p.target_kl:
                break  # the data are used up: the policy has moved far enough from them
        return {name: total / batches for name, total in sums.items()}

    def _minibatch(self, batch: Sequences) -> dict[str, float]:
        p = self.parameters
        self.optimiser.zero_grad()
        beside = self._beside.submit(self._critic_gradient, batch)
        policy_loss, kl = self._actor_gradient(batch)
        value_loss = beside.result()
        if not np.isfinite(policy_loss + value_loss):
            raise TrainingError(
                f"loss is {policy_loss + value_loss} at step {self.steps}: expected a finite loss; "
                "the last good checkpoint is kept"
            )
        torch.nn.utils.clip_grad_norm_(self.policy.parameters(), p.max_gradient_norm)
        self.optimiser.step()
        return {"policy_loss": policy_loss, "value_loss": value_loss, "kl": kl}

    def _actor_gradient(self, batch: Sequences) -> tuple[float, float]:
        """Back-propagate the clipped objective; returns it and the KL divergence so far."""
        clip = self.parameters.clip
        mean, _ = self.policy.actor(batch.inputs, batch.memory[0], batch.starts)
        log_ratio = _log_probability(batch.actions, mean, batch.std) - batch.log_probability
        ratio = log_ratio.exp()
        clipped = ratio.clamp(1.0 - clip, 1.0 + clip)
        loss = -torch.min(ratio * batch.advantages, clipped * batch.advantages).mean()
        loss.backward()
        return loss.item(), (ratio - 1.0 - log_ratio).mean().item()

    def _critic_gradient(self, batch: Sequences) -> float:
        """Back-propagate the critic's error with its weight; returns the error."""
        value, _ = self.policy.critic(batch.inputs, batch.memory[1], batch.starts)
        error = (value.squeeze(-1) - batch.targets).pow(2).mean()
        (0.5 * error).backward()
        return error.item()


@torch.no_grad()
def _value(
    policy: ExpertPolicy, inputs: Tensor, memory: Tensor, starts: Tensor
) -> tuple[Tensor, Tensor]:
    """The critic without gradients: their absence is a setting of each thread."""
    return policy.critic(inputs, memory, starts)


def _log_probability(actions: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    """Gaussian log density up to a constant, which cancels in every ratio."""
    return -0.5 * (((actions - mean) / std) ** 2).sum(-1)
