"""Damaged artifacts of every stage: one line that names what is wrong, and never a reuse."""

from __future__ import annotations

import json
import shutil

import pytest
from artifact_toys import damage_cut, damage_empty, damage_flip, damage_remove
from damage_toys import MAIN_FILE, content, edit_manifest, refused, swap
from pipeline_toys import LOADERS, TINY

from cassie_lib import dagger_pipeline, paths, pipeline, planner_pipeline
from cassie_lib.artifacts import stages
from cassie_lib.errors import ArtifactError
from cassie_lib.presets import replace


def damage_folder(path):
    path.unlink()
    path.mkdir()


@pytest.mark.parametrize(
    "damage", [damage_cut, damage_flip, damage_empty, damage_remove, damage_folder]
)
@pytest.mark.parametrize("kind", LOADERS)
def test_a_damaged_file_of_any_stage_is_named(stored, kind, damage):
    damage(stored[kind] / MAIN_FILE[kind])
    message = refused(kind, stored, ArtifactError)
    assert f"{stored[kind].name} is damaged: {MAIN_FILE[kind]} " in message
    assert f"make figures RECOMPUTE={stored[kind].name.split('-')[0]}" in message


def write(text):
    return lambda path: path.write_bytes(text.encode("latin-1"))


MANIFESTS = {
    "not JSON": ("expert", write("{'stage': 'expert'}"), "cannot be read"),
    "cut": ("data", damage_cut, "cannot be read"),
    "empty": ("mlp", damage_empty, "cannot be read"),
    "missing": ("transformer", damage_remove, "is missing"),
    "a folder": ("causal", damage_folder, "cannot be read"),
    "a list": ("cem", write("[1, 2]"), "cannot be read"),
    "null": ("dagger", write("null"), "cannot be read"),
    "not text": ("expert", write("\xff\xfe\x00"), "cannot be read"),
    "NaN": ("causal", write('{"seal": NaN, "key": NaN}'), "cannot be read"),
    "other parameters": ("mlp", edit_manifest(parameters={"mlp": 1}, sealed=False), "was edited"),
    "other hash": ("data", edit_manifest(digest="0" * 64, sealed=False), "was edited"),
    "other preset": ("cem", edit_manifest(preset="laptop", sealed=False), "was edited"),
    "other seed": ("dagger", edit_manifest(seed=9, sealed=False), "was edited"),
    "other parameters, sealed": ("expert", edit_manifest(parameters={}), "belongs to expert-"),
    "other upstream, sealed": ("transformer", edit_manifest(upstream=["0"]), "belongs to trans"),
    "other stage, sealed": ("causal", edit_manifest(stage="mlp"), "belongs to mlp-"),
    "later version, sealed": ("data", edit_manifest(version=99), "belongs to data-"),
    "later format, sealed": ("cem", edit_manifest(files=None), "lacks files"),
    "key is a number, sealed": ("dagger", edit_manifest(key=1), "belongs to dagger-1"),
}


@pytest.mark.parametrize("name", MANIFESTS)
def test_a_damaged_manifest_of_any_stage_is_named(stored, name):
    kind, damage, expected = MANIFESTS[name]
    damage(stored[kind] / "manifest.json")
    message = refused(kind, stored, ArtifactError)
    assert f"{stored[kind].name} is damaged: manifest.json {expected}" in message


SWAPS = {
    "weights of another model": ("mlp", "transformer", "model.safetensors", "bytes, expected"),
    "card of another model": ("causal", "mlp", "card.json", "bytes, expected"),
    "states of another data set": ("data", "wide", "states.npy", "another SHA-256"),
    "card of another data set": ("data", "wide", "card.json", "card.json has"),
    "manifest of another data set": ("data", "wide", "manifest.json", "belongs to data-"),
}


@pytest.mark.parametrize("name", SWAPS)
def test_files_swapped_between_artifacts_are_found(stored, name):
    kind, other, file, expected = SWAPS[name]
    swap(stored[kind] / file, stored[other] / file)
    message = refused(kind, stored, ArtifactError)
    assert stored[kind].name in message
    assert expected in message


def test_a_file_in_the_place_of_an_artifact_is_refused(stored):
    shutil.rmtree(stored["expert"])
    stored["expert"].write_text("expert")
    assert "is a file, expected a folder" in refused("expert", stored, ArtifactError)


def test_a_whole_artifact_under_the_name_of_another_is_refused(stored):
    shutil.rmtree(stored["data"])
    stored["wide"].rename(stored["data"])
    assert f"belongs to {stored['wide'].name}" in refused("data", stored, ArtifactError)


CHANGES = {
    "expert": lambda: pipeline.expert_artifact(changed("expert", learning_rate=1e-4)),
    "data": lambda: pipeline.dataset_artifact(
        replace(TINY, simulation=replace(TINY.simulation, speed_mps=0.3)), "train"
    ),
    "mlp": lambda: pipeline.mlp_artifact(TINY, curriculum=True),
    "transformer": lambda: pipeline.transformer_artifact(changed("transformer", dropout=0.3)),
    "causal": lambda: pipeline.causal_artifact(changed("causal", context=7)),
    "cem": lambda: planner_pipeline.planner_trial(TINY, "cem", steps=11),
    "dagger": lambda: dagger_pipeline.dagger(changed("dagger", decay=0.5), rounds=1),
}


def changed(section, **values):
    return replace(TINY, **{section: replace(getattr(TINY, section), **values)})


@pytest.mark.parametrize("kind", CHANGES)
def test_other_parameters_are_computed_anew_and_replace_nothing(stored, computed, kind):
    before = content(stored[kind])
    with pytest.raises(computed.Anew) as wanted:
        CHANGES[kind]()
    assert str(wanted.value).startswith(kind)
    assert str(wanted.value) != stored[kind].name
    assert content(stored[kind]) == before


@pytest.mark.parametrize("kind", LOADERS)
def test_another_version_of_a_stage_is_computed_anew(stored, computed, monkeypatch, kind):
    stage = stages.STAGES[kind]
    monkeypatch.setitem(stages.STAGES, kind, replace(stage, version=stage.version + 1))
    with pytest.raises(computed.Anew, match=f"{kind}-"):
        LOADERS[kind]()


def test_a_planner_trial_on_other_weights_is_computed_anew(stored, computed):
    card = stored["causal"] / "card.json"
    card.write_text(json.dumps({**json.loads(card.read_text()), "notes": "trained once more"}))
    edit_manifest()(stored["causal"] / "manifest.json")
    for kind in ("cem", "dagger"):
        with pytest.raises(computed.Anew, match=f"{kind}-"):
            LOADERS[kind]()


def test_a_missing_artifact_is_computed_anew(stored, computed):
    shutil.rmtree(stored["mlp"])
    with pytest.raises(computed.Anew, match=stored["mlp"].name):
        LOADERS["mlp"]()
    assert not (paths.CACHE / stored["mlp"].name).exists()
