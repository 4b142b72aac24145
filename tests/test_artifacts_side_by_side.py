"""Independent results in processes of their own: the same results, errors, kills."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
from functools import partial

import pytest
from artifact_toys import Counted, damage_flip, make, wait_until

from cassie_lib import paths
from cassie_lib.artifacts import load_or_compute, recompute
from cassie_lib.artifacts.loading import NotStoredError, loading_only
from cassie_lib.artifacts.side_by_side import PROCESSES, side_by_side
from cassie_lib.errors import ArtifactError, ParameterError

pytestmark = pytest.mark.usefixtures("artifact_folders", "shared_folders")


@pytest.fixture
def shared_folders(artifact_folders, tmp_path, monkeypatch):
    """The store of this test, for other processes, too."""
    monkeypatch.setenv("CASSIE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("CASSIE_HOME", str(tmp_path))
    assert tmp_path / "cache" == paths.CACHE


def process_of(name, others=0):
    """A stored result, the process that made it, and how many that would start.

    It waits until as many others are being computed: in vain if they come after it.
    """

    def compute(folder):
        wait_until(lambda: len(list(paths.CACHE.glob("data-*.partial"))) > others)
        (folder / "timing.txt").write_text(f"{os.getpid()} {os.environ.get(PROCESSES)}")
        (folder / "name.txt").write_text(name)

    artifact = load_or_compute("data", {"name": name}, compute)
    return artifact, artifact.file("timing.txt").read_text().split()


def fails_later(name):
    def compute(folder):
        wait_until(lambda: list(paths.CACHE.glob("data-????????????/name.txt")))
        raise ParameterError(f"name = {name}: expected another")

    return load_or_compute("data", {"fails": name}, compute)


def is_killed():
    def compute(folder):
        os.kill(os.getpid(), signal.SIGKILL)

    return load_or_compute("data", {"killed": True}, compute)


def names(found):
    return [artifact.file("name.txt").read_text() for artifact, _ in found]


def test_one_after_another_unless_told_otherwise(monkeypatch):
    monkeypatch.delenv(PROCESSES, raising=False)
    found = side_by_side([partial(process_of, name) for name in "ab"])
    assert {notes[0] for _, notes in found} == {str(os.getpid())}
    assert names(found) == ["a", "b"]


def test_missing_results_are_computed_at_the_same_time_and_stored_ones_loaded(monkeypatch):
    stored, _ = process_of("b")
    monkeypatch.setenv(PROCESSES, "2")
    found = side_by_side([partial(process_of, name, others=1) for name in "abc"])
    assert names(found) == ["a", "b", "c"]
    (_, first), (again, second), (_, third) = found
    assert again.digest == stored.digest
    assert second[0] == str(os.getpid()), "it was there"
    assert len({first[0], third[0], str(os.getpid())}) == 3, "each in a process of its own"
    assert first[1] == third[1] == "1", "these start no further ones"
    # A single missing one needs no process.
    (_, alone), _ = side_by_side([partial(process_of, "d"), partial(process_of, "a")])
    assert alone[0] == str(os.getpid())


def on_upstream(name):
    upstream, made_by = process_of("upstream")

    def compute(folder):
        (folder / "made_by.txt").write_text(made_by[0])

    return load_or_compute("data", {"after": name}, compute, [upstream])


def test_a_request_to_compute_anew_is_one_for_all_processes(monkeypatch):
    process_of("upstream")
    monkeypatch.setenv(PROCESSES, "2")
    monkeypatch.setenv(recompute.REQUEST, "data")
    monkeypatch.setenv(recompute.SINCE, "")  # put back to nothing after the test
    monkeypatch.delenv(recompute.SINCE)
    process_of("upstream")
    found = side_by_side([partial(on_upstream, name) for name in "ab"])
    makers = {item.file("made_by.txt").read_text() for item in found}
    assert makers == {str(os.getpid())}, "what this process has made anew is not made again"


def test_the_longest_begins_first(monkeypatch):
    monkeypatch.setenv(PROCESSES, "2")
    module, begun = importlib.import_module("cassie_lib.artifacts.side_by_side"), []
    monkeypatch.setattr(module, "_compute", lambda calls, processes: begun.extend(calls))
    calls = [partial(process_of, name) for name in "abcd"]
    found = side_by_side(calls, costs=(1.0, 2.0, 5.0, 4.0))
    assert [call.args[0] for call in begun] == ["c", "d", "b", "a"]
    assert names(found) == ["a", "b", "c", "d"]


def test_an_error_comes_through_and_what_is_done_stays(monkeypatch):
    monkeypatch.setenv(PROCESSES, "2")
    calls = [partial(process_of, "a"), partial(fails_later, "x"), partial(process_of, "b")]
    with pytest.raises(ParameterError, match=r"name = x: expected another"):
        side_by_side(calls, costs=(3.0, 2.0, 1.0))
    with loading_only():
        assert names([process_of("a")]) == ["a"]
        damage_flip(process_of("a")[0].file("name.txt"))
    with pytest.raises(ArtifactError, match="name.txt"):
        side_by_side(calls)


def test_a_killed_process_is_told(monkeypatch):
    monkeypatch.setenv(PROCESSES, "2")
    with pytest.raises(ArtifactError, match="one of 2 processes was killed.*run again"):
        side_by_side([partial(process_of, "a"), is_killed])


@pytest.mark.parametrize("text", ["0", "two", "-1", "1.5"])
def test_a_number_of_processes_is_a_whole_one(text, monkeypatch):
    monkeypatch.setenv(PROCESSES, text)
    with pytest.raises(ParameterError, match=f"CASSIE_PROCESSES is '{text}': expected a whole"):
        side_by_side([])


def test_loading_only_computes_nothing():
    compute = Counted()
    with loading_only(), pytest.raises(NotStoredError, match=r"data-\w{12} is not stored"):
        make(compute=compute)
    assert compute.runs == 0
    made = make(compute=compute)
    with loading_only():
        assert make(compute=compute).digest == made.digest
    assert compute.runs == 1


ABANDONED = """
from functools import partial
from test_artifacts_side_by_side import process_of
from cassie_lib.artifacts.side_by_side import side_by_side
if __name__ == "__main__":
    side_by_side([partial(process_of, name, 5) for name in "ab"])
"""


def test_processes_end_with_the_one_that_began_them(tmp_path):
    script = tmp_path / "abandoned.py"
    script.write_text(ABANDONED)
    folders = os.pathsep.join([os.path.dirname(__file__), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, PROCESSES: "2", "PYTHONPATH": folders}
    parent = subprocess.Popen([sys.executable, str(script)], env=environment)
    try:
        wait_until(lambda: len(list(paths.CACHE.glob("data-*.partial/work/*.json"))) == 2)
        children = children_of(parent.pid)
        assert len(children) >= 2
    finally:
        parent.kill()
        parent.wait()
    wait_until(lambda: not any(is_running(child) for child in children))


def children_of(process):
    text = subprocess.run(
        ["ps", "-A", "-o", "pid=,ppid="], capture_output=True, text=True, check=True
    ).stdout
    pairs = [tuple(map(int, line.split())) for line in text.splitlines()]
    return [child for child, parent in pairs if parent == process]


def is_running(process):
    found = subprocess.run(
        ["ps", "-o", "stat=", "-p", str(process)], capture_output=True, text=True, check=False
    )
    return bool(found.stdout.strip()) and not found.stdout.strip().startswith("Z")
