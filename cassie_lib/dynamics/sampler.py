"""Random windows from several recordings, the same for a batch number whatever came before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from cassie_lib.dynamics.windows import Transitions, Window, mirror_window
from cassie_lib.errors import ParameterError


class Sampler:
    """Batch ``i`` depends on the seed and ``i`` alone, so that a resumed run sees the same ones.

    Attributes:
        starts: Window starts of each recording.
    """

    def __init__(
        self,
        sources: Sequence[Transitions],
        shares: Sequence[float] | None,
        length: int,
        batch_size: int,
        seed: int,
        mirror: bool,
    ) -> None:
        """Prepare to draw.

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
        half = torch.from_numpy(random.permutation(self.batch_size)[: self.batch_size // 2])
        mirrored = mirror_window(Window(*(part[half] for part in window)))
        for part, changed in zip(window, mirrored, strict=True):
            part[half] = changed
        return window


__all__ = ["Sampler"]
