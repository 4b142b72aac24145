"""Source notebooks are clean, short, and say at one place what can be changed."""

from __future__ import annotations

import ast
import json

import pytest

from cassie_lib import batch, notebook_run, paths

NOTEBOOKS = sorted(paths.NOTEBOOKS.glob("*.ipynb"))


def test_names_and_numbers_fit_the_batch_runner():
    numbers = [path.name[:2] for path in NOTEBOOKS]
    assert len(set(numbers)) == len(numbers)
    assert set(numbers) <= set(batch.NEEDS)


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def notebook(request):
    return json.loads(request.param.read_text(encoding="utf-8"))


def code(notebook):
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    return ["".join(cell["source"]) for cell in cells]


def test_it_is_committed_clean(notebook):
    assert notebook["metadata"]["kernelspec"]["name"] == "python3"
    assert "papermill" not in notebook["metadata"]
    ids = [cell["id"] for cell in notebook["cells"]]
    assert len(set(ids)) == len(ids)
    for cell in notebook["cells"]:
        assert set(cell["metadata"]) <= {"tags"}
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None


def test_one_cell_of_literals_holds_the_parameters(notebook):
    tagged = [
        cell for cell in notebook["cells"] if "parameters" in cell["metadata"].get("tags", ())
    ]
    assert len(tagged) == 1
    lines = "".join(tagged[0]["source"]).splitlines()
    for node in ast.parse("\n".join(lines)).body:
        assert isinstance(node, ast.Assign), "only assignments"
        ast.literal_eval(node.value)
        assert "#" in lines[node.end_lineno - 1], "type and unit in a comment"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_default_is_laptop(path):
    assert notebook_run.notebook_parameters(path)["PRESET"] == "laptop"


def test_cells_are_short_and_define_nothing(notebook):
    cells = code(notebook)
    assert len(cells) <= 12
    for cell in cells:
        # The formatter breaks calls with many arguments into many lines: statements count too.
        tree = ast.parse(cell)
        assert sum(isinstance(node, ast.stmt) for node in ast.walk(tree)) <= 16
        assert len([line for line in cell.splitlines() if line.strip()]) <= 36
        kinds = {type(node) for node in ast.walk(tree)}
        assert not kinds & {ast.FunctionDef, ast.ClassDef, ast.AsyncFunctionDef}


def test_it_cites_the_thesis_and_checks_its_claims(notebook):
    text = "".join("".join(cell["source"]) for cell in notebook["cells"])
    assert any(word in text for word in ("Figure ", "Table ", "Algorithm ", "Eq "))
    assert any("assert " in cell for cell in code(notebook))
    assert "provenance" in text.lower()
