"""Training of the causal model: every position of a window first, then its own predictions.

The first part is teacher forced: one pass over a window of H + tau pairs gives as many one-step
predictions, and all of them are learned from.  The second part rolls the model out over tau steps
through the cached path, as the planner will, and back-propagates through the whole rollout.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from cassie_lib.dynamics.causal import PHYSICAL_SIZE, CausalModel
from cassie_lib.dynamics.checkpoint import load_training, save_training
from cassie_lib.dynamics.evaluation import open_loop, split_window
from cassie_lib.dynamics.loop import Budget, StepGuard, TrainingLog, pick_device
from cassie_lib.dynamics.losses import component_weights
from cassie_lib.dynamics.normalisation import Normalisation
from cassie_lib.dynamics.windows import Transitions, Window, concatenate, mirror_window
from cassie_lib.errors import ParameterError
from cassie_lib.presets import CausalParameters

LOG_STEPS = 50


class Training(NamedTuple):
    """Outcome of a training.

    Attributes:
        model: The trained model, in evaluation mode, weights frozen.
        log: Long-form log.
        seconds: Training time over all sessions.
        steps: Optimiser steps tried.
        skipped: Steps skipped by the guard.
    """

    model: Any
    log: TrainingLog
    seconds: float
    steps: int
    skipped: int


class Sampler:
    """Random windows from several recordings; batch ``i`` depends on the seed and ``i`` alone.

    Args:
        sources: Recordings.
        shares: Part of the batches that each source gets; None: by its number of windows.
        length: States per window.
        batch_size: Windows per batch.
        seed: Seed.
        mirror: Exchange left and right in half of every batch.

    Raises:
        ParameterError: If the shares do not fit the sources.
        DataError: If a recording has no window that long.
    """

    def __init__(
        self, sources: Sequence[Transitions], shares: Sequence[float] | None, length: int,
        batch_size: int, seed: int, mirror: bool,
    ) -> None:
        self.starts = [source.window_starts(length) for source in sources]
        weights = np.array(shares if shares is not None else [len(s) for s in self.starts], float)
        if len(weights) != len(sources) or (weights < 0).any() or weights.sum() <= 0:
            raise ParameterError(f"shares are {shares}: expected {len(sources)}, none negative")
        self.sources, self.shares = sources, weights / weights.sum()
        self.length, self.batch_size, self.seed, self.mirror = length, batch_size, seed, mirror

    def batch(self, index: int) -> Window:
        """Batch number ``index``."""
        random = np.random.default_rng([self.seed, index])
        counts = random.multinomial(self.batch_size, self.shares)
        parts = [
            source.gather(random.choice(starts, count), self.length)
            for source, starts, count in zip(self.sources, self.starts, counts, strict=True)
            if count
        ]
        window = Window(*(torch.cat(values) for values in zip(*parts, strict=True)))
        if not self.mirror:
            return window
        order = torch.from_numpy(random.permutation(self.batch_size))
        half = order[: self.batch_size // 2]
        mirrored = mirror_window(Window(*(part[half] for part in window)))
        for part, changed in zip(window, mirrored, strict=True):
            part[half] = changed
        return window


def learning_rate(progress: float, parameters: CausalParameters) -> float:
    """Linear warm-up, then half a cosine down to ``final_learning_rate``; progress 0..1."""
    warmup = parameters.warmup_share
    if progress < warmup:
        return parameters.learning_rate * (progress + 1e-3) / (warmup + 1e-3)
    share = min(1.0, (progress - warmup) / max(1e-9, 1.0 - warmup))
    low, high = parameters.final_learning_rate, parameters.learning_rate
    return low + (high - low) * 0.5 * (1.0 + math.cos(math.pi * share))


def error_scale(model: CausalModel) -> Tensor:
    """Unit ``(46,)`` in which each component's error is counted: the spread of its state."""
    return model.normalisation.state_std[:PHYSICAL_SIZE]


def teacher_forced_loss(model: CausalModel, window: Window, weights: Tensor) -> Tensor:
    """Mean squared weighted one-step error over all positions of a window."""
    outputs = model(window.states[:, :-1], window.actions[:, :-1])
    target = window.states.diff(dim=1)[..., :PHYSICAL_SIZE]
    error = model.normalisation.to_differences(outputs) - target
    return (error * (weights / error_scale(model))).square().mean()


def rollout_loss(model: CausalModel, window: Window, weights: Tensor) -> Tensor:
    """Mean squared weighted error of states over tau predicted steps (in the spirit of Eq 3.6)."""
    history, actions, truth = split_window(window, model.context)
    predicted = model.rollout(model.encode(history), actions)[:, 0]
    error = (predicted - truth)[..., :PHYSICAL_SIZE]
    return (error * (weights / error_scale(model))).square().mean()


