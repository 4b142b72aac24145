"""Episodes laid end to end, and windows that never cross an episode's end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cassie_lib.data.fields import EPISODE_NAMES, FIELDS, SAMPLE_NAMES
from cassie_lib.errors import DataError, NonFiniteError, ParameterError, ShapeError, unknown_name
from cassie_lib.robot.schema import PERIOD

#: Why an episode ended: time limit, fall, or cut because enough had been collected (or by a split).
TIME, FALL, CUT = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Episodes:
    """M episodes of T control steps in all; every array may be a memory map.

    ``actions[t]`` was applied at ``states[t]`` and led to ``states[t + 1]`` of the same episode,
    or to its ``final_states`` row.

    Attributes:
        states: ``(T, 49)`` float32, Table 4.1.
        actions: ``(T, 10)`` float32, rad; executed, noise included.
        mean_actions: ``(T, 10)`` float32, rad; before the noise.
        phase: ``(T,)`` uint8, 0..27.
        pelvis_position: ``(T, 3)`` float32, m, world.
        foot_position: ``(T, 2, 3)`` float32, m, world; left and right.
        foot_height: ``(T, 2)`` float32, m over the floor.
        foot_force: ``(T, 2, 3)`` float32, N, world.
        falling: ``(T,)`` bool, the last 28 samples before a fall.
        episode_starts: ``(M,)`` int64, increasing from 0.
        episode_end: ``(M,)`` uint8: :data:`TIME`, :data:`FALL` or :data:`CUT`.
        final_states: ``(M, 49)`` float32, after the last action.
        noise_std_rad: ``(M,)`` float64.
        card: The data card.

    Raises:
        ShapeError: If an array has another shape.
        DataError: If there is no episode, the starts do not increase from 0, or a phase is
            outside 0..27.
        NonFiniteError: If a state, action or force is NaN or infinite.
    """

    states: np.ndarray
    actions: np.ndarray
    mean_actions: np.ndarray
    phase: np.ndarray
    pelvis_position: np.ndarray
    foot_position: np.ndarray
    foot_height: np.ndarray
    foot_force: np.ndarray
    falling: np.ndarray
    episode_starts: np.ndarray
    episode_end: np.ndarray
    final_states: np.ndarray
    noise_std_rad: np.ndarray
    card: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count, episodes = len(self.states), len(self.episode_starts)
        if count == 0 or episodes == 0:
            raise DataError("data set is empty: expected at least one episode of one sample")
        for item in FIELDS:
            found = getattr(self, item.name).shape
            expected = (episodes if item.per_episode else count, *item.shape)
            if found != expected:
                raise ShapeError(f"{item.name} has shape {found}: expected {expected}")
        starts = np.asarray(self.episode_starts)
        if starts[0] != 0 or np.any(np.diff(starts) <= 0) or starts[-1] >= count:
            raise DataError(f"episode_starts must increase from 0 to under {count}")
        if int(np.max(self.phase)) >= PERIOD:
            raise DataError(f"phase reaches {int(np.max(self.phase))}: expected 0..{PERIOD - 1}")
        for name in ("states", "actions", "foot_force", "final_states"):
            if not np.isfinite(getattr(self, name)).all():
                raise NonFiniteError(f"{name} holds NaN or infinity: expected finite values")

    def __len__(self) -> int:
        return len(self.states)

    @property
    def episode_lengths(self) -> np.ndarray:
        """Control steps of each episode, ``(M,)``."""
        return np.diff(np.append(self.episode_starts, len(self)))

    @property
    def fell(self) -> np.ndarray:
        """Whether each episode ended in a fall, ``(M,)`` bool."""
        return np.asarray(self.episode_end) == FALL

    def rows(self, episode: int) -> slice:
        """Samples of one episode, as a slice into every per-sample array.

        Raises:
            ParameterError: If there is no such episode.
        """
        if not 0 <= episode < len(self.episode_starts):
            raise ParameterError(
                f"episode is {episode}: expected 0 to {len(self.episode_starts) - 1}"
            )
        start = int(self.episode_starts[episode])
        return slice(start, start + int(self.episode_lengths[episode]))

    def by_episode(self, name: str, steps: int = 0) -> np.ndarray:
        """Copy of a per-sample array as ``(M, steps, ...)`` float32, NaN after each end.

        Args:
            name: A per-sample field.
            steps: Control steps; 0 is the longest episode.

        Raises:
            UnknownNameError: If there is no such per-sample field.
        """
        values, lengths = self._samples(name), self.episode_lengths
        steps = steps or int(lengths.max())
        result = np.full((len(lengths), steps, *values.shape[1:]), np.nan, dtype=np.float32)
        for episode, length in enumerate(lengths):
            kept = min(int(length), steps)
            start = int(self.episode_starts[episode])
            result[episode, :kept] = values[start : start + kept]
        return result

    def windows(self, length: int) -> Windows:
        """All windows of ``length`` consecutive samples within one episode.

        Raises:
            ParameterError: If ``length`` is under 1.
            DataError: If no episode is that long.
        """
        if length < 1:
            raise ParameterError(f"window length is {length}: expected at least 1")
        lengths = self.episode_lengths
        pieces = [
            np.arange(start, start + size - length + 1, dtype=np.int64)
            for start, size in zip(self.episode_starts, lengths, strict=True)
        ]
        starts = np.concatenate(pieces)
        if len(starts) == 0:
            raise DataError(
                f"window length is {length}: the longest episode has {lengths.max()} samples"
            )
        return Windows(self, length, starts)

    def part(self, begin: int, end: int) -> Episodes:
        """Samples ``begin`` to ``end`` as views; an episode that is cut through ends as CUT.

        Raises:
            DataError: If the part is empty or outside the data.
        """
        if not 0 <= begin < end <= len(self):
            raise DataError(f"part {begin}..{end} of {len(self)} samples: expected a part of them")
        ends = np.append(self.episode_starts[1:], len(self))
        chosen = np.flatnonzero((np.asarray(self.episode_starts) < end) & (ends > begin))
        rows = {name: getattr(self, name)[begin:end] for name in SAMPLE_NAMES}
        meta = {name: getattr(self, name)[chosen] for name in EPISODE_NAMES}
        meta["episode_starts"] = np.maximum(meta["episode_starts"] - begin, 0)
        if ends[chosen[-1]] > end:
            meta["episode_end"], meta["final_states"] = (
                meta["episode_end"].copy(), meta["final_states"].copy(),
            )  # fmt: skip
            meta["episode_end"][-1], meta["final_states"][-1] = CUT, self.states[end]
        return Episodes(**rows, **meta, card={**self.card, "part": [begin, end]})

    def split(self, *fractions: float) -> tuple[Episodes, ...]:
        """Contiguous parts by fraction of the samples, in order (section 5.1.1: 0.7, 0.3).

        No window lies in two parts.

        Args:
            fractions: Positive, at most 1 together.

        Raises:
            ParameterError: If a fraction is not positive or they exceed 1.
            DataError: If a part would be empty.
        """
        if not fractions or min(fractions) <= 0.0 or sum(fractions) > 1.0 + 1e-9:
            raise ParameterError(f"fractions are {fractions}: expected positive ones, sum <= 1")
        bounds = np.rint(np.cumsum([0.0, *fractions]) * len(self)).astype(int).tolist()
        for share, begin, end in zip(fractions, bounds, bounds[1:], strict=False):
            if end <= begin:
                raise DataError(f"fraction {share} of {len(self)} samples is an empty split")
        return tuple(self.part(begin, end) for begin, end in zip(bounds, bounds[1:], strict=False))

    def _samples(self, name: str) -> np.ndarray:
        if name not in SAMPLE_NAMES:
            raise unknown_name("per-sample field", name, SAMPLE_NAMES)
        return getattr(self, name)


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of equal length over a data set: an index, no copies.

    Attributes:
        source: The data set.
        length: Samples per window.
        starts: First row of each window, ``(N,)`` int64.
    """

    source: Episodes
    length: int
    starts: np.ndarray

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def lost(self) -> int:
        """Windows that one unbroken recording of as many samples would have had besides."""
        return max(0, len(self.source) - self.length + 1) - len(self)

    @property
    def short_episodes(self) -> int:
        """Episodes that are shorter than a window and hold none."""
        return int((self.source.episode_lengths < self.length).sum())

    def view(self, name: str) -> np.ndarray:
        """Zero-copy view ``(T - length + 1, length, ...)`` of a per-sample field.

        Row i begins at sample i; only the rows in :attr:`starts` stay within one episode.

        Raises:
            UnknownNameError: If there is no such per-sample field.
        """
        values = sliding_window_view(self.source._samples(name), self.length, axis=0)
        return np.moveaxis(values, -1, 1)

    def gather(self, name: str, chosen: Any) -> np.ndarray:
        """Copy of chosen windows ``(B, length, ...)``.

        Args:
            name: A per-sample field.
            chosen: Indices into the windows, ``(B,)`` or a slice.

        Raises:
            UnknownNameError: If there is no such per-sample field.
        """
        return np.asarray(self.view(name)[self.starts[chosen]])

    def report(self) -> str:
        """One line: how many windows there are and how many the episode ends cost."""
        text = (
            f"{len(self):,} windows of {self.length} from {len(self.source):,} samples, "
            f"{self.lost:,} lost at {len(self.source.episode_starts) - 1:,} inner episode ends"
        )
        return text + (f", {self.short_episodes:,} episodes too short" * bool(self.short_episodes))
