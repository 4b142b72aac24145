"""Which notebooks are done: a stamp says what a run was made of, so that a change is noticed.

Everything is compared by content: a touched file or a rewritten comment runs nothing again.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from cassie_lib import paths
from cassie_lib.artifacts.manifest import read_manifest
from cassie_lib.code_version import code_fingerprint, lock_hash
from cassie_lib.errors import ArtifactError
from cassie_lib.files import canonical_json, sha256_file, sha256_text, write_json

#: Modules that carry a notebook out but leave no trace in it.
_OUTSIDE = {"batch.py", "notebook_run.py", "stamps.py", "gallery.py", "results.py"}


def stamp_file(preset: str, number: str) -> Path:
    """File that says that a notebook is done; Snakemake knows it as the output of a rule."""
    return paths.CACHE / "batch" / preset / f"{number}.done"


def inputs_hash(notebook: Path) -> str:
    """Hash of what a run depends on besides artifacts: notebook, library code and lock."""
    code = {k: v for k, v in code_fingerprint(("",)).items() if k not in _OUTSIDE}
    return sha256_text(canonical_json([sha256_file(notebook), code, lock_hash()]))


def write_stamp(stamp: Path, inputs: str, used: Iterable[str]) -> None:
    """Note that a notebook is done.

    Args:
        stamp: From :func:`stamp_file`.
        inputs: :func:`inputs_hash` as it was when the run began.
        used: Lines ``name digest`` of the artifacts that it used.
    """
    artifacts = dict(line.split() for line in used if len(line.split()) == 2)
    write_json(stamp, {"inputs": inputs, "artifacts": dict(sorted(artifacts.items()))})


def is_stale(preset: str, notebook: Path) -> bool:
    """Whether there is a stamp that no longer holds.

    The executed copy was deleted, the notebook, library or lock has changed, or an artifact that
    it used has been computed anew with other content.
    """
    stamp = stamp_file(preset, notebook.name[:2])
    if not stamp.exists():
        return False
    if not (paths.executed_folder(preset) / notebook.name).exists():
        return True
    try:
        noted = json.loads(stamp.read_text(encoding="utf-8"))
        used = dict(noted["artifacts"])
        if noted["inputs"] != inputs_hash(notebook):
            return True
    except (ValueError, KeyError, TypeError):
        return True
    return any(_digest(name) not in ("", digest) for name, digest in used.items())


def _digest(name: str) -> str:
    """Content digest of a stored artifact, found where it would be loaded from."""
    for place in (paths.CACHE, paths.DATA):
        if (place / name).is_dir():
            try:
                return str(read_manifest(place / name)["digest"])
            except ArtifactError:
                return "damaged"
    return ""


def forget_stale(preset: str, notebooks: Iterable[Path]) -> None:
    """Remove the stamps that no longer hold."""
    for notebook in notebooks:
        if is_stale(preset, notebook):
            stamp_file(preset, notebook.name[:2]).unlink(missing_ok=True)