class _Loop:
    """State of one training: built anew or from a checkpoint, then run to its end."""

    def __init__(
        self, sampler: Sampler, model: CausalModel, parameters: CausalParameters,
        validation: Transitions | None, folder: Path | None,
    ) -> None:
        self.sampler, self.model, self.parameters = sampler, model, parameters
        self.validation, self.folder = validation, folder
        self.device = next(model.parameters()).device
        self.optimiser = torch.optim.AdamW(
            model.parameters(), lr=parameters.learning_rate, weight_decay=parameters.weight_decay
        )
        self.guard = StepGuard(parameters.clip_norm)
        self.log = TrainingLog(folder / "log.csv" if folder else None)
        self.budget = Budget(parameters.max_minutes)
        self.step = 0
        self.identity = {
            "kind": "causal",
            "parameters": dataclasses.asdict(parameters),
            "normalisation": model.normalisation.digest(),
            "windows": [len(starts) for starts in sampler.starts],
        }
        self.checkpoint = folder / "checkpoint.safetensors" if folder else None
        if self.checkpoint is not None:
            self._resume()

    def _resume(self) -> None:
        saved = load_training(self.checkpoint, self.model, self.optimiser, self.identity)
        if saved is None:
            return
        self.step = saved["step"]
        self.guard.restore(saved["guard"])
        self.log.rows = [tuple(row) for row in saved["log"]]
        self.budget = Budget(self.parameters.max_minutes, saved["seconds"])

    def save(self) -> None:
        if self.checkpoint is None:
            return
        counters = {
            "step": self.step, "guard": self.guard.state(), "log": self.log.rows,
            "seconds": self.budget.seconds,
        }
        save_training(self.checkpoint, self.model, self.optimiser, counters, self.identity)
        self.log.flush()

    @property
    def progress(self) -> float:
        return max(self.step / max(1, self.parameters.steps), self.budget.share)

    def run(self, callback: Callable[[int, CausalModel], None] | None) -> None:
        parameters = self.parameters
        size = self.device
        weights = component_weights(parameters.order_weights, PHYSICAL_SIZE).to(size)
        saved_at, rolling, total, count = time.monotonic(), False, 0.0, 0
        while (progress := self.progress) < 1.0:
            rate = learning_rate(progress, parameters)
            for group in self.optimiser.param_groups:
                group["lr"] = rate
            window = self.sampler.batch(self.step)
            window = Window(*(part.to(self.device) for part in window))
            roll = progress >= 1.0 - parameters.rollout_share
            if roll and not rolling:
                self.guard.reset()
                total, count = 0.0, 0
            rolling = roll
            loss = (rollout_loss if roll else teacher_forced_loss)(self.model, window, weights)
            self.step += 1
            if self.guard.step(loss, self.model, self.optimiser):
                total, count = total + loss.item(), count + 1
            else:
                self.note(train__skipped=self.guard.skipped)
            if self.step % LOG_STEPS == 0 and count:
                name = "train__rollout_loss" if roll else "train__one_step_loss"
                self.note(**{name: total / count, "learning_rate": rate})
                total, count = 0.0, 0
            if self.step % parameters.validation_steps == 0:
                self.validate()
            if callback is not None:
                callback(self.step, self.model)
            if time.monotonic() - saved_at >= parameters.checkpoint_seconds:
                self.save()
                saved_at = time.monotonic()
        self.validate()
        self.save()
        self.log.flush()

    def note(self, **metrics: float) -> None:
        self.log.add(0, self.step, self.budget.seconds, **metrics)

    def validate(self) -> None:
        if self.validation is None:
            return
        self.model.eval()
        horizon = self.parameters.horizon
        result = open_loop(
            self.model, self.validation, horizon, self.parameters.validation_windows
        )
        self.note(
            validation__relative_step_1=result.relative[0],
            **{f"validation__relative_step_{horizon}": result.relative[-1]},
        )
        self.model.train()


def train_causal(
    train: Transitions | Sequence[Transitions],
    parameters: CausalParameters,
    *,
    validation: Transitions | None = None,
    shares: Sequence[float] | None = None,
    initial: CausalModel | None = None,
    folder: Path | None = None,
    device: str = "auto",
    callback: Callable[[int, CausalModel], None] | None = None,
) -> Training:
    """Train a causal model, or go on with one.

    The learning rate and the change from one-step to rollout training follow the larger of
    ``step / steps`` and ``minutes / max_minutes``: with ``max_minutes = 0`` the result is the
    same to the bit on one machine, killed and resumed or not.

    Args:
        train: One recording, or several that are sampled by ``shares``.
        parameters: Sizes and hyper-parameters.
        validation: Recording to validate on; None for none.
        shares: Part of the batches that each recording gets.
        initial: Warm start: weights and normalisation of another model of the same sizes.
        folder: Where checkpoint and ``log.csv`` go; a checkpoint found there is resumed.
        device: ``"auto"`` or a PyTorch device name.
        callback: Called with (step, model) after every step.

    Raises:
        ParameterError: If ``initial`` has other sizes or the shares do not fit.
        CheckpointError: If the checkpoint is damaged or belongs to another run.
        TrainingError: If step after step is not finite.
    """
    sources = [train] if isinstance(train, Transitions) else list(train)
    torch.manual_seed(parameters.seed)
    length = parameters.context + parameters.horizon
    sampler = Sampler(
        sources, shares, length, parameters.batch_size, parameters.seed, parameters.mirror
    )
    if initial is None:
        model = CausalModel(parameters, Normalisation.from_transitions(concatenate(sources)))
    else:
        model = CausalModel(parameters)
        try:
            model.load_state_dict(initial.state_dict())
        except RuntimeError as error:
            raise ParameterError("the initial model has other sizes than parameters") from error
    model = model.to(pick_device(device)).requires_grad_(True).train()
    loop = _Loop(sampler, model, parameters, validation, folder)
    loop.run(callback)
    model.eval().requires_grad_(False)
    return Training(model, loop.log, loop.budget.seconds, loop.step, loop.guard.skipped)


__all__ = ["Sampler", "Training", "train_causal"]
