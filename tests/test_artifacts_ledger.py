"""How long it took: everything a result rests on, each thing once."""

from __future__ import annotations

import shutil
import time

import pytest
from artifact_toys import Counted, Parameters, damage_empty, make

from cassie_lib import paths
from cassie_lib.artifacts import recompute
from cassie_lib.artifacts.ledger import computed_since, from_nothing_s
from cassie_lib.artifacts.times import FILE, read_times
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
    later = make(Parameters(size=9), compute=Counted("x"), preset="smoke")
    make(Parameters(size=10), preset="laptop")
    assert computed_since(since + 1e-6, "smoke") == (1, later.wall_time_s)
    assert computed_since(since, "smoke")[0] == 2


def test_what_git_does_not_keep_counts_with_what_it_took():
    expert = make(stage="expert", preset="laptop", kept=True)
    data = make(upstream=[expert], preset="laptop")
    model = make(stage="causal", upstream=[data], preset="laptop", kept=True)
    whole = from_nothing_s([model])
    assert whole == pytest.approx(times(expert, data, model))
    noted = (paths.DATA / FILE).read_text()
    shutil.rmtree(paths.CACHE)
    stored = make(stage="causal", upstream=[data], preset="laptop")
    assert stored.path.parent == paths.DATA
    assert from_nothing_s([stored]) == pytest.approx(whole), "data that is not at hand counts, too"
    # Collected again, on a slower machine: nobody's figures change.
    make(upstream=[expert], preset="laptop", compute=slow)
    assert (paths.DATA / FILE).read_text() == noted


def test_a_request_to_compute_anew_notes_the_new_time(monkeypatch):
    name = make(preset="laptop").name
    before = read_times()[name]["seconds"]
    monkeypatch.setenv(recompute.REQUEST, "data")
    make(preset="laptop", compute=slow)
    assert read_times()[name]["seconds"] >= before + 0.2


def test_other_presets_note_nothing_and_a_damaged_file_counts_as_none():
    make(preset="smoke")
    make(Parameters(size=4), preset="thesis")
    assert not (paths.DATA / FILE).exists()
    paths.DATA.mkdir()
    for text in ("", "[]", '{"a": 3}', '{"a": {"seconds": "x", "upstream": []}}'):
        (paths.DATA / FILE).write_text(text)
        assert read_times() == {}


def slow(folder):
    time.sleep(0.3)
    Counted()(folder)
