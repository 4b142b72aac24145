"""One training run: its optimiser, guard, log and time, saved and taken up again together."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import nn

from cassie_lib.dynamics.checkpoint import load_training, save_training
from cassie_lib.dynamics.loop import Budget, StepGuard, TrainingLog

CHECKPOINT = "checkpoint.pt"
LOG = "log.csv"


class Training(NamedTuple):
    """Outcome of a training.

    Attributes:
        model: The trained model, in evaluation mode, weights frozen.
        log: Long-form log.
        seconds: Training time over all sessions.
        steps: Optimiser steps tried.
        skipped: Steps skipped because they were not finite or exploded.
    """

    model: Any
    log: TrainingLog
    seconds: float
    steps: int
    skipped: int


class Run:
    """What a training loop carries along.

    Attributes:
        counters: JSON-serialisable state of the loop that owns the run; saved and restored.
        step: Optimiser steps tried so far.
    """

    def __init__(
        self,
        model: nn.Module,
        optimiser: torch.optim.Optimizer,
        identity: dict[str, Any],
        folder: Path | None = None,
        max_minutes: float = 0.0,
        checkpoint_seconds: float = 60.0,
        clip_norm: float = 0.0,
    ) -> None:
        """Start a run, or take up the one whose checkpoint lies in ``folder``.

        Args:
            model: Model to train, on its device.
            optimiser: Its optimiser.
            identity: What a resume must agree with.
            folder: For ``checkpoint.pt`` and ``log.csv``; None keeps nothing.
            max_minutes: Limit of training time; 0 is none.
            checkpoint_seconds: Time between two checkpoints.
            clip_norm: Gradient norm limit; 0 is none.

        Raises:
            CheckpointError: If the checkpoint is damaged or of another run.
        """
        self.model, self.optimiser, self.identity = model, optimiser, identity
        self.path = folder / CHECKPOINT if folder else None
        self.log = TrainingLog(folder / LOG if folder else None)
        self.guard = StepGuard(clip_norm)
        self.checkpoint_seconds = checkpoint_seconds
        self.step = 0
        self.counters: dict[str, Any] = {}
        spent = self._resume(self.path) if self.path else 0.0
        self.budget = Budget(max_minutes, spent)
        self._saved_at = time.monotonic()

    def _resume(self, path: Path) -> float:
        saved = load_training(path, self.model, self.optimiser, self.identity)
        if saved is None:
            return 0.0
        self.step, self.counters = saved["step"], saved["loop"]
        self.guard.restore(saved["guard"])
        self.log.rows = [tuple(row) for row in saved["log"]]
        return saved["seconds"]

    def save(self) -> None:
        """Write checkpoint and log, if there is a folder."""
        self.log.flush()
        if self.path is not None:
            saved = {
                "step": self.step,
                "loop": self.counters,
                "guard": self.guard.state(),
                "log": self.log.rows,
                "seconds": self.budget.seconds,
            }
            save_training(self.path, self.model, self.optimiser, saved, self.identity)
        self._saved_at = time.monotonic()

    def save_when_due(self) -> None:
        """Save if the last checkpoint is ``checkpoint_seconds`` old."""
        if time.monotonic() - self._saved_at >= self.checkpoint_seconds:
            self.save()

    def descend(self, loss: torch.Tensor, epoch: int = 0) -> bool:
        """One guarded optimiser step; True if the weights were changed.

        Raises:
            TrainingError: If step after step is not finite.
        """
        self.step += 1
        done = self.guard.step(loss, self.model, self.optimiser)
        if not done:
            self.note(epoch, train__skipped=self.guard.skipped)
        return done

    def note(self, epoch: int = 0, **metrics: float) -> None:
        """Log metrics at the present step; ``__`` in a name becomes ``/``."""
        self.log.add(epoch, self.step, self.budget.seconds, **metrics)

    def finish(self) -> Training:
        """Save a last time, freeze the model and report."""
        self.save()
        model = self.model.eval().requires_grad_(False)
        return Training(model, self.log, self.budget.seconds, self.step, self.guard.skipped)


__all__ = ["Run", "Training"]
