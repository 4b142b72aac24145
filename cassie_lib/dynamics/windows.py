"""Recorded transitions as contiguous arrays, and windows that never cross an episode end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from cassie_lib.errors import DataError, NonFiniteError, ParameterError, ShapeError
from cassie_lib.robot import schema

_MIRROR = torch.tensor([c.mirror for c in schema.COMPONENTS])
_MIRROR_SIGN = torch.tensor([float(c.sign) for c in schema.COMPONENTS])
_IDENTITY = np.eye(schema.ACTION_SIZE)
_ACTION_MATRIX = torch.as_tensor(schema.mirror_action(_IDENTITY), dtype=torch.float32)


class Window(NamedTuple):
    """A batch of windows of ``L`` consecutive states.

    Attributes:
        states: ``(B, L, 49)`` float32, physical units.
        actions: ``(B, L, 10)`` float32, rad; ``actions[:, t]`` was applied at ``states[:, t]``.
        phase: ``(B, L)`` int64, 0..27.
    """

    states: torch.Tensor
    actions: torch.Tensor
    phase: torch.Tensor


@dataclass(frozen=True)
class Transitions:
    """Episodes laid end to end.

    ``actions[t]`` is applied at ``states[t]`` and leads to ``states[t + 1]`` of the same episode.

    Attributes:
        states: ``(T, 49)`` float32, physical units (may be a memory map).
        actions: ``(T, 10)`` float32, rad.
        phase: ``(T,)`` integers 0..27.
        episode_starts: ``(M,)`` int64, increasing, the first one 0.

    Raises:
        ShapeError: If an array has another shape.
        DataError: If there is no transition or the starts are not increasing from 0.
        NonFiniteError: If a state or an action is NaN or infinite.
    """

    states: np.ndarray
    actions: np.ndarray
    phase: np.ndarray
    episode_starts: np.ndarray

    def __post_init__(self) -> None:
        count = len(self.states)
        for name, shape in (
            ("states", (count, schema.STATE_SIZE)),
            ("actions", (count, schema.ACTION_SIZE)),
            ("phase", (count,)),
        ):
            if getattr(self, name).shape != shape:
                raise ShapeError(f"{name} has shape {getattr(self, name).shape}: expected {shape}")
        starts = np.asarray(self.episode_starts)
        if count == 0 or len(starts) == 0:
            raise DataError("transitions are empty: expected at least one episode")
        if starts[0] != 0 or np.any(np.diff(starts) <= 0) or starts[-1] >= count:
            raise DataError(f"episode_starts must increase from 0 to under {count}")
        for name in ("states", "actions"):
            if not np.isfinite(getattr(self, name)).all():
                raise NonFiniteError(f"{name} holds NaN or infinity: expected finite values")

    def __len__(self) -> int:
        return len(self.states)

    @property
    def episode_lengths(self) -> np.ndarray:
        """Control steps of each episode, ``(M,)``."""
        return np.diff(np.append(self.episode_starts, len(self.states)))

    def window_starts(self, length: int) -> np.ndarray:
        """Every start whose window of ``length`` states lies inside one episode, ``(N,)`` int64.

        Raises:
            ParameterError: If ``length`` is under 2.
            DataError: If no episode is that long.
        """
        if length < 2:
            raise ParameterError(f"window length is {length}: expected at least 2")
        pieces = [
            np.arange(start, start + size - length + 1)
            for start, size in zip(self.episode_starts, self.episode_lengths, strict=True)
        ]
        starts = np.concatenate(pieces).astype(np.int64)
        if len(starts) == 0:
            longest = int(self.episode_lengths.max())
            raise DataError(f"window length is {length}: the longest episode has {longest} states")
        return starts

    def gather(self, starts: np.ndarray, length: int) -> Window:
        """Copy the windows of ``length`` states that begin at ``starts`` ``(B,)``."""
        index = np.asarray(starts)[:, None] + np.arange(length)
        return Window(
            torch.from_numpy(np.ascontiguousarray(self.states[index], dtype=np.float32)),
            torch.from_numpy(np.ascontiguousarray(self.actions[index], dtype=np.float32)),
            torch.from_numpy(np.asarray(self.phase)[index].astype(np.int64)),
        )


def concatenate(parts: Sequence[Transitions]) -> Transitions:
    """Lay several recordings end to end.

    Raises:
        DataError: If ``parts`` is empty.
    """
    if not parts:
        raise DataError("nothing to concatenate: expected at least one recording")
    offsets = np.cumsum([0] + [len(part) for part in parts[:-1]])
    return Transitions(
        np.concatenate([part.states for part in parts]),
        np.concatenate([part.actions for part in parts]),
        np.concatenate([part.phase for part in parts]),
        np.concatenate(
            [
                part.episode_starts + offset
                for part, offset in zip(parts, offsets, strict=True)
            ]
        ),
    )


def mirror_window(window: Window) -> Window:
    """Exchange left and right in a batch of windows; the phase moves by half a cycle."""
    phase = (window.phase + schema.PERIOD // 2) % schema.PERIOD
    states = window.states[..., _MIRROR] * _MIRROR_SIGN
    states[..., schema.CLOCK] = torch.from_numpy(schema.clock(phase.numpy())).to(states.dtype)
    return Window(states, window.actions @ _ACTION_MATRIX, phase)


__all__ = ["Transitions", "Window", "concatenate", "mirror_window"]
