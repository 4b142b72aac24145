"""Records of another training stand beside the stored ones, and differences show."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from cassie_lib import paths, replication
from cassie_lib.errors import DataError
from cassie_lib.results import read_results, record_result, results_file


@pytest.fixture(autouse=True)
def own_folders(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "FIGURES", tmp_path / "figures")
    monkeypatch.setattr(paths, "CACHE", tmp_path / "cache")


def result(claim_id="06-steps", **changes):
    known = {
        "figure": "Figure 5.6", "value": 42.0, "interval": (40.0, 43.5), "seeds": 10,
        "unit": "steps",
        "protocol": "median", "wall_time_s": 90.0, "thesis_value": 101, "verdict": "not reproduced",
        "claim": "steps of CEM",
    }  # fmt: skip
    return record_result(claim_id, preset="laptop", **{**known, **changes})


def keep(name):
    """As a user keeps the records of a run: a copy."""
    target = paths.FIGURES / "replicates" / f"{name}.json"
    target.parent.mkdir(exist_ok=True)
    return Path(shutil.copy(results_file("laptop"), target))


def rows():
    lines = replication.replicates_table().splitlines()
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]


def test_a_replicate_stands_beside_what_is_made_here():
    result(value=120.0, interval=(99.0, 140.0), verdict="better")
    result("07-speed", value=0.01, interval=None, seeds=1, unit="m/s", thesis_value=None)
    keep("on-a-third-processor")
    result()
    result("07-speed", value=0.02, interval=None, seeds=1, unit="m/s", thesis_value=None)
    result("08-new-gain", claim="")
    header, _, steps, speed, new = rows()
    assert header == ["Thesis", "Claim", "here", "on a third processor"]
    assert steps == [
        "Figure 5.6", "steps of CEM: not reproduced", "42 steps [40, 43.5], 10 seeds",
        "120 steps [99, 140], 10 seeds: **better**",
    ]  # fmt: skip
    assert speed[1:] == ["steps of CEM", "0.02 m/s", "0.01 m/s"]
    assert new[1] == "new gain: not reproduced"
    assert new[-1] == "–", "a claim that the replicate has not made"


def test_the_same_verdict_is_not_said_twice():
    result()
    keep("again")
    assert rows()[2][2] == rows()[2][3]


@pytest.mark.parametrize("unit", ["ms", "h"])
def test_times_are_no_matter_of_replication(unit):
    result(unit=unit)
    keep("again")
    assert len(rows()) == 2


def test_replicates_stand_in_the_order_of_their_files():
    result()
    for title in ("b", "a"):
        keep(title)
    assert rows()[0][3:] == ["a", "b"]


@pytest.mark.parametrize("text", ["", "[", "[1]", '[{"id": "06-steps"}]', '{"a": 1}'])
def test_a_damaged_replicate_is_reported(text):
    result()
    keep("again").write_text(text)
    with pytest.raises(DataError, match=r"again\.json (cannot be read|lacks claim, figure)"):
        replication.replicates_table()


def test_results_are_compared_with_any_others(tmp_path, capsys):
    result()
    other = [{**item, "value": 50.0} for item in read_results("laptop")]
    (tmp_path / "before.json").write_text(json.dumps(other))
    assert replication.main([str(tmp_path / "before.json")]) == 0
    assert "| before.json |" in (out := capsys.readouterr().out)
    assert "| 50 steps [40, 43.5], 10 seeds |" in out
    assert replication.main([str(tmp_path / "none.json")]) == 1
    assert "none.json cannot be read" in capsys.readouterr().err
    assert replication.main([]) == 2
