"""Long-form CSV logs that survive a kill, and a progress line with the time left."""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable
from pathlib import Path

_FIELDS = ("step", "seconds", "metric", "value", "seed")


class CsvLog:
    """Appends ``step, seconds, metric, value, seed`` rows; a resumed run cuts what it repeats."""

    def __init__(self, path: Path, seed: int, resume_step: int = 0) -> None:
        """Open a log.

        Args:
            path: CSV file.
            seed: Seed of the run, written into every row.
            resume_step: Rows beyond this step belong to work that was lost in a kill and is
                about to be repeated: they are removed.
        """
        self.path, self.seed = path, seed
        kept = []
        if path.exists():
            with open(path, newline="", errors="replace") as file:
                rows = list(csv.reader(file))
            # A kill can leave half a line at the end.
            kept = [
                row
                for row in rows[1:]
                if len(row) == len(_FIELDS) and row[0].isdecimal() and int(row[0]) <= resume_step
            ]
        temporary = path.with_suffix(".tmp")
        with open(temporary, "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(_FIELDS)
            writer.writerows(kept)
        os.replace(temporary, path)

    def write(self, step: int, seconds: float, values: dict[str, float]) -> None:
        """Append one row per metric."""
        with open(self.path, "a", newline="") as file:
            csv.writer(file).writerows(
                (step, f"{seconds:.2f}", name, f"{value:.8g}", self.seed)
                for name, value in values.items()
            )


class Progress:
    """Prints a line every few seconds with the measures and the time left."""

    def __init__(
        self, label: str, total: int, start: int = 0, every_s: float = 15.0, quiet: bool = False
    ) -> None:
        """Start the clock.

        Args:
            label: What is going on.
            total: Steps in all.
            start: Steps already done.
            every_s: Seconds between lines.
            quiet: Print nothing.
        """
        self.label, self.total, self.start = label, total, start
        self.every_s, self.quiet = every_s, quiet
        self.began = self.shown = time.monotonic()

    def update(self, done: int, values: dict[str, float]) -> None:
        """Tell how far the work is; prints when it is time to."""
        now = time.monotonic()
        if self.quiet or (now - self.shown < self.every_s and done < self.total):
            return
        self.shown = now
        rate = (done - self.start) / max(now - self.began, 1e-9)
        left = (self.total - done) / max(rate, 1e-9)
        shown = "".join(f"  {name} {value:.3g}" for name, value in values.items())
        print(
            f"{self.label} {done:,}/{self.total:,}  {rate:,.{0 if rate >= 10 else 2}f}/s  "
            f"{left / 60:.1f} min left{shown}",
            flush=True,
        )


def step_progress(label: str, total: int, every_s: float = 60.0) -> Callable[[int, object], None]:
    """Callback of a training that tells how far it is, and counts its rate from where it goes on.

    Args:
        label: What is trained.
        total: Optimiser steps in all.
        every_s: Seconds between lines.
    """
    meters: list[Progress] = []

    def tell(step: int, model: object) -> None:
        del model
        if not meters:
            meters.append(Progress(label, total, step - 1, every_s))
        meters[0].update(step, {})

    return tell
