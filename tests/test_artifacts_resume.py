"""Stored results whose computation was killed or asked for anew."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from artifact_toys import Counted, make, wait_until

from cassie_lib import artifacts, paths
from cassie_lib.artifacts import recompute, stages, store
from cassie_lib.errors import ParameterError, UnknownNameError

pytestmark = pytest.mark.usefixtures("artifact_folders")


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


def wait_for_step(step):
    def reached():
        notes = list(paths.CACHE.glob("*.partial/work/steps"))
        return bool(notes) and int(notes[0].read_text()) >= step

    wait_until(reached)


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


def test_a_request_counts_the_time_of_all_its_runs(monkeypatch):
    recompute.begin_request("data", "laptop")
    with recompute.spending_time("laptop", every_s=0.01):
        wait_until(lambda: spent() > 0.03)  # noted while it runs: a kill loses little
    first = spent()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert spent() > first + 0.05, "the next run adds to what there was, also when it fails"
    recompute.begin_request("data", "laptop")
    total = spent()
    assert recompute.end_request("laptop") == total
    with recompute.spending_time("laptop"):
        pass
    assert recompute.end_request("laptop") == 0.0, "nothing was asked for"


def interrupted():
    with recompute.spending_time("laptop"):
        time.sleep(0.06)
        raise KeyboardInterrupt


def spent():
    return json.loads(recompute.request_file("laptop").read_text())["spent_s"]


@pytest.mark.parametrize("text", ["{}", "[1]", '{"stages": ["data"], "since": "soon"}', "{"])
def test_a_damaged_request_is_begun_anew(text):
    recompute.request_file("laptop").parent.mkdir(parents=True, exist_ok=True)
    recompute.request_file("laptop").write_text(text)
    assert recompute.begin_request("data", "laptop") == pytest.approx(time.time(), abs=5.0)
    assert spent() == 0.0


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
            patched.setattr(stages, "code_fingerprint", lambda modules: {"old.py": "0"})
            with pytest.raises(KeyboardInterrupt):
                make({"request": request}, compute=fails)
        artifact = make({"request": request}, compute=goes_on)
        assert artifact.file("found").read_text() == found
        assert bool(artifact.notice) == (found == "True")


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
