"""Data sets on disk: one ``.npy`` file per field, which any tool can map, and a data card."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cassie_lib.data.episodes import CUT, FALL, Episodes
from cassie_lib.data.fields import FIELDS, schema_card
from cassie_lib.errors import DataError, SchemaError
from cassie_lib.files import (
    UNREADABLE,
    canonical_json,
    replacing,
    sha256_file,
    sha256_text,
    write_json,
)
from cassie_lib.robot.schema import CONTROL_PERIOD_S

CARD = "card.json"
FORMAT = 1
LICENCE = "MIT, as the code that made it"


def save_dataset(folder: Path, episodes: Episodes, name: str, protocol: Mapping[str, Any]) -> dict:
    """Write every field and, last of all, the card; equal data give equal bytes.

    Args:
        folder: Made if it does not exist.
        episodes: The data.
        name: Name of the data set.
        protocol: How the data were collected, JSON-serialisable.

    Returns:
        The card.
    """
    fields = {}
    for item in FIELDS:
        path = folder / f"{item.name}.npy"
        values = np.ascontiguousarray(getattr(episodes, item.name), dtype=item.dtype)
        with replacing(path) as partial:
            np.save(partial, values, allow_pickle=False)
        fields[item.name] = {
            "file": path.name,
            "dtype": values.dtype.str,
            "shape": list(values.shape),
            "unit": item.unit,
            "frame": item.frame,
            "description": item.text,
            "sha256": sha256_file(path),
        }
    card = {
        "name": name,
        "format": FORMAT,
        "title": f"Cassie in simulation, recorded transitions: {name}",
        "licence": LICENCE,
        "protocol": dict(protocol),
        "control_period_s": CONTROL_PERIOD_S,
        "counts": _counts(episodes),
        "fields": fields,
        "schema": schema_card(),
    }
    card["seal"] = _seal(card)
    write_json(folder / CARD, card)
    return card


def open_dataset(folder: Path) -> Episodes:
    """Map a data set into memory after checking it against its card.

    Args:
        folder: Folder of :func:`save_dataset`.

    Raises:
        DataError: If the card or a file is missing, cut or edited, or files do not fit together.
        SchemaError: If it was recorded with another state schema.
    """
    card = read_card(folder)
    if card["schema"]["digest"] != schema_card()["digest"]:
        raise SchemaError(f"{folder.name} was recorded with another state schema than this code's")
    arrays = {}
    for item in FIELDS:
        if item.name not in card["fields"]:
            raise SchemaError(f"{folder.name} has no field {item.name!r}: expected it in {CARD}")
        arrays[item.name] = _open_field(folder, item, card["fields"][item.name])
    return Episodes(**arrays, card=card)


def read_card(folder: Path) -> dict[str, Any]:
    """Read a data card.

    Raises:
        DataError: If it is missing, not JSON, edited or of another format.
    """
    try:
        card = json.loads((folder / CARD).read_text(encoding="utf-8"))
        edited = card["seal"] != _seal(card)
    except FileNotFoundError:
        raise DataError(f"{folder.name}/{CARD} is missing: expected a data set") from None
    except (OSError, ValueError, KeyError, TypeError):
        raise DataError(f"{folder.name}/{CARD} cannot be read: expected a data card") from None
    if edited:
        raise DataError(f"{folder.name}/{CARD} does not match its seal: it was edited or cut")
    if card.get("format") != FORMAT:
        raise DataError(f"{folder.name} has format {card.get('format')}: expected {FORMAT}")
    missing = {"protocol", "counts", "fields", "schema"} - set(card)
    if missing:
        raise DataError(f"{folder.name}/{CARD} lacks {', '.join(sorted(missing))}")
    return card


def _open_field(folder: Path, item: Any, facts: Mapping[str, Any]) -> np.ndarray:
    path = folder / f"{item.name}.npy"
    place = f"{folder.name}/{path.name}"
    if not path.is_file():
        raise DataError(f"{place} is missing: expected it beside {CARD}")
    if sha256_file(path) != facts["sha256"]:
        raise DataError(f"{place} does not match the SHA-256 of {CARD}: it was cut or edited")
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(values, np.ndarray):
            raise ValueError("it is an archive")
    except UNREADABLE as error:
        reason = str(error).splitlines()[0]
        raise DataError(f"{place} cannot be read: expected an .npy file ({reason})") from None
    if values.dtype.str != item.dtype or values.shape[1:] != item.shape:
        raise SchemaError(
            f"{place} holds {values.dtype.str} rows of shape {values.shape[1:]}: expected "
            f"{item.dtype} {item.shape}"
        )
    return values


def _seal(card: Mapping[str, Any]) -> str:
    return sha256_text(canonical_json({k: v for k, v in card.items() if k != "seal"}))


def _counts(episodes: Episodes) -> dict[str, Any]:
    lengths, ends = episodes.episode_lengths, np.asarray(episodes.episode_end)
    return {
        "transitions": len(episodes),
        "episodes": len(lengths),
        "falls": int((ends == FALL).sum()),
        "falling_samples": int(np.count_nonzero(episodes.falling)),
        "episodes_cut": int((ends == CUT).sum()),
        "shortest_episode": int(lengths.min()),
        "longest_episode": int(lengths.max()),
    }
