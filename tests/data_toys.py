"""Synthetic episodes with known lengths: sample i of episode e holds e and i."""

from __future__ import annotations

import numpy as np

from cassie_lib.data.episodes import FALL, TIME, Episodes
from cassie_lib.data.fields import FIELDS
from cassie_lib.robot.schema import PERIOD


def toy_episodes(lengths, falls=None) -> Episodes:
    lengths = np.asarray(lengths)
    falls = np.zeros(len(lengths), bool) if falls is None else np.asarray(falls)
    count = int(lengths.sum())
    arrays = {
        item.name: np.zeros((len(lengths) if item.per_episode else count, *item.shape), item.dtype)
        for item in FIELDS
    }
    episode = np.repeat(np.arange(len(lengths)), lengths)
    step = np.concatenate([np.arange(length) for length in lengths])
    arrays["states"][:, 0], arrays["states"][:, 1] = episode, step
    arrays["actions"][:, 0] = np.arange(count)
    arrays["phase"][:] = step % PERIOD
    arrays["episode_starts"][:] = np.cumsum(np.append(0, lengths[:-1]))
    arrays["episode_end"][:] = np.where(falls, FALL, TIME)
    arrays["final_states"][:, 1] = lengths
    arrays["falling"][:] = falls[episode] & (step >= lengths[episode] - PERIOD)
    return Episodes(**arrays)
