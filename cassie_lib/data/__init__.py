"""Recorded episodes: collection with action noise, an open format on disk, windows as views."""

from __future__ import annotations

from cassie_lib.data.bursts import Bursts
from cassie_lib.data.collect import collect, collect_noise_study
from cassie_lib.data.episodes import CUT, FALL, TIME, Episodes, Windows
from cassie_lib.data.store import CARD, open_dataset, save_dataset

__all__ = [
    "CARD",
    "CUT",
    "FALL",
    "TIME",
    "Bursts",
    "Episodes",
    "Windows",
    "collect",
    "collect_noise_study",
    "open_dataset",
    "save_dataset",
]
