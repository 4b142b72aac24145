"""The batch runner: refuses what a notebook would ignore, leaves nothing half-written, resumes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

from cassie_lib import artifacts, batch, gallery, notebook_run, paths, results, stamps
from cassie_lib.artifacts import recompute
from cassie_lib.artifacts.side_by_side import PROCESSES
from cassie_lib.errors import DataError, ParameterError, UnknownNameError

PARAMETERS = 'PRESET = "laptop"  # str\nSEEDS = 2\nRATE = 0.5\nGAITS = ("walk", "hop")'
STAGE = """
import time
from pathlib import Path
from cassie_lib import artifacts, presets
preset = presets.resolve(PRESET).name

def compute(folder):
    time.sleep({seconds})
    (folder / "a").write_text("a")

artifact = artifacts.load_or_compute("walking", {{"number": "{number}"}}, compute)
print(preset, SEEDS, artifact.from_cache, Path("x").resolve())
"""


def write_notebook(folder, number, seconds=0.0, last="pass"):
    cells = [
        new_markdown_cell("# House $x_1$"),
        new_code_cell(PARAMETERS, metadata={"tags": ["parameters"]}),
        new_code_cell(STAGE.format(number=number, seconds=seconds)),
        new_code_cell(last),
    ]
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
    path = folder / "notebooks" / f"{number}_house.ipynb"
    path.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(new_notebook(cells=cells, metadata=kernel), path)
    return path


@pytest.fixture
def house(tmp_path, monkeypatch):
    """A repository of its own with no notebook yet; kernels are told of it too."""
    (tmp_path / "notebooks").mkdir()
    shutil.copy(paths.SNAKEFILE, tmp_path / "notebooks" / "Snakefile")
    (tmp_path / "environment.lock").write_text("")
    monkeypatch.setenv("CASSIE_HOME", str(tmp_path))
    for name in ("CASSIE_CACHE", "CASSIE_PRESET", recompute.REQUEST, recompute.SINCE):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    monkeypatch.setattr(paths, "README", tmp_path / "README.md")
    monkeypatch.setattr(paths, "CACHE", tmp_path / "data" / "cache")
    monkeypatch.setattr(paths, "NOTEBOOKS", tmp_path / "notebooks")
    monkeypatch.setattr(paths, "FIGURES", tmp_path / "figures")
    return tmp_path


def outputs(notebook):
    book = nbformat.read(notebook, 4)
    return "".join(o.get("text", "") for cell in book.cells for o in cell.get("outputs", ()))


def test_notebooks_are_found_by_number_stem_and_path(house):
    path = write_notebook(house, "06")
    for name in ("6", "06", "06_house", str(path), "notebooks/06_house.ipynb"):
        assert notebook_run.find_notebook(name) == path
    for name in ("7", "house", "06_hous"):
        with pytest.raises(UnknownNameError, match="06_house"):
            notebook_run.find_notebook(name)


def test_parameters_are_read_and_parsed(house):
    found = notebook_run.notebook_parameters(write_notebook(house, "01"))
    assert found == {"PRESET": "laptop", "SEEDS": 2, "RATE": 0.5, "GAITS": ("walk", "hop")}
    assert notebook_run.parse_parameter("SEEDS=3") == ("SEEDS", 3)
    assert notebook_run.parse_parameter("PRESET=smoke") == ("PRESET", "smoke")
    assert notebook_run.parse_parameter("GAITS=('walk',)") == ("GAITS", ("walk",))
    with pytest.raises(ParameterError, match="expected name=value"):
        notebook_run.parse_parameter("SEEDS")


def test_unknown_parameters_are_refused_with_the_known_ones(house, capsys):
    write_notebook(house, "01")
    assert batch.main(["run", "01", "--parameter", "SEED=3"]) == 1
    message = capsys.readouterr().err
    assert "'SEED'" in message
    assert "GAITS, PRESET, RATE, SEEDS" in message
    assert not (house / "figures").exists()
    assert batch.main(["run", "01", "--parameter", "PRESET=smoke"]) == 1
    assert "PRESET = 'smoke' is a parameter: expected --preset" in capsys.readouterr().err


def test_values_of_another_type_are_refused(house):
    path = write_notebook(house, "01")
    notebook_run.check_parameters(path, {"RATE": 1, "SEEDS": 4, "GAITS": ("hop",)})
    for name, value in (("SEEDS", "many"), ("SEEDS", 2.5), ("GAITS", "hop"), ("SEEDS", True)):
        with pytest.raises(ParameterError, match=f"{name} of 01_house"):
            notebook_run.check_parameters(path, {name: value})


def test_a_run_is_executed_cleaned_and_put_where_its_preset_belongs(house):
    source = write_notebook(house, "01")
    before = source.read_bytes()
    target = notebook_run.run_notebook("1")
    assert target == house / "figures" / "executed" / "01_house.ipynb"
    assert source.read_bytes() == before
    assert "laptop 2 False" in outputs(target)
    text = target.read_text()
    assert str(house) not in text, "no path of this machine in what git keeps"
    assert "injected-parameters" not in text
    assert json.loads(text)["metadata"]["papermill"]["duration"] > 0
    assert [cell["metadata"] for cell in json.loads(text)["cells"]][1] == {"tags": ["parameters"]}
    changed = notebook_run.run_notebook("1", "smoke", {"SEEDS": 3})
    assert changed.is_relative_to(paths.CACHE)
    assert "smoke 3 True" in outputs(changed)
    index = gallery.build_gallery("laptop")
    page = (index.parent / "01_house.html").read_text()
    assert "<math" in page
    assert "$x_1$" not in page


def claim(*names):
    """A cell that records these claims."""
    calls = [f"record_result({name!r}, 'Figure 1', 'laptop', 1.0, None, 1, '', 0.0, 2.0, 'better')"
             for name in names]  # fmt: skip
    return "from cassie_lib.results import record_result\n" + "\n".join(calls)


def test_a_claim_that_a_notebook_no_longer_makes_is_forgotten_once_it_has_passed(house):
    def recorded():
        return [item["id"] for item in results.read_results("laptop")]

    write_notebook(house, "01", last=claim("01-stays", "01-goes"))
    write_notebook(house, "02", last=claim("02-other"))
    for number in ("01", "02"):
        notebook_run.run_notebook(number)
    write_notebook(house, "01", last=claim("01-stays") + "\nraise ValueError")
    with pytest.raises(notebook_run.NotebookError):
        notebook_run.run_notebook("01")
    assert recorded() == ["01-goes", "01-stays", "02-other"], "a failed run proves nothing"
    write_notebook(house, "01", last=claim("01-stays"))
    notebook_run.run_notebook("01", parameters={"SEEDS": 3})
    assert recorded() == ["01-goes", "01-stays", "02-other"], "its results are elsewhere"
    notebook_run.run_notebook("01")
    assert recorded() == ["01-stays", "02-other"]
    assert not list((paths.CACHE / "running").iterdir()), "nothing is left behind"


def test_only_laptop_runs_compute_side_by_side(house, monkeypatch):
    write_notebook(house, "01", last=f"import os; print(os.environ[{PROCESSES!r}])")
    monkeypatch.delenv(PROCESSES, raising=False)

    def printed(preset):
        cells = json.loads(notebook_run.run_notebook("01", preset).read_text())["cells"]
        return "".join(cells[-1]["outputs"][0]["text"]).strip()

    assert printed("smoke") == "1"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert printed("laptop") == str(cores)
    monkeypatch.setenv(PROCESSES, "5")
    assert printed("laptop") == "5", "unless told otherwise"


def test_a_failing_cell_leaves_the_former_result_and_a_copy_to_look_at(house, capsys):
    write_notebook(house, "01")
    target = notebook_run.run_notebook("1", "smoke")
    before = target.read_bytes()
    write_notebook(house, "01", last="assert SEEDS > 5, 'too few'")
    assert batch.main(["run", "01", "--preset", "smoke"]) == 1
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert message.startswith("error: 01_house.ipynb, In [4]: AssertionError: too few")
    assert target.read_bytes() == before
    assert (paths.CACHE / "failed" / "01_house.ipynb").exists()
    assert not list((paths.CACHE / "running").iterdir())


def figures(*arguments, wait=True):
    command = [sys.executable, "-m", "cassie_lib.batch", "figures", "--preset", "smoke", *arguments]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    if not wait:
        return process
    output = process.communicate(timeout=120)[0]
    assert process.returncode == 0, output
    return [line.split("]")[0][1:] for line in output.splitlines() if line.endswith("preset smoke")]


def wait_for(condition, seconds=120):
    end = time.time() + seconds
    while not condition():
        assert time.time() < end, "waited in vain"
        time.sleep(0.05)


def test_figures_resume_after_kill_9_and_follow_what_changed(house):
    write_notebook(house, "02")
    write_notebook(house, "03", seconds=5)
    process = figures(wait=False)
    wait_for(stamps.stamp_file("smoke", "02").exists)
    wait_for(lambda: list(paths.CACHE.glob("walking-*.partial")))
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)
    assert not (paths.CACHE / "smoke-executed" / "03_house.ipynb").exists()
    assert figures() == ["03_house"], "the finished notebook is not run again"
    # The edit of a notebook does not stir those that build on its artifacts.
    write_notebook(house, "02", last="assert True")
    assert figures() == ["02_house"]
    assert figures("--recompute", "walking") == ["02_house", "03_house"]
    assert not recompute.request_file("smoke").exists()
    assert "False" in outputs(paths.CACHE / "smoke-executed" / "03_house.ipynb")


def test_a_stamp_is_stale_without_its_notebook_or_with_other_artifacts(house, monkeypatch):
    monkeypatch.setattr(paths, "DATA", house / "data")
    notebook = write_notebook(house, "02")
    assert not stamps.is_stale("smoke", notebook), "there is none"

    def compute(content):
        return artifacts.load_or_compute(
            "walking", {"x": 1}, lambda folder: (folder / "a").write_text(content), preset="laptop"
        )

    artifact = artifacts.load(artifacts.keep(compute("old")))
    stamp = stamps.stamp_file("smoke", "02")
    used = [f"{artifact.name} {artifact.digest}"]
    stamps.write_stamp(stamp, stamps.inputs_hash(notebook), used)
    assert stamps.is_stale("smoke", notebook), "there is no executed copy"
    executed = paths.executed_folder("smoke") / notebook.name
    executed.parent.mkdir(parents=True)
    executed.write_text("{}")
    assert not stamps.is_stale("smoke", notebook)
    shutil.rmtree(paths.CACHE / artifact.name)
    assert not stamps.is_stale("smoke", notebook), "the kept copy is the same"
    monkeypatch.setenv(recompute.REQUEST, "walking")
    compute("new")
    assert stamps.is_stale("smoke", notebook)


@pytest.mark.parametrize("changed", ["notebook", "library", "lock", "stamp"])
def test_a_stamp_is_stale_after_any_change(house, monkeypatch, changed):
    notebook = write_notebook(house, "02")
    executed = paths.executed_folder("smoke") / notebook.name
    executed.parent.mkdir(parents=True)
    executed.write_text("{}")
    stamp = stamps.stamp_file("smoke", "02")
    stamps.write_stamp(stamp, stamps.inputs_hash(notebook), [])
    notebook.touch()
    monkeypatch.setattr(paths, "LOCK", house / "environment.lock")
    stamps.write_stamp(stamp, stamps.inputs_hash(notebook), [])
    stamps.forget_stale("smoke", [notebook])
    assert stamp.exists(), "a touched file is the same file"
    if changed == "library":
        monkeypatch.setattr(stamps, "code_fingerprint", lambda modules: {"reward.py": "0"})
    else:
        file = {"notebook": notebook, "lock": paths.LOCK, "stamp": stamp}[changed]
        file.write_text(file.read_text() + "# more")
    stamps.forget_stale("smoke", [notebook])
    assert not stamp.exists()


def test_wrong_requests_are_one_line_errors(house, capsys):
    write_notebook(house, "02")
    for arguments, expected in (
        (["--preset", "big"], "unknown preset 'big'"),
        (["--only", "9"], "unknown notebook '9'"),
        (["--recompute", "nix"], "unknown stage 'nix'"),
    ):
        assert batch.main(["figures", *arguments]) == 1
        message = capsys.readouterr().err
        assert expected in message
        assert message.count("\n") == 1


def test_every_needed_notebook_comes_before():
    for number, needed in batch.NEEDS.items():
        assert all(other < number for other in needed)


def test_gallery_needs_executed_notebooks(house):
    assert gallery.main(["--preset", "smoke"]) == 1
    folder = paths.executed_folder("smoke")
    folder.mkdir(parents=True)
    (folder / "01_house.ipynb").write_text("{")
    with pytest.raises(DataError, match="01_house"):
        gallery.build_gallery("smoke")
