"""Kill -9 at random moments, then the same bits as if nothing had happened."""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import kill_toys
import pytest
from test_batch import outputs, write_notebook

from cassie_lib import artifacts, notebook_run, paths
from cassie_lib.artifacts import recompute
from cassie_lib.notebook_run import NotebookError

CELL = """
import kill_toys
from cassie_lib import artifacts
found = artifacts.load_or_compute("walking", {"steps": kill_toys.STEPS}, kill_toys.slow_steps)
print(found.digest)
"""


@pytest.fixture
def upstream(offline_run, artifact_folders):
    """Makes caches that hold what the stages are computed from."""

    def make(folder):
        for kind in ("expert", "data", "causal"):
            for path in offline_run.cache.glob(f"{kind}-????????????"):
                shutil.copytree(path, folder / path.name)
        return folder

    return make


@pytest.mark.parametrize("stage", kill_toys.STAGES)
def test_a_stage_killed_at_random_moments_ends_with_the_same_bits(
    upstream, tmp_path, monkeypatch, stage
):
    # run() sets these; here they are put back.
    monkeypatch.setattr(paths, "CACHE", paths.CACHE)
    monkeypatch.setattr(paths, "DATA", paths.DATA)
    whole = kill_toys.run(stage, upstream(tmp_path / "undisturbed"))
    cache = upstream(tmp_path / "disturbed")
    for seed in range(2):
        kill_toys.kill_at_random(stage, cache, seed)
        assert not (cache / whole.name).exists()
        left = cache / f"{whole.name}.partial"
        assert len(json.loads((left / "work" / "sessions.json").read_text())) == seed + 1
    resumed = kill_toys.run(stage, cache)
    assert resumed.digest == whole.digest
    for name, facts in whole.manifest["files"].items():
        if not name.startswith("timing"):
            assert resumed.manifest["files"][name] == facts
    assert not list(cache.glob("*.partial"))


def test_logs_of_a_killed_training_have_every_step_once(upstream, tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "CACHE", paths.CACHE)
    monkeypatch.setattr(paths, "DATA", paths.DATA)
    cache = upstream(tmp_path / "cache")
    kill_toys.kill_at_random("expert", cache, seed=9)
    rows = kill_toys.run("expert", cache).file("timing_log.csv").read_text().splitlines()[1:]
    steps = [int(row.split(",")[0]) for row in rows if ",plain_reward," in row]
    assert steps == list(range(112, 112 * (kill_toys.UPDATES + 1), 112))


def start(house):
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    environment |= {"CASSIE_HOME": str(house)}
    for name in ("CASSIE_CACHE", "CASSIE_PRESET", recompute.REQUEST, recompute.SINCE):
        environment.pop(name, None)
    command = [sys.executable, "-m", "cassie_lib.batch", "run", "01", "--preset", "smoke"]
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip


def test_a_notebook_killed_at_random_moments_ends_with_the_same_bits(
    tmp_path, artifact_folders, monkeypatch
):
    recipe = ("walking", {"steps": kill_toys.STEPS}, kill_toys.slow_steps)
    whole = artifacts.load_or_compute(*recipe)
    house, cache = tmp_path / "house", tmp_path / "house" / "data" / "cache"
    write_notebook(house, "01", last=CELL)
    target, chance = cache / "smoke-executed" / "01_house.ipynb", random.Random(5)
    for _ in range(2):
        process = start(house)
        kill_toys.wait_for_progress(
            cache, whole.name, lambda process=process: process.poll() is None, chance.randint(2, 12)
        )
        time.sleep(chance.uniform(0.0, 0.03))
        kill_toys.kill_tree(process)
        assert not target.exists()
        assert not (cache / whole.name).exists()
    output = start(house).communicate(timeout=120)[0]
    assert "done in" in output
    assert whole.digest in outputs(target)
    monkeypatch.setattr(paths, "CACHE", cache)
    assert artifacts.load(cache / whole.name).digest == whole.digest


def test_a_killed_kernel_is_told_in_one_line(tmp_path):
    house = tmp_path / "house"
    write_notebook(house, "01", last="import os, signal\nos.kill(os.getpid(), signal.SIGKILL)")
    process = start(house)
    output = process.communicate(timeout=120)[0]
    assert process.returncode == 1
    assert "Traceback" not in output
    last = output.strip().splitlines()[-1]
    assert last.startswith("error: 01_house.ipynb: its kernel was killed")
    assert list((house / "data" / "cache" / "failed").iterdir())


def test_a_damaged_notebook_is_told_in_one_line(tmp_path):
    path = write_notebook(tmp_path, "01")
    path.write_text(path.read_text()[:-9])
    with pytest.raises(NotebookError, match="01_house.ipynb cannot be read"):
        notebook_run.check_parameters(path, {})
