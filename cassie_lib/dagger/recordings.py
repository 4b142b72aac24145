"""Recordings of a round: stored, split by episode, padded starts, weights of older rounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from cassie_lib.dynamics.windows import Transitions
from cassie_lib.errors import ArtifactError, CassieError, DataError, ParameterError
from cassie_lib.files import UNREADABLE, replacing
from cassie_lib.packing import packed, unpacked
from cassie_lib.recording import Recording
from cassie_lib.robot.schema import ACTION_SIZE

_ARRAYS = tuple(field.name for field in fields(Transitions))
_OVER_TIME = ("states", "actions")


def to_transitions(recorded, begin: int = 0) -> Transitions:
    """Transitions of a data set or of a recording of episodes.

    Args:
        recorded: :class:`cassie_lib.data.Episodes` or :class:`cassie_lib.walking.Recording`.
        begin: First control step of each recorded episode that counts, e.g. the hand-over; only
            for a recording.

    Raises:
        DataError: If no episode lasted that long.
    """
    if not isinstance(recorded, Recording):
        return Transitions(
            recorded.states, recorded.actions, recorded.phase, np.asarray(recorded.episode_starts)
        )
    steps = recorded.actions.shape[1]
    # The action at which the robot fell counts, too.
    ends = np.minimum(recorded.length + 1, steps)
    rows = [np.arange(begin, end) for end in ends]
    parts = [(episode, row) for episode, row in enumerate(rows) if len(row)]
    if not parts:
        raise DataError(f"no episode is longer than {begin} control steps: expected at least one")
    return Transitions(
        np.concatenate([recorded.states[e, r] for e, r in parts]).astype(np.float32),
        np.concatenate([recorded.actions[e, r] for e, r in parts]).astype(np.float32),
        np.concatenate([recorded.phase[e, r] for e, r in parts]),
        np.cumsum([0, *(len(row) for _, row in parts[:-1])]),
    )


def save_transitions(path: Path, transitions: Transitions) -> None:
    """Write transitions to one ``.npz`` file, no pickle: the arrays by their names.

    States and actions are packed (:mod:`cassie_lib.packing`): what comes back is within
    :data:`~cassie_lib.packing.RELATIVE_ERROR`.
    """
    arrays = {name: np.asarray(getattr(transitions, name)) for name in _ARRAYS}
    # Time is the second dimension of what is packed.
    arrays |= {name: arrays[name][None] for name in _OVER_TIME}
    with replacing(path) as partial:
        np.savez_compressed(partial, allow_pickle=False, **packed(arrays))


def load_transitions(path: Path) -> Transitions:
    """Read what :func:`save_transitions` wrote.

    Raises:
        ArtifactError: If the file is missing, damaged or of another format.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = unpacked(stored)
        arrays |= {name: arrays[name].reshape(-1, arrays[name].shape[-1]) for name in _OVER_TIME}
        return Transitions(**{name: arrays[name] for name in _ARRAYS})
    except (*UNREADABLE, CassieError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ArtifactError(f"{path.name} holds no transitions: {reason}") from error


def split_by_episode(
    transitions: Transitions, shares: Sequence[float], seed: int
) -> tuple[Transitions, ...]:
    """Split into parts of whole episodes, drawn at random: no episode is in two parts.

    Args:
        transitions: The recording.
        shares: Share of the episodes in each part, together 1; every part gets at least one.
        seed: Seed of the draw.

    Raises:
        ParameterError: If the shares are not positive or do not sum to 1.
        DataError: If there are fewer episodes than parts.
    """
    if min(shares) <= 0 or abs(sum(shares) - 1.0) > 1e-6:
        raise ParameterError(f"split is {tuple(shares)}: expected positive shares that sum to 1")
    count = len(transitions.episode_starts)
    if count < len(shares):
        raise DataError(f"{count} episodes cannot be split into {len(shares)} parts")
    bounds = np.rint(np.cumsum([0.0, *shares]) * count).astype(int)
    # Rounding may leave a part without an episode.
    for index in range(1, len(shares)):
        bounds[index] = np.clip(bounds[index], bounds[index - 1] + 1, count - len(shares) + index)
    order = np.random.default_rng(seed).permutation(count)
    return tuple(
        _episodes(transitions, np.sort(order[low:high]))
        for low, high in zip(bounds, bounds[1:], strict=False)
    )


def _episodes(transitions: Transitions, chosen: np.ndarray) -> Transitions:
    lengths = transitions.episode_lengths[chosen]
    rows = np.concatenate(
        [
            np.arange(start, start + size)
            for start, size in zip(transitions.episode_starts[chosen], lengths, strict=True)
        ]
    )
    return Transitions(
        transitions.states[rows],
        transitions.actions[rows],
        transitions.phase[rows],
        np.cumsum([0, *lengths[:-1]]),
    )


def pad_starts(transitions: Transitions, context: int) -> Transitions:
    """Let every episode begin as a start without expert does: copies of s0, zero actions.

    A model that has never seen such a context cannot predict from it.

    Args:
        transitions: Episodes that begin at s0.
        context: H; each episode gets H - 1 rows in front, at the phase of its first state.
    """
    starts, lengths = transitions.episode_starts, transitions.episode_lengths
    rows = np.concatenate(
        [
            np.concatenate([np.full(context - 1, start), np.arange(start, start + size)])
            for start, size in zip(starts, lengths, strict=True)
        ]
    )
    begins = np.cumsum([0, *(lengths[:-1] + context - 1)])
    actions = np.array(transitions.actions[rows])
    actions[(begins[:, None] + np.arange(context - 1)).ravel()] = np.zeros(ACTION_SIZE)
    return Transitions(transitions.states[rows], actions, transitions.phase[rows], begins)


def check_shares(decay: float, rounds_share: float | None) -> None:
    """Refuse weights of the rounds that are none; see :func:`window_shares`.

    Raises:
        ParameterError: If beta or the share of the rounds is out of range.
    """
    if not 0.0 < decay <= 1.0:
        raise ParameterError(f"decay is {decay}: expected 0 < beta <= 1")
    if rounds_share is not None and not 0.0 <= rounds_share <= 1.0:
        raise ParameterError(f"rounds_share is {rounds_share}: expected 0 to 1, or None")


def window_shares(
    sources: Sequence[Transitions],
    ages: Sequence[int],
    decay: float,
    length: int,
    *,
    first: int = 0,
    rounds_share: float | None = None,
) -> list[float]:
    """Share of each recording in the training batches: its windows times beta**age.

    Args:
        sources: Recordings.
        ages: Rounds since each was collected; the newest has 0.
        decay: beta, 0 to 1; 1 keeps everything.
        length: States per window.
        first: How many of the recordings, in front, are what the first model was trained on.
        rounds_share: What the others get together, shared out in the same way; None: what their
            windows give them.

    Raises:
        ParameterError: If beta or the share of the rounds is out of range.
    """
    check_shares(decay, rounds_share)
    if rounds_share is not None and not 0 < first < len(sources):
        raise ParameterError(
            f"first is {first}: expected 1 to {len(sources) - 1}, so that each part has a recording"
        )
    weights = np.array(
        [
            len(source.window_starts(length)) * decay**age
            for source, age in zip(sources, ages, strict=True)
        ]
    )
    weights /= weights.sum()
    if rounds_share is not None:
        weights[:first] *= (1.0 - rounds_share) / weights[:first].sum()
        weights[first:] *= rounds_share / weights[first:].sum()
    return weights.tolist()
