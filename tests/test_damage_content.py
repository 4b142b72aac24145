"""Artifacts whose manifest is right about files that no stage can use: another program's."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
import torch
from damage_toys import edit_manifest, refused
from safetensors.torch import load_file, save_file
from test_data_store import reseal

from cassie_lib.dynamics.checkpoint import tensor_digest
from cassie_lib.errors import (
    ArtifactError,
    CheckpointError,
    DataError,
    NonFiniteError,
    SchemaError,
    ShapeError,
    UnknownNameError,
)
from cassie_lib.files import sha256_file
from cassie_lib.packing import pack, packed, unpacked


def card(**changes):
    """Change entries of a card; a dictionary changes entries of an entry."""

    def edit(folder, name="card.json"):
        found = json.loads((folder / name).read_text())
        for key, value in changes.items():
            found[key] = {**found[key], **value} if isinstance(value, dict) else value
        (folder / name).write_text(json.dumps(found))

    return edit


def text(name, content):
    return lambda folder: (folder / name).write_bytes(content.encode("latin-1"))


def weights(change, name="model.safetensors"):
    """Change the tensors of a model, and its card with them."""

    def edit(folder):
        tensors = load_file(str(folder / name))
        change(tensors)
        save_file(tensors, str(folder / name))
        if name.startswith("model"):
            card(weights=tensor_digest(tensors))(folder)

    return edit


def field(name, change):
    """Change an array of a data set, and its card with it."""

    def edit(folder):
        path = folder / f"{name}.npy"
        np.save(path, change(np.load(path)))
        digest = sha256_file(path)
        reseal(folder, lambda found: found["fields"][name].update(sha256=digest))

    return edit


def arrays(name, change):
    """Change the arrays of an archive."""

    def edit(folder):
        with np.load(folder / name) as stored:
            found = dict(stored)
        change(found)
        np.savez_compressed(folder / name, **found)

    return edit


def episodes(change):
    """Change the arrays of a planner's episodes."""
    return arrays("episodes.npz", change)


def transitions(change):
    """Change the arrays of what a round of DAgger has collected, and pack them again."""

    def edit(stored):
        found = unpacked(stored)
        change(found)
        stored.clear()
        stored.update(packed(found))

    return arrays("transitions.npz", edit)


def first(tensors, value):
    tensors[min(tensors)].view(-1)[0] = value


def spoil(array):
    array[3] = np.nan
    return array


def in_folder(name, edit):
    return lambda folder: edit(folder / name)


