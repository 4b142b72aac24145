"""Notices that a recomputation has disproved are taken back, and no others."""

from __future__ import annotations

import pytest
from artifact_toys import Counted, damage_flip, make

from cassie_lib.artifacts import recompute, stages
from cassie_lib.artifacts.__main__ import main
from cassie_lib.artifacts.renew import RENEWED, renew
from cassie_lib.errors import ArtifactError

pytestmark = pytest.mark.usefixtures("artifact_folders")


@pytest.fixture
def built_on_old_data(monkeypatch):
    """Data, a model on it and a trial of the model; the data's code has changed since."""
    with monkeypatch.context() as old:
        old.setattr(stages, "code_fingerprint", lambda modules: {"data/collect.py": "0" * 16})
        data = make()
    data = make()
    # What is made now is made by present code, but from the older data.
    model = make(stage="causal", upstream=[data])
    trial = make(stage="cem", upstream=[model])
    (line,) = (line for line in data.notice if data.name in line)
    assert line in model.notice
    assert line in trial.notice
    return data, line


def remade(monkeypatch, **options):
    """The data set, computed anew by present code."""
    monkeypatch.setenv(recompute.REQUEST, "data")
    data = make(**options)
    monkeypatch.setenv(recompute.REQUEST, "")
    return data


def stored_notices(data, stage="causal"):
    upstream = [data] if stage == "causal" else [make(stage="causal", upstream=[data])]
    return make(stage=stage, upstream=upstream).notice


def test_same_bits_from_present_code_take_the_notice_back(built_on_old_data, monkeypatch):
    old, line = built_on_old_data
    data = remade(monkeypatch)
    assert data.digest == old.digest
    assert line in stored_notices(data), "nothing is taken back unasked"
    changed = renew()
    assert sorted(name.split("-")[0] for name in changed) == ["causal", "cem"]
    assert set(changed.values()) == {(line,)}
    assert stored_notices(data) == stored_notices(data, "cem") == ()
    assert make(stage="causal", upstream=[data]).manifest[RENEWED] == [line]
    assert renew() == {}


def test_other_bits_leave_it(built_on_old_data, monkeypatch):
    _, line = built_on_old_data
    data = remade(monkeypatch, compute=Counted("other bits"))
    assert renew() == {}
    assert line in stored_notices(data)


def test_so_does_old_code(built_on_old_data):
    data, line = built_on_old_data
    assert renew() == {}
    assert line in stored_notices(data)


def test_a_damaged_artifact_stops_it(built_on_old_data, monkeypatch):
    data = remade(monkeypatch)
    damage_flip(make(stage="causal", upstream=[data]).path / "weights.bin")
    with pytest.raises(ArtifactError, match=r"weights\.bin"):
        renew()


def test_command_line(built_on_old_data, monkeypatch, capsys):
    _, line = built_on_old_data
    remade(monkeypatch)
    assert main(["renew"]) == 0
    assert line in capsys.readouterr().out
