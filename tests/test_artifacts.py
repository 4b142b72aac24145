"""Stored results: found for exactly their recipe, refused when damaged, resumed when killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace

import numpy as np
import pytest

from cassie_lib import artifacts, paths
from cassie_lib.artifacts import recompute, stages, store
from cassie_lib.artifacts.__main__ import main
from cassie_lib.code_version import code_fingerprint, file_fingerprint
from cassie_lib.errors import ArtifactError, ParameterError, UnknownNameError


@dataclass(frozen=True)
class Parameters:
    """A stage's parameters of every kind that has a canonical form."""

    size: int = 3
    rate: float = 1e-3
    name: str = "a"
    weights: tuple[float, ...] = (1.0, 2.0)
    seed: int = 7


class Counted:
    """A computation that counts its runs."""

    def __init__(self, content: str = "result"):
        self.runs, self.content = 0, content

    def __call__(self, folder):
        self.runs += 1
        (folder / "weights.bin").write_bytes(b"\x00\x01" * 500)
        (folder / "sub").mkdir(exist_ok=True)
        (folder / "sub" / "log.csv").write_text(f"step,value\n0,{self.content}\n")
        (folder / "timing.csv").write_text(f"{time.time_ns()}\n")


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "CACHE", tmp_path / "cache")
    monkeypatch.setattr(paths, "DATA", tmp_path / "data")
    for name in (recompute.REQUEST, recompute.SINCE, store.USED):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(recompute, "_process_since", [])


def make(parameters=None, stage="data", compute=None, **options):
    parameters = Parameters() if parameters is None else parameters
    return artifacts.load_or_compute(stage, parameters, compute or Counted(), **options)


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


def damage_flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))


def damage_cut(path):
    path.write_bytes(path.read_bytes()[:-3])


def damage_empty(path):
    path.write_bytes(b"")


def damage_remove(path):
    path.unlink()


DAMAGES = [damage_flip, damage_cut, damage_empty, damage_remove]


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", ["weights.bin", "sub/log.csv", "timing.csv", "manifest.json"])
def test_any_damage_is_named_and_never_used_or_deleted(name, damage):
    compute = Counted()
    artifact = make(compute=compute)
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
    manifest = json.loads(file.read_text())
    manifest[field] = {"size": 9} if isinstance(manifest[field], dict) else "0" * 64
    file.write_text(json.dumps(manifest))
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


def test_recompute_replaces_a_damaged_artifact_once(monkeypatch):
    compute = Counted()
    damage_flip(make(compute=compute).path / "weights.bin")
    monkeypatch.setenv(recompute.REQUEST, "data")
    assert not make(compute=compute).from_cache
    assert make(compute=compute).from_cache
    assert compute.runs == 2
    assert not list(paths.CACHE.glob("*.partial"))


def test_recompute_touches_only_the_stages_asked_for(monkeypatch):
    data, expert = Counted(), Counted()
    make(compute=data), make(stage="expert", compute=expert)
    monkeypatch.setenv(recompute.REQUEST, "expert, mlp")
    make(compute=data), make(stage="expert", compute=expert)
    assert (data.runs, expert.runs) == (1, 2)
    monkeypatch.setenv(recompute.REQUEST, "everything")
    with pytest.raises(UnknownNameError, match="'everything'"):
        make()


def test_an_interrupted_request_goes_on_and_a_finished_one_starts_anew(monkeypatch):
    since = recompute.begin_request("data,expert", "laptop")
    assert recompute.begin_request("expert,data", "laptop") == since
    assert recompute.begin_request("expert", "smoke") > since
    compute = Counted()
    monkeypatch.setenv(recompute.REQUEST, "data,expert")
    monkeypatch.setenv(recompute.SINCE, repr(since))
    make(compute=compute)
    # Another process of the same request takes the new result.
    monkeypatch.setattr(recompute, "_process_since", [])
    assert make(compute=compute).from_cache
    recompute.end_request("laptop")
    monkeypatch.setenv(recompute.SINCE, repr(recompute.begin_request("data,expert", "laptop")))
    assert not make(compute=compute).from_cache
    monkeypatch.setenv(recompute.SINCE, "soon")
    with pytest.raises(ParameterError, match="'soon'"):
        make()


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


def test_changed_code_is_told_in_the_notice(monkeypatch):
    make()
    code = store.code_fingerprint(("data", "simulator"))
    changed = {**code, "simulator.py": "0" * 16}
    monkeypatch.setattr("cassie_lib.artifacts.manifest.code_fingerprint", lambda modules: changed)
    artifact = make()
    assert artifact.from_cache
    assert "simulator.py" in artifact.notice[0]
    later = make(stage="mlp", upstream=[artifact])
    assert artifact.notice[0] in later.notice, "what is built on it says so too"


def test_an_exception_leaves_a_work_folder_to_go_on_from():
    def fails(folder):
        (folder / artifacts.WORK / "checkpoint").write_text("3")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(compute=fails)
    assert not [path for path in artifacts.stored() if not path.name.endswith(".partial")]

    def goes_on(folder):
        (folder / "steps").write_text((folder / artifacts.WORK / "checkpoint").read_text())

    artifact = make(compute=goes_on)
    assert artifact.file("steps").read_text() == "3"
    assert not (artifact.path / artifacts.WORK).exists()
    assert list(artifact.manifest["files"]) == ["steps"]


