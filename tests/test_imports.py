"""The library's shape: one direction of imports, no torch where none is needed, short files."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest

from cassie_lib import paths

#: From left to right; a module imports only from those before it.
ORDER = """
errors paths files code_version machine threads parameters presets logs checkpoints intervals
packing artifacts provenance
robot reward gait recorded_gait simulator_checks simulator environment
physics_checks
controllers recording walking walking_report
expert data dynamics planning dagger
expert_selection expert_pipeline data_pipeline pipeline planner_pipeline dagger_pipeline grid_search
stamps results replication readme figures video plots mlp_claims transformer_claims planner_claims
gallery notebook_run batch
""".split()
WITHOUT_TORCH = """
robot.schema robot.model robot.state robot.kinematics reward gait simulator environment walking
artifacts figures presets video batch
""".split()
LINES = 300
SOURCES = sorted(paths.PACKAGE.rglob("*.py"))


def name_of(path):
    return path.relative_to(paths.PACKAGE).as_posix()


def imported(tree):
    """Modules of this package that a file imports, anywhere in it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("cassie_lib"):
            if node.module == "cassie_lib":
                yield from (alias.name for alias in node.names)
            else:
                yield node.module.split(".")[1]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.startswith("cassie_lib.")]
            yield from (name.split(".")[1] for name in names)


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_imports_go_from_left_to_right(path):
    own = path.relative_to(paths.PACKAGE).parts[0].removesuffix(".py")
    if own == "__init__":
        return
    assert own in ORDER, f"{own} has no place yet in the order of imports"
    for other in imported(ast.parse(path.read_text(encoding="utf-8"))):
        if other != own and not other.startswith("__"):
            assert ORDER.index(other) < ORDER.index(own), f"{own} must not import {other}"


def test_robot_work_needs_no_torch():
    modules = ", ".join(f"cassie_lib.{name}" for name in WITHOUT_TORCH)
    code = f"import sys, cassie_lib, {modules}; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_package_itself_loads_nothing_heavy():
    code = (
        "import sys, cassie_lib; "
        "sys.exit(any(n in sys.modules for n in ('torch', 'mujoco', 'numpy', 'matplotlib')))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def undocumented(tree, prefix=""):
    for node in tree.body:
        if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            continue
        private = node.name.startswith("_")
        overloaded = any("overload" in ast.unparse(item) for item in node.decorator_list)
        if not private and not overloaded and not ast.get_docstring(node):
            yield prefix + node.name
        if isinstance(node, ast.ClassDef) and not private:
            yield from undocumented(node, f"{prefix}{node.name}.")


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_files_are_short_and_every_public_symbol_is_documented(path):
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= LINES
    tree = ast.parse(text)
    assert ast.get_docstring(tree) or not tree.body, "the module says what it is for"
    assert list(undocumented(tree)) == []


def test_no_pickles_and_no_loading_of_code_from_weights():
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                assert not {alias.name for alias in node.names} & {"pickle", "dill", "joblib"}
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "torch.load":
                chosen = {item.arg: ast.unparse(item.value) for item in node.keywords}
                assert chosen.get("weights_only") == "True", path
