"""Stored results that are damaged: named, never used, never deleted."""

from __future__ import annotations

import json
import os
import shutil
import time

import pytest
from artifact_toys import DAMAGES, Counted, damage_flip, make

from cassie_lib import paths
from cassie_lib.artifacts import manifest, recompute
from cassie_lib.errors import ArtifactError
from cassie_lib.files import sha256_file

pytestmark = pytest.mark.usefixtures("artifact_folders")


def settle(artifact, age_s=60):
    """As if its files had been written a while ago."""
    then = time.time() - age_s
    for path in artifact.path.rglob("*"):
        os.utime(path, (then, then))


@pytest.mark.parametrize("loaded_before", [False, True])
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", ["weights.bin", "sub/log.csv", "timing.csv", "manifest.json"])
def test_any_damage_is_named_and_never_used_or_deleted(name, damage, loaded_before):
    compute = Counted()
    artifact = make(compute=compute)
    if loaded_before:
        settle(artifact)
        assert make(compute=compute).from_cache
    damage(artifact.path / name)
    before = sorted(path.name for path in artifact.path.rglob("*"))
    with pytest.raises(ArtifactError, match=r"is damaged: .*make figures RECOMPUTE=data") as error:
        make(compute=compute)
    assert name in str(error.value)
    assert "\n" not in str(error.value)
    assert compute.runs == 1
    assert sorted(path.name for path in artifact.path.rglob("*")) == before


@pytest.mark.parametrize(
    "field", ["wall_time_s", "parameters", "key", "files", "version", "digest"]
)
def test_an_edited_manifest_is_refused(field):
    artifact = make()
    file = artifact.path / "manifest.json"
    found = json.loads(file.read_text())
    found[field] = {"size": 9} if isinstance(found[field], dict) else "0" * 64
    file.write_text(json.dumps(found))
    with pytest.raises(ArtifactError, match=r"manifest\.json"):
        make()


def test_an_artifact_in_the_folder_of_another_is_refused():
    one, other = make(), make({"other": 1})
    shutil.rmtree(one.path)
    shutil.copytree(other.path, one.path)
    with pytest.raises(ArtifactError, match=f"belongs to {other.name}"):
        make()


def test_an_unlisted_file_is_refused_and_a_hidden_one_is_not():
    artifact = make()
    (artifact.path / ".DS_Store").write_text("x")
    assert make().from_cache
    (artifact.path / "weights (copy).bin").write_text("x")
    with pytest.raises(ArtifactError, match="not in manifest"):
        make()
    with pytest.raises(ArtifactError, match=r"no file 'x': it has .*weights\.bin"):
        artifact.file("x")


def test_files_that_have_not_changed_are_read_once_by_a_process(monkeypatch):
    artifact, read = make(), []

    def sha256(path):
        read.append(path.name)
        return sha256_file(path)

    monkeypatch.setattr(manifest, "sha256_file", sha256)
    make(), make()
    assert len(read) == 2 * len(artifact.manifest["files"]), "written just now: read each time"
    settle(artifact)
    read.clear()
    make(), make()
    assert sorted(read) == sorted(name.split("/")[-1] for name in artifact.manifest["files"])


def test_recompute_replaces_a_damaged_artifact_once(monkeypatch):
    compute = Counted()
    damage_flip(make(compute=compute).path / "weights.bin")
    monkeypatch.setenv(recompute.REQUEST, "data")
    assert not make(compute=compute).from_cache
    assert make(compute=compute).from_cache
    assert compute.runs == 2
    assert not list(paths.CACHE.glob("*.partial"))
