"""How much work it was: to compute anew what was asked for, and all that a result rests on."""

from __future__ import annotations

from collections.abc import Iterable

from cassie_lib.artifacts.manifest import Artifact, read_manifest
from cassie_lib.artifacts.store import stored
from cassie_lib.artifacts.times import read_times
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
        if manifest["preset"] == preset and float(manifest["finished_unix_s"]) >= since:
            found[folder.name] = float(manifest["wall_time_s"])
    return len(found), sum(found.values())


def from_nothing_s(results: Iterable[Artifact]) -> float:
    """Wall time of results and of everything that they rest on, in s; each counts once.

    What has a noted time counts with that, whether it is stored, was collected again or is gone
    (data that a stored model was trained on): :mod:`~cassie_lib.artifacts.times`.
    """
    noted = read_times()
    places = {folder.name: folder for folder in reversed(stored())}
    times: dict[str, float] = {}
    rest = [(item.name, item.manifest) for item in results]
    while rest:
        name, manifest = rest.pop()
        spent = noted[name]["seconds"] if name in noted else manifest["wall_time_s"]
        times[name] = float(spent)
        for upstream in manifest["upstream_digests"]:
            if upstream in noted:
                known = noted[upstream]
                found = {"wall_time_s": known["seconds"], "upstream_digests": known["upstream"]}
            else:
                try:
                    found = read_manifest(places[upstream])
                except (KeyError, ArtifactError):
                    continue  # damage is told by whoever loads it
            rest.append((upstream, found))
    return sum(times.values())


__all__ = ["computed_since", "from_nothing_s"]
