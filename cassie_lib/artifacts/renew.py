"""Take back a notice that has been disproved: present code makes the same bits upstream.

A result is told to rest on older code as soon as a file of an upstream stage changes, whether or
not the change matters to it.  Where the upstream result has been computed anew by present code
and came out bit by bit as it was, the warning has nothing left to warn of.
"""

from __future__ import annotations

from pathlib import Path

from cassie_lib.artifacts.manifest import MANIFEST, Artifact, read_manifest, seal
from cassie_lib.artifacts.stages import STAGES
from cassie_lib.artifacts.store import load, stored
from cassie_lib.files import write_json

#: What a manifest says of notices that were taken back.
RENEWED = "renewed"


def renew() -> dict[str, tuple[str, ...]]:
    """Take back the disproved notices of all stored artifacts, in the order of their stages.

    A line that an artifact has inherited from upstream is taken back when the upstream result at
    hand has the same SHA-256 as the one it was made from, and either was made by present code or
    has had that line taken back itself.  The manifest keeps the line under ``renewed``.

    Returns:
        Name of each artifact that changed, and the lines.

    Raises:
        ArtifactError: If a stored artifact is damaged.
    """
    known: dict[str, Artifact] = {}
    done = {}
    for stage in STAGES:
        for folder in stored(stage):
            lines = _disproved(read_manifest(folder), known)
            if lines:
                _take_back(folder, lines)
                done[folder.name] = lines
            # The copy in the cache comes first and is the one that is used.
            known.setdefault(folder.name, load(folder))
    return done


def _disproved(manifest: dict, known: dict[str, Artifact]) -> tuple[str, ...]:
    lines = []
    for name, digest in manifest["upstream_digests"].items():
        found = known.get(name)
        if found is None or found.digest != digest:
            continue
        inherited = [line for line in manifest["notice"] if line not in found.notice]
        settled = found.manifest.get(RENEWED, ())
        lines += [
            line for line in inherited if line.startswith(f"{name} was made by") or line in settled
        ]
    return tuple(dict.fromkeys(lines))


def _take_back(folder: Path, lines: tuple[str, ...]) -> None:
    manifest = read_manifest(folder)
    manifest["notice"] = [line for line in manifest["notice"] if line not in lines]
    manifest[RENEWED] = list(dict.fromkeys([*manifest.get(RENEWED, ()), *lines]))
    manifest["seal"] = seal(manifest)
    write_json(folder / MANIFEST, manifest)


__all__ = ["RENEWED", "renew"]
