"""Stored results: found for exactly their recipe, with what a reader must know of them."""

from __future__ import annotations

import multiprocessing
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
from artifact_toys import Counted, Parameters, damage_flip, make

from cassie_lib import artifacts, paths
from cassie_lib.artifacts import recompute, stages, store
from cassie_lib.artifacts.__main__ import main
from cassie_lib.errors import ArtifactError, ParameterError, UnknownNameError

pytestmark = pytest.mark.usefixtures("artifact_folders")


def test_second_call_loads_what_the_first_computed():
    compute = Counted()
    first = make(compute=compute, preset="smoke")
    second = make(compute=compute, preset="smoke")
    assert compute.runs == 1
    assert (first.from_cache, second.from_cache) == (False, True)
    assert second.path.name == second.name
    assert second.file("weights.bin").read_bytes() == b"\x00\x01" * 500
    assert second.manifest["seed"] == 7
    assert second.manifest["preset"] == "smoke"
    assert second.manifest["libraries"]["numpy"] == np.__version__
    assert second.notice == ()
    assert not list(paths.CACHE.glob("*.partial"))


@pytest.mark.parametrize(
    "change", [{"size": 4}, {"rate": 2e-3}, {"name": "b"}, {"weights": (1.0, 2.5)}, {"seed": 8}]
)
def test_every_parameter_changes_the_key(change):
    compute = Counted()
    assert make(compute=compute).key != make(replace(Parameters(), **change), compute=compute).key
    assert compute.runs == 2


def test_stage_and_its_version_change_the_key(monkeypatch):
    key = make().key
    assert make(stage="walking").key != key
    stage = stages.STAGES["data"]
    monkeypatch.setitem(stages.STAGES, "data", replace(stage, version=stage.version + 1))
    assert make().key != key


def test_key_does_not_depend_on_how_the_same_values_are_held():
    plain = {"seed": 7, "weights": [1.0, 2.0], "name": "a", "rate": np.float64(1e-3), "size": 3}
    assert make(plain).key == make().key


def test_upstream_counts_by_content_for_weights_and_by_recipe_for_data():
    one = make(stage="expert", compute=Counted("one"))
    key = make(upstream=[one]).key
    shutil.rmtree(one.path)
    same = make(stage="expert", compute=Counted("one"))
    assert same.key == one.key
    assert make(upstream=[same]).key == key, "timing files are no content"
    shutil.rmtree(one.path)
    other = make(stage="expert", compute=Counted("other"))
    assert other.key == one.key
    assert make(upstream=[other]).key != key
    data = make(stage="data", compute=Counted("one"))
    trained = make(stage="mlp", upstream=[data])
    shutil.rmtree(data.path)
    again = make(stage="data", compute=Counted("rounded otherwise"))
    loaded = make(stage="mlp", upstream=[again])
    assert loaded.key == trained.key
    assert loaded.from_cache
    assert any(data.name in line and "another copy" in line for line in loaded.notice)


def test_order_of_upstream_counts():
    a, b = make({"a": 1}), make({"b": 1})
    assert make(stage="mlp", upstream=[a, b]).key != make(stage="mlp", upstream=[b, a]).key


@pytest.mark.parametrize(
    ("bad", "expected"),
    [({"x": float("nan")}, r"parameters\.x is nan"), ({"x": {"y": object()}}, r"parameters\.x\.y")],
)
def test_parameters_without_a_canonical_form_are_refused(bad, expected):
    with pytest.raises(ParameterError, match=expected):
        make(bad)


def test_unknown_stage_lists_the_known_ones():
    with pytest.raises(UnknownNameError, match=r"'nix'.*expert"):
        make(stage="nix")


def test_kept_artifacts_are_found_without_a_cache():
    compute = Counted()
    make(compute=compute, preset="smoke", kept=True)
    assert not paths.DATA.exists(), "only laptop results go to git"
    shutil.rmtree(paths.CACHE)
    artifact = make(compute=compute, preset="laptop", kept=True)
    assert artifacts.keep(artifact) == paths.DATA / artifact.name
    shutil.rmtree(paths.CACHE)
    loaded = make(compute=compute)
    assert loaded.from_cache
    assert loaded.path.parent == paths.DATA
    assert compute.runs == 2
    damage_flip(loaded.path / "weights.bin")
    with pytest.raises(ArtifactError, match=r"weights\.bin"):
        make(compute=compute)


def later_copy(artifact, content):
    """The same recipe computed again elsewhere, an hour later, as a pull brings it to data/."""
    elsewhere, later = paths.CACHE.with_name("elsewhere"), time.time() + 3600
    shutil.rmtree(paths.DATA)
    with pytest.MonkeyPatch.context() as other:
        other.setattr(paths, "CACHE", elsewhere)
        other.setattr(store.time, "time", lambda: later)
        make(compute=Counted(content), preset="laptop", kept=True)
    shutil.rmtree(elsewhere)
    return paths.DATA / artifact.name


def test_an_old_copy_in_the_cache_does_not_come_over_a_later_one_in_git():
    old = make(compute=Counted("old"), preset="laptop", kept=True)
    kept = later_copy(old, "new")
    used = make(compute=Counted("never"), preset="laptop", kept=True)
    assert used.path == kept, "the later result is the one that is used"
    assert artifacts.keep(old) == kept
    assert "new" in (kept / "sub" / "log.csv").read_text()
    # A damaged copy in the cache is told, not passed over.
    (old.path / "manifest.json").write_text("{}")
    with pytest.raises(ArtifactError, match="damaged"):
        make(preset="laptop", kept=True)


def test_two_processes_that_keep_the_same_artifact_leave_it_whole():
    artifact = make(preset="laptop")
    target = paths.DATA / artifact.name
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=artifacts.keep, args=(artifact,)) for _ in range(8)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
    assert [worker.exitcode for worker in workers] == [0] * 8
    assert artifacts.load(target).digest == artifact.digest
    assert not list(paths.DATA.glob("*.partial"))


def test_what_was_finished_before_a_request_is_not_its_answer(monkeypatch):
    first = make(compute=Counted("old"))
    # Killed between the manifest and the renaming.
    first.path.rename(first.path.with_name(f"{first.path.name}.partial"))
    monkeypatch.setenv(recompute.REQUEST, "data")
    monkeypatch.setenv(recompute.SINCE, str(time.time() + 1e-3))
    compute = Counted("new")
    assert make(compute=compute).digest != first.digest
    assert compute.runs == 1


def test_the_batch_runner_learns_which_artifacts_were_used(tmp_path, monkeypatch):
    monkeypatch.setenv(store.USED, str(tmp_path / "used"))
    artifact = make()
    assert (tmp_path / "used").read_text() == f"{artifact.name} {artifact.digest}\n"


def test_command_line(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    artifact = make(preset="laptop")
    make({"trial": 1}, preset="smoke")
    assert main(["list"]) == 0
    assert artifact.name in capsys.readouterr().out
    assert main(["verify", "data"]) == 0
    assert f"{artifact.name}: whole" in capsys.readouterr().out
    assert main(["keep", "data"]) == 0
    assert [path.name for path in paths.DATA.iterdir() if path.is_dir()] == [artifact.name]
    damage_flip(artifact.path / "weights.bin")
    assert main(["verify"]) == 1
    assert "weights.bin has another SHA-256" in capsys.readouterr().out
    assert main(["keep", "nix"]) == 2
    assert "unknown stage 'nix'" in capsys.readouterr().err


def test_a_computation_that_writes_nothing_is_an_error():
    with pytest.raises(ArtifactError, match="wrote no file"):
        make(compute=lambda folder: None)
