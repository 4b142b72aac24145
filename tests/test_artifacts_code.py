"""Which code made a stored result: what counts as a change, and what is said of it."""

from __future__ import annotations

import ast
import shutil

import pytest
from artifact_toys import make

from cassie_lib import paths
from cassie_lib.artifacts import equal_code, stages
from cassie_lib.code_version import code_fingerprint, file_fingerprint

pytestmark = pytest.mark.usefixtures("artifact_folders")


def test_fingerprints_are_the_same_on_every_version_of_python(tmp_path):
    """The expected ones were written by 3.11, and found by 3.12 and 3.13 as well."""
    source = tmp_path / "toy.py"
    text = '"""Doc."""\nclass A(B):\n    """Doc."""\n    x: int = 1\n    def f(self): pass\n'
    source.write_text(text)
    assert file_fingerprint(source) == "648b925d4f235755"
    commented = tmp_path / "other.py"
    commented.write_text(text.replace("Doc", "Other").replace("pass", "pass  # why"))
    assert file_fingerprint(commented) == file_fingerprint(source)


def test_changed_code_is_told_in_the_notice(monkeypatch):
    make()
    changed = {**stages.code_fingerprint(("data", "simulator")), "simulator.py": "0" * 16}
    monkeypatch.setattr(stages, "code_fingerprint", lambda modules: changed)
    artifact = make()
    assert artifact.from_cache
    assert "simulator.py" in artifact.notice[0]
    later = make(stage="mlp", upstream=[artifact])
    assert artifact.notice[0] in later.notice, "what is built on it says so too"


def test_a_version_with_the_same_bits_brings_no_notice(monkeypatch):
    name, present, older, other = "simulator.py", "1" * 16, "2" * 16, "3" * 16
    monkeypatch.setattr(equal_code, "EQUAL", {name: (present, frozenset({older}))})

    def notice(made, now):
        monkeypatch.setattr(stages, "code_fingerprint", lambda modules: {name: made})
        shutil.rmtree(paths.CACHE, ignore_errors=True)
        make()
        monkeypatch.setattr(stages, "code_fingerprint", lambda modules: {name: now})
        return make().notice

    assert notice(older, present) == ()
    assert notice(other, present), "another version is another"
    assert notice(older, other), "changed once more: the proof is of another version"
    assert notice(present, older), "the older version does not stand for the present one"


def test_versions_with_the_same_bits_are_those_of_today():
    """A file that is changed again needs another proof, or its line goes."""
    for name, (present, older) in equal_code.EQUAL.items():
        assert code_fingerprint((name.removesuffix(".py"),)) == {name: present}
        assert present not in older


#: Modules that no result depends on: parameters are part of the recipe, the others store and tell.
STOREKEEPING = {"errors", "paths", "files", "logs", "checkpoints", "artifacts", "presets",
                "simulator_checks", "walking_report", "planning/resume"}  # fmt: skip
#: Training reads arrays: what ``data`` needs to collect them has no part in it.
COLLECTING = {"controllers", "simulator", "robot/state", "dynamics/adjoint"}
#: The expert is upstream of what DAgger does, by its bits.
NOT_ITS_OWN = {
    "causal": COLLECTING,
    "dagger": {"expert/policy"},
    # The module that offers all trainings offers that of the causal model too.
    **dict.fromkeys(("mlp", "transformer", "prediction"), COLLECTING | {"dynamics/train_causal"}),
}


def imported_modules(name):
    """Modules of this package that a source file imports, as a stage names them."""
    for node in ast.walk(ast.parse((paths.PACKAGE / name).read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or not node.module.startswith("cassie_lib"):
            continue
        base = "/".join(node.module.split(".")[1:])
        for alias in node.names:
            inner = "/".join(filter(None, (base, alias.name)))
            is_module = (paths.PACKAGE / f"{inner}.py").exists() or (paths.PACKAGE / inner).is_dir()
            yield inner if is_module else base


@pytest.mark.parametrize("stage", stages.STAGES)
def test_a_stage_names_all_modules_that_its_work_rests_on(stage):
    own = stages.STAGES[stage].code()
    allowed = STOREKEEPING | NOT_ITS_OWN.get(stage, set())
    for file in own:
        if file.endswith(".py"):
            for module in imported_modules(file):
                inside = any(n == f"{module}.py" or n.startswith(f"{module}/") for n in own)
                assert inside or module in allowed, f"{file} of {stage} rests on {module}"


@pytest.mark.parametrize("stage", stages.STAGES)
def test_every_stage_names_modules_that_exist(stage):
    for module in stages.STAGES[stage].modules:
        assert code_fingerprint((module,)), f"{module} has no source file"
    whole = code_fingerprint(stages.STAGES[stage].modules)
    assert set(stages.STAGES[stage].without) <= set(whole), "left out of what it is not in"
    assert whole.keys() - stages.STAGES[stage].code().keys() == set(stages.STAGES[stage].without)


def test_code_without_a_part_in_a_stage_causes_no_notice(monkeypatch):
    frozen = "dynamics/adjoint.py"
    causal, planner = make(stage="causal"), make(stage="cem")
    modules = stages.STAGES["causal"].modules
    changed = {**stages.code_fingerprint(modules), frozen: "0" * 16}
    monkeypatch.setattr(stages, "code_fingerprint", lambda modules: changed)
    assert stages.STAGES["causal"].code().keys().isdisjoint({frozen})
    assert make(stage="causal").notice == causal.notice == ()
    assert planner.notice == ()
    assert frozen in make(stage="cem").notice[0]


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
