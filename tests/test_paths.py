"""One module knows the folders; committed ones are written by unchanged laptop runs only."""

from __future__ import annotations

import ast
import os
import subprocess
import sys

import pytest

from cassie_lib import paths


def asked(expression, **environment):
    command = [sys.executable, "-c", f"from cassie_lib import paths; print({expression})"]
    known = {k: v for k, v in os.environ.items() if not k.startswith("CASSIE_")}
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env={**known, **environment}
    )
    return done.stdout.strip()


def test_the_repository_is_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert asked("paths.ROOT") == str(paths.PACKAGE.parent)
    assert asked("paths.CACHE") == str(paths.PACKAGE.parent / "data" / "cache")


def test_variables_move_the_repository_and_the_cache(tmp_path):
    home, cache = str(tmp_path / "home"), str(tmp_path / "cache")
    assert asked("paths.FIGURES", CASSIE_HOME=home) == os.path.join(home, "figures")
    assert asked("paths.CACHE", CASSIE_HOME=home) == os.path.join(home, "data", "cache")
    assert asked("paths.CACHE", CASSIE_HOME=home, CASSIE_CACHE=cache) == cache
    assert asked("paths.ROBOT_XML.exists()", CASSIE_HOME=home) == "True"


def test_relative_folders_do_not_depend_on_who_asks(tmp_path, monkeypatch):
    (tmp_path / "home" / "notebooks").mkdir(parents=True)
    expected = str(tmp_path / "home" / "mine")
    for folder in (tmp_path, tmp_path / "home" / "notebooks"):
        monkeypatch.chdir(folder)
        found = asked("paths.CACHE, paths.os.environ['CASSIE_CACHE'], paths.os.getcwd()",
                      CASSIE_HOME=str(tmp_path / "home"), CASSIE_CACHE="mine")  # fmt: skip
        assert found.split() == [expected, expected, str(folder)]
    # What a child process inherits is absolute, from wherever it starts.
    monkeypatch.chdir(tmp_path)
    assert asked("paths.os.environ['CASSIE_HOME']", CASSIE_HOME="home") == str(tmp_path / "home")


def test_empty_variables_count_as_not_set():
    assert asked("paths.ROOT", CASSIE_HOME="") == str(paths.PACKAGE.parent)
    assert asked("paths.CACHE", CASSIE_CACHE="") == str(paths.PACKAGE.parent / "data" / "cache")


@pytest.mark.parametrize("place", [paths.figures_folder, paths.executed_folder])
def test_every_kind_of_run_has_a_folder_of_its_own(place):
    runs = [(name, changed) for name in ("smoke", "laptop", "thesis") for changed in (False, True)]
    folders = {run: place(*run) for run in runs}
    assert len(set(folders.values())) == len(runs)
    for (name, changed), folder in folders.items():
        inside_git = not folder.is_relative_to(paths.CACHE)
        if changed or name == "smoke":
            assert not inside_git
        if name == "laptop" and not changed:
            assert inside_git


def test_no_other_module_builds_a_folder_of_the_repository():
    for path in paths.PACKAGE.rglob("*.py"):
        if path.name == "paths.py":
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        used = [node.id for node in ast.walk(tree) if isinstance(node, ast.Name)]
        assert "__file__" not in used, f"{path.name} finds its own folder: paths.py does that"
