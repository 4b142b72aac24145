"""Pending results: known by their recipe, computed for whoever computes from them, not to load."""

from __future__ import annotations

import shutil

import pytest
from artifact_toys import Counted, Parameters, damage_flip, make

from cassie_lib.artifacts import Pending
from cassie_lib.errors import ArtifactError, ParameterError
from cassie_lib.provenance import Provenance

pytestmark = pytest.mark.usefixtures("artifact_folders")


def test_it_is_the_same_artifact_as_the_one_computed_at_once():
    pending = Pending("data", Parameters(), Counted())
    assert pending.at_hand() is None
    artifact = make()
    assert (pending.key, pending.identity, pending.name) == (
        artifact.key, artifact.identity, artifact.name,
    )  # fmt: skip
    assert pending.at_hand().path == artifact.path
    assert pending.get().from_cache


def test_it_is_computed_once_for_a_result_that_has_to_be_and_never_to_load_one():
    collect, train = Counted("data"), Counted("weights")

    def trained():
        pending = Pending("data", Parameters(), collect)
        return make(stage="mlp", compute=train, upstream=[pending])

    first = trained()
    assert (collect.runs, train.runs) == (1, 1)
    shutil.rmtree(make(compute=collect).path)
    assert trained().digest == first.digest
    assert (collect.runs, train.runs) == (1, 1), "loading a model asks for no data"
    shutil.rmtree(first.path)
    trained()
    assert (collect.runs, train.runs) == (2, 2)


def test_results_from_it_and_from_the_artifact_have_one_key():
    pending = make(stage="mlp", upstream=[Pending("data", Parameters(), Counted())])
    assert make(stage="mlp", upstream=[make()]).key == pending.key


def test_another_recipe_of_it_is_another_result():
    one, two = (Pending("data", Parameters(seed=seed), Counted()) for seed in (7, 8))
    assert make(stage="mlp", upstream=[one]).key != make(stage="mlp", upstream=[two]).key


def test_damaged_data_is_told_even_if_only_the_model_is_loaded():
    pending = Pending("data", Parameters(), Counted())
    make(stage="mlp", upstream=[pending])
    damage_flip(pending.get().path / "weights.bin")
    with pytest.raises(ArtifactError, match=r"weights\.bin"):
        make(stage="mlp", upstream=[pending])


def test_a_figures_provenance_names_it_once_it_has_been_needed():
    pending = Pending("data", Parameters(), Counted())
    trained = make(stage="mlp")
    assert Provenance.of("smoke", 0, [pending, trained, trained]).artifacts == (trained,)
    pending.get()
    assert [item.name for item in Provenance.of("smoke", 0, [pending]).artifacts] == [pending.name]


def test_weights_cannot_be_pending():
    with pytest.raises(ParameterError, match="'expert' counts by its content"):
        Pending("expert", Parameters(), Counted())
