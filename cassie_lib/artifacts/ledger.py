"""How much work a request to compute anew has been, over all its sessions."""

from __future__ import annotations

from cassie_lib.artifacts.manifest import read_manifest
from cassie_lib.artifacts.store import stored
from cassie_lib.errors import ArtifactError


def computed_since(since: float, preset: str) -> tuple[int, float]:
    """Number of results of a preset computed since a moment, and the time they took together.

    Results that were computed side by side count each with their own time, and so do the sessions
    of one that was killed and went on.

    Args:
        since: Unix time in s.
        preset: Name of the preset.

    Returns:
        Number of results and their wall time in s.
    """
    found = {}
    for folder in stored():
        try:
            manifest = read_manifest(folder)
        except ArtifactError:
            continue  # not made now: what is damaged is told on load
        own = str(manifest["preset"]).split(",")[0] == preset
        if own and float(manifest["finished_unix_s"]) >= since:
            found[folder.name] = float(manifest["wall_time_s"])
    return len(found), sum(found.values())


__all__ = ["computed_since"]
