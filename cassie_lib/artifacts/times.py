"""``data/wall_times.json``: how long results took that git does not keep.

A stored model rests on data sets that are collected again in minutes.  How long that was belongs to
the time from nothing, whether they are at hand or not.
"""

from __future__ import annotations

import json
from typing import Any

from cassie_lib import paths
from cassie_lib.files import locked, write_json

FILE = "wall_times.json"
#: Name of a result -> seconds and names of what it was computed from.
Times = dict[str, dict[str, Any]]


def read_times() -> Times:
    """What is known; nothing when the file is missing or cannot be read."""
    try:
        found = json.loads((paths.DATA / FILE).read_text(encoding="utf-8"))
        return {
            str(name): {
                "seconds": float(item["seconds"]),
                "upstream": [str(other) for other in item["upstream"]],
            }
            for name, item in found.items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def note_time(name: str, manifest: dict[str, Any], anew: bool) -> None:
    """Note what a result of ``laptop`` took.

    Args:
        name: Name of the artifact.
        manifest: Its manifest; one of another preset is not noted.
        anew: Whether it was asked for anew.  Otherwise what is noted stays: nobody's figures are
            to change because a data set was collected again.
    """
    if manifest["preset"] != "laptop":
        return
    with locked(paths.CACHE / "locks" / "wall-times.lock", "it notes a time"):
        known = read_times()
        if name in known and not anew:
            return
        upstream = sorted(manifest["upstream_digests"])
        known[name] = {"seconds": manifest["wall_time_s"], "upstream": upstream}
        paths.DATA.mkdir(parents=True, exist_ok=True)
        write_json(paths.DATA / FILE, dict(sorted(known.items())))


__all__ = ["FILE", "note_time", "read_times"]