def test_other_code_goes_on_with_a_notice_and_a_request_starts_fresh(monkeypatch):
    def fails(folder):
        (folder / artifacts.WORK / "checkpoint").write_text("3")
        raise KeyboardInterrupt

    def goes_on(folder):
        (folder / "found").write_text(str((folder / artifacts.WORK / "checkpoint").exists()))

    for request, found in (("", "True"), ("data", "False")):
        monkeypatch.setenv(recompute.REQUEST, request)
        with monkeypatch.context() as patched:
            patched.setattr(store, "code_fingerprint", lambda modules: {"old.py": "0"})
            with pytest.raises(KeyboardInterrupt):
                make({"request": request}, compute=fails)
        artifact = make({"request": request}, compute=goes_on)
        assert artifact.file("found").read_text() == found
        assert bool(artifact.notice) == (found == "True")


def test_a_computation_that_writes_nothing_is_an_error():
    with pytest.raises(ArtifactError, match="wrote no file"):
        make(compute=lambda folder: None)


KILLED = """
import os, sys, time
from pathlib import Path
from cassie_lib import artifacts

def compute(folder):
    note = folder / artifacts.WORK / "steps"
    done = int(note.read_text()) if note.exists() else 0
    for step in range(done, 20):
        time.sleep(0.03)
        with open(folder / "log.csv", "a" if step else "w") as file:
            file.write(f"{step}\\n")
        temporary = note.with_suffix(".tmp")
        temporary.write_text(str(step + 1))
        temporary.replace(note)
    print("computed from", done, flush=True)

print("ready", flush=True)
artifact = artifacts.load_or_compute("data", {"x": 1}, compute)
print("cached" if artifact.from_cache else "new", artifact.digest, flush=True)
"""


def start(tmp_path):
    environment = {
        **os.environ,
        "CASSIE_CACHE": str(tmp_path / "cache"),
        "CASSIE_HOME": str(tmp_path),
    }
    return subprocess.Popen(
        [sys.executable, "-c", KILLED], stdout=subprocess.PIPE, text=True, env=environment
    )


def wait_for_step(reached):
    end = time.time() + 60
    while time.time() < end:
        notes = list(paths.CACHE.glob("*.partial/work/steps"))
        if notes and int(notes[0].read_text()) >= reached:
            return
        time.sleep(0.005)
    raise AssertionError("waited in vain")


def test_kill_9_leaves_nothing_usable_and_the_next_run_goes_on(tmp_path):
    whole = start(tmp_path / "undisturbed").communicate(timeout=120)[0]
    for reached in (1, 5, 9):
        process = start(tmp_path)
        wait_for_step(reached)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert not artifacts.stored("data")
    output = start(tmp_path).communicate(timeout=120)[0]
    assert "computed from 0" not in output
    digest = "new " + whole.split()[-1]
    assert digest in output
    assert artifacts.load(artifacts.stored("data")[0]).wall_time_s >= 0.5
    lines = (artifacts.stored("data")[0] / "log.csv").read_text().split()
    assert lines == [str(step) for step in range(20)]


def test_killed_after_the_manifest_needs_no_new_computation(monkeypatch):
    compute = Counted()
    with monkeypatch.context() as patched:
        patched.setattr(store, "_move_into_place", lambda work, final: sys.exit("killed"))
        with pytest.raises(SystemExit):
            make(compute=compute)
    assert make(compute=compute).from_cache
    assert compute.runs == 1


def test_two_processes_compute_once(tmp_path):
    processes = [start(tmp_path), start(tmp_path)]
    outputs = [process.communicate(timeout=120)[0] for process in processes]
    assert sum("computed from 0" in output for output in outputs) == 1
    assert sorted(output.split()[-2] for output in outputs) == ["cached", "new"]


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
    assert [path.name for path in paths.DATA.iterdir()] == [artifact.name]
    damage_flip(artifact.path / "weights.bin")
    assert main(["verify"]) == 1
    assert "weights.bin has another SHA-256" in capsys.readouterr().out
    assert main(["keep", "nix"]) == 2
    assert "unknown stage 'nix'" in capsys.readouterr().err


@pytest.mark.parametrize("stage", stages.STAGES)
def test_every_stage_names_modules_that_exist(stage):
    for module in stages.STAGES[stage].modules:
        assert code_fingerprint((module,)), f"{module} has no source file"


def test_fingerprint_ignores_words_and_sees_deeds(tmp_path):
    def fingerprint(name, text):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}-{name}"
        path.write_text(text)
        return file_fingerprint(path)

    base = fingerprint("a.py", 'def f(x):\n    """Doc."""\n    return x + 1\n')
    assert fingerprint("a.py", "def f(x):  # why\n    return (x + 1)\n") == base
    assert fingerprint("a.py", "def f(x):\n    return x + 2\n") != base
    xml = fingerprint("a.xml", '<a x="1" y="2">\n <b/></a>')
    assert fingerprint("a.xml", '<!-- c --><a y="2" x="1"><b></b></a>') == xml
    assert fingerprint("a.xml", '<a x="1" y="3"><b/></a>') != xml
    assert fingerprint("a.json", '{"b": 1, "a": 2}') == fingerprint("a.json", '{"a":2,"b":1}')