CASES = {
    "expert: card is not JSON": ("expert", text("card.json", "{"), CheckpointError, "no usable"),
    "expert: card without architecture": (
        "expert", text("card.json", "{}"), CheckpointError, "'architecture'"),
    "expert: another architecture": (
        "expert", card(architecture={"hidden_size": 8}), CheckpointError, "one architecture"),
    "expert: architecture of a later version": (
        "expert", card(architecture={"attention": 4}), CheckpointError, "attention"),
    "expert: a tensor is missing": (
        "expert", weights(lambda t: t.pop("input_mean"), "expert.safetensors"),
        CheckpointError, "no usable expert"),
    "data: another schema": (
        "data", lambda f: reseal(f, lambda c: c["schema"].update(digest="0")),
        SchemaError, "another state schema"),
    "data: later format": (
        "data", lambda f: reseal(f, lambda c: c.update(format=2)), DataError, "2: expected 1"),
    "data: card without schema": (
        "data", lambda f: reseal(f, lambda c: c.pop("schema")), DataError, "lacks schema"),
    "data: double precision": (
        "data", field("actions", lambda a: a.astype("<f8")), SchemaError, "actions.npy holds <f8"),
    "data: nine motors": (
        "data", field("actions", lambda a: a[:, :9].copy()), SchemaError, r"expected <f4 \(10,\)"),
    "data: a row too few": (
        "data", field("actions", lambda a: a[:-1].copy()), ShapeError, "actions has shape"),
    "data: NaN in a state": (
        "data", field("states", spoil), NonFiniteError, "states holds NaN"),
    "data: phase beyond the clock": (
        "data", field("phase", lambda a: a + 20), DataError, r"phase reaches .* expected 0..27"),
    "data: episodes out of order": (
        "data", field("episode_starts", lambda a: a[::-1].copy()), DataError, "must increase"),
    "data: states are an archive": (
        "data", lambda f: (np.savez(f / "x.npz", a=1), (f / "x.npz").rename(f / "states.npy"),
                           field_digest(f, "states")),
        DataError, "states.npy cannot be read"),
    "mlp: card is a list": ("mlp", text("card.json", "[]"), ArtifactError, "is a list"),
    "mlp: card is not text": ("mlp", text("card.json", "\xff\xfe"), ArtifactError, "not JSON"),
    "mlp: card without digest": (
        "mlp", text("card.json", '{"kind": "mlp"}'), ArtifactError, "lacks normalisation"),
    "mlp: a causal model": ("mlp", card(kind="causal"), CheckpointError, "expected mlp"),
    "mlp: NaN weights": (
        "mlp", weights(lambda t: first(t, float("nan"))), NonFiniteError, "holds NaN or infinity"),
    "mlp: half precision": (
        "mlp", weights(lambda t: t.update({n: v.half() for n, v in t.items()})),
        CheckpointError, "another architecture"),
    "transformer: unknown kind": (
        "transformer", card(kind="oracle"), UnknownNameError, "causal, mlp, transformer"),
    "transformer: kind is a list": (
        "transformer", card(kind=["mlp"]), UnknownNameError, r"\['mlp'\]"),
    "transformer: another schema": (
        "transformer", card(schema="0"), SchemaError, "another state schema"),
    "transformer: another normalisation": (
        "transformer", card(normalisation="0"), SchemaError, "another normalisation"),
    "transformer: parameter of a later version": (
        "transformer", card(parameters={"experts": 8}), CheckpointError, "experts"),
    "transformer: infinite weights": (
        "transformer", weights(lambda t: first(t, float("inf"))), NonFiniteError, "finite"),
    "causal: parameters are a list": (
        "causal", card(parameters=[1]), CheckpointError, "unknown parameters"),
    "causal: heads that do not divide": (
        "causal", card(parameters={"heads": 5}), CheckpointError, "card.json|architecture"),
    "causal: another width": (
        "causal", card(parameters={"model_size": 32}), CheckpointError, "another architecture"),
    "causal: negative width": (
        "causal", card(parameters={"model_size": -16}), CheckpointError, "card.json"),
    "causal: other weights than the card's": (
        "causal", card(weights="0"), CheckpointError, "does not match the SHA-256"),
    "causal: a tensor too many": (
        "causal", weights(lambda t: t.update(extra=torch.ones(1))),
        CheckpointError, "another architecture"),
    "cem: no archive": ("cem", text("episodes.npz", "episodes"), ArtifactError, "no planned"),
    "cem: a term is missing": (
        "cem", episodes(lambda a: a.pop("packed_term_motor")), ArtifactError, "term_motor"),
    "cem: an array of a later version": (
        "cem", episodes(lambda a: a.update(torque=np.ones(3))), ArtifactError, "torque"),
    "cem: states of another schema": (
        "cem", episodes(lambda a: a.update(
            packed_states=pack(np.zeros((*a["shape_states"][:2], 46))),
            shape_states=np.array([*a["shape_states"][:2], 46]))),
        ArtifactError, "states has shape"),
    "cem: packed bytes of another shape": (
        "cem", episodes(lambda a: a.update(shape_qpos=a["shape_qpos"] + 1)),
        ArtifactError, "reshape"),
    "cem: a seed too few": (
        "cem", episodes(lambda a: a.update(length=a["length"][:-1])),
        ArtifactError, "length has shape"),
    "cem: a log of other seeds": (
        "cem", episodes(lambda a: a.update(log_planned=a["log_planned"][:, :1])),
        ArtifactError, "log_planned has shape"),
    "cem: pickled objects": (
        "cem", episodes(lambda a: a.update(length=np.array([{}, None]))), ArtifactError, "pickle"),
    "dagger: report is not JSON": ("dagger", text("report.json", "{"), ArtifactError, "report"),
    "dagger: report without errors": (
        "dagger", text("report.json", '{"counts": {}}'), ArtifactError, "lacks relative_error"),
    "dagger: NaN weights": (
        "dagger", in_folder("model", weights(lambda t: first(t, float("nan")))),
        NonFiniteError, "model.safetensors holds NaN"),
    "dagger: a fully connected model": (
        "dagger", in_folder("model", card(kind="mlp")), CheckpointError, "expected causal"),
    "dagger: no archive": (
        "dagger", text("transitions.npz", "rows"), ArtifactError, "holds no transitions"),
    "dagger: an array is missing": (
        "dagger", transitions(lambda a: a.pop("phase")), ArtifactError, "phase"),
    "dagger: packed bytes of another shape": (
        "dagger", arrays("transitions.npz", lambda a: a.update(shape_states=a["shape_states"] + 1)),
        ArtifactError, "reshape"),
    "dagger: no states": (
        "dagger", transitions(lambda a: a.pop("states")), ArtifactError, "states"),
    "dagger: states of another schema": (
        "dagger", transitions(lambda a: a.update(states=a["states"][..., :46])),
        ArtifactError, r"states .*46"),
    "dagger: actions of fewer steps": (
        "dagger", transitions(lambda a: a.update(actions=a["actions"][:, :-1])),
        ArtifactError, "actions"),
}  # fmt: skip


def field_digest(folder, name):
    digest = sha256_file(folder / f"{name}.npy")
    reseal(folder, lambda found: found["fields"][name].update(sha256=digest))


@pytest.mark.parametrize("name", CASES)
def test_content_that_no_stage_can_use_is_named(stored, name):
    kind, damage, error, expected = CASES[name]
    damage(stored[kind])
    edit_manifest()(stored[kind] / "manifest.json")
    message = refused(kind, stored, error)
    assert len(message) < 400
    assert re.search(expected, message), message
