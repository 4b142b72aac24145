"""How long it took: everything a result rests on, each thing once."""

from __future__ import annotations

import shutil

import pytest
from artifact_toys import Counted, Parameters, damage_empty, make

from cassie_lib.artifacts.ledger import computed_since, from_nothing_s
from cassie_lib.provenance import Provenance

pytestmark = pytest.mark.usefixtures("artifact_folders")


@pytest.fixture
def tree():
    """An expert, two data sets by it, a model on both and a trial of model and expert."""
    expert = make(stage="expert")
    data = [make(Parameters(size=size), upstream=[expert]) for size in (4, 5)]
    model = make(stage="causal", upstream=data)
    return expert, data, model, make(stage="cem", upstream=[expert, model])


def times(*results):
    return sum(item.wall_time_s for item in results)


def set_times(monkeypatch, tree):
    """Every artifact takes another power of two seconds: a sum tells what is in it."""
    expert, data, model, trial = tree
    for power, item in enumerate((expert, *data, model, trial)):
        item.manifest["wall_time_s"] = 2.0**power
    known = {item.name: item.manifest for item in (expert, *data, model, trial)}
    monkeypatch.setattr("cassie_lib.artifacts.ledger.read_manifest", lambda path: known[path.name])


def test_each_result_below_counts_once(tree, monkeypatch):
    set_times(monkeypatch, tree)
    expert, data, model, trial = tree
    assert from_nothing_s([expert]) == 1
    assert from_nothing_s(data) == 1 + 2 + 4
    assert from_nothing_s([trial]) == from_nothing_s([trial, model, expert]) == 31
    assert Provenance.of("laptop", 0, [data[0], model]).from_nothing_s == 15
    assert from_nothing_s([]) == 0


def test_what_is_not_stored_or_damaged_is_left_out(tree):
    expert, data, model, trial = tree
    whole = from_nothing_s([trial])
    assert whole == pytest.approx(times(expert, *data, model, trial))
    shutil.rmtree(data[0].path)
    damage_empty(data[1].path / "manifest.json")
    assert from_nothing_s([trial]) == pytest.approx(times(expert, model, trial))


def test_only_results_of_the_preset_since_then_count():
    old = make(stage="cem", preset="smoke")
    since = old.manifest["finished_unix_s"]
    later = make(Parameters(size=9), compute=Counted("x"), preset="smoke, not kept")
    make(Parameters(size=10), preset="laptop")
    assert computed_since(since + 1e-6, "smoke") == (1, later.wall_time_s)
    assert computed_since(since, "smoke")[0] == 2
