"""What every training loop here shares: device, budget, log and the guard against bad steps."""

from __future__ import annotations

import csv
import math
import time
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from cassie_lib.errors import ParameterError, TrainingError
from cassie_lib.files import replacing

#: Steps whose gradient is this many times the usual are skipped.
EXPLODING = 20.0
#: So many skipped steps in a row end the training.
MAX_SKIPPED = 50
_LOG_FIELDS = ("epoch", "step", "seconds", "metric", "value")


def pick_device(name: str = "auto") -> torch.device:
    """Device by name; ``"auto"`` takes an accelerator if there is one.

    Raises:
        ParameterError: If PyTorch does not know the name.
    """
    if name == "auto":
        if torch.cuda.is_available():
            return torch.device("cuda")
        return torch.device("cpu")
    try:
        return torch.device(name)
    except RuntimeError as error:
        raise ParameterError(f"device is {name!r}: expected auto, cpu, cuda, ...") from error


class Budget:
    """Training time in seconds, added up over interruptions.

    Args:
        max_minutes: Limit; 0 is none.
        spent: Seconds of earlier sessions.
    """

    def __init__(self, max_minutes: float = 0.0, spent: float = 0.0) -> None:
        self.limit = max_minutes * 60.0
        self._origin = time.monotonic() - spent

    @property
    def seconds(self) -> float:
        """Training time so far."""
        return time.monotonic() - self._origin

    @property
    def share(self) -> float:
        """Part of the limit that is used, 0 without one."""
        return self.seconds / self.limit if self.limit > 0 else 0.0


class TrainingLog:
    """Long-form log of (epoch, step, seconds, metric, value), as CSV if a path is given.

    Rows live in memory too, so that a checkpoint can cut the file back to where it stood.

    Args:
        path: CSV file; None keeps the rows in memory only.
    """

    def __init__(self, path: Path | None = None) -> None:
        self.path = path
        self.rows: list[tuple[int, int, float, str, float]] = []

    def add(self, epoch: int, step: int, seconds: float, **metrics: float) -> None:
        """Append one row per metric; ``__`` in a name becomes ``/``."""
        for name, value in metrics.items():
            self.rows.append(
                (epoch, step, round(seconds, 3), name.replace("__", "/"), float(value))
            )

    def flush(self) -> None:
        """Write the file whole, by way of a temporary one."""
        if self.path is None:
            return
        with replacing(self.path) as partial, partial.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(_LOG_FIELDS)
            writer.writerows(self.rows)

    def series(self, metric: str) -> tuple[list[int], list[float], list[float]]:
        """Steps, seconds and values of one metric."""
        rows = [row for row in self.rows if row[3] == metric]
        return [r[1] for r in rows], [r[2] for r in rows], [r[4] for r in rows]


class StepGuard:
    """Optimiser step that is skipped and counted when the gradient is not finite or explodes.

    Args:
        clip_norm: Gradient norm above which gradients are scaled down; 0 never scales.
    """

    def __init__(self, clip_norm: float = 0.0) -> None:
        self.clip_norm = clip_norm
        self.usual = 0.0  # running mean of the logarithm of the gradient norm
        self.seen = 0
        self.skipped = 0
        self.skipped_in_a_row = 0

    def reset(self) -> None:
        """Forget the usual norm: the loss is about to change, as when a predicted step is added."""
        self.seen = 0

    def step(self, loss: Tensor, model: nn.Module, optimiser: torch.optim.Optimizer) -> bool:
        """Back-propagate ``loss`` and step; True if the weights were changed.

        Raises:
            TrainingError: After 50 skipped steps in a row.
        """
        optimiser.zero_grad(set_to_none=True)
        if torch.isfinite(loss):
            loss.backward()
            limit = self.clip_norm or math.inf
            norm = nn.utils.clip_grad_norm_(model.parameters(), limit).item()
            if self._usual(norm):
                optimiser.step()
                self.skipped_in_a_row = 0
                return True
        self.skipped += 1
        self.skipped_in_a_row += 1
        if self.skipped_in_a_row >= MAX_SKIPPED:
            raise TrainingError(
                f"{MAX_SKIPPED} optimiser steps in a row were not finite or exploded: "
                "expected a smaller learning rate or cleaner data"
            )
        return False

    def _usual(self, norm: float) -> bool:
        if not math.isfinite(norm):
            return False
        level = math.log(max(norm, 1e-30))
        if self.seen >= 20 and level > self.usual + math.log(EXPLODING):
            # Drift upwards slowly, so that a lasting change is accepted in the end.
            self.usual += 0.05 * (level - self.usual)
            return False
        share = max(0.02, 1.0 / (self.seen + 1))
        self.usual += share * (level - self.usual)
        self.seen += 1
        return True

    def state(self) -> dict[str, Any]:
        """Counters as plain numbers, for a checkpoint."""
        return {k: v for k, v in vars(self).items() if k != "clip_norm"}

    def restore(self, state: dict[str, Any]) -> None:
        """Take up the counters of :meth:`state`."""
        vars(self).update(state)


__all__ = ["Budget", "StepGuard", "TrainingLog", "pick_device"]
