"""Ways to damage stored artifacts, and what every refusal of one has in common."""

from __future__ import annotations

import json
import shutil

import pytest
from pipeline_toys import LOADERS

from cassie_lib.artifacts import store
from cassie_lib.artifacts.manifest import content_digest, list_files, seal
from cassie_lib.errors import CassieError

MAIN_FILE = {
    "expert": "expert.safetensors",
    "data": "states.npy",
    "mlp": "model.safetensors",
    "transformer": "model.safetensors",
    "causal": "model.safetensors",
    "cem": "episodes.npz",
    "dagger": "model/model.safetensors",
}


class Computed:
    """Stands in the place of every computation: none may begin where a result is refused."""

    class Anew(Exception):  # noqa: N818
        """An artifact of this name is about to be computed."""

    def __call__(self, record, compute, upstream, since):
        raise self.Anew(f"{record['stage']}-{record['key'][:12]}")


class Copies:
    """Artifact folders by stage: links to whole ones, of which those asked for become copies."""

    def __init__(self, source, place, names):
        self.source, self.place, self.names = source, place, names
        place.mkdir(parents=True)
        for folder in source.glob("*-????????????"):
            (place / folder.name).symlink_to(folder)

    def __getitem__(self, kind):
        path = self.place / self.names[kind]
        if path.is_symlink():
            path.unlink()
            shutil.copytree(self.source / path.name, path)
        return path


def content(folder):
    """Bytes of everything in a folder, or of a file."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()] or [folder]
    return {path: path.read_bytes() for path in files if path.is_file()}


def refused(kind, stored, error):
    """Message of the error with which an artifact is refused: typed, one line, nothing changed."""
    before = content(stored[kind])
    with pytest.raises(CassieError) as caught:
        LOADERS[kind]()
    assert isinstance(caught.value, error), repr(caught.value)
    message = str(caught.value)
    assert "\n" not in message
    assert content(stored[kind]) == before, "neither deleted nor replaced"
    return message


def swap(one, other):
    """Exchange two files."""
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


def edit_manifest(sealed=True, **changes):
    """Edit a manifest; sealed: the way a program would that writes manifests of its own.

    None removes an entry; files and digest are brought up to date.
    """

    def edit(path):
        manifest = json.loads(path.read_text())
        if sealed:
            manifest["files"] = list_files(path.parent)
            manifest["digest"] = content_digest(manifest["files"])
        manifest |= changes
        manifest = {name: value for name, value in manifest.items() if value is not None}
        if sealed:
            manifest["seal"] = seal(manifest)
        path.write_text(json.dumps(manifest))

    return edit


def refuse_to_compute(monkeypatch):
    """Have every computation raise; returns the stand-in."""
    computed = Computed()
    monkeypatch.setattr(store, "_compute", computed)
    return computed
