"""Flipped bits and cuts at random places of what no manifest covers: all are found, or harmless."""

from __future__ import annotations

import random

import numpy as np
import pytest
import torch

from cassie_lib.checkpoints import load_checkpoint, save_checkpoint
from cassie_lib.data.collect import _read_batch
from cassie_lib.dynamics.store import load_model
from cassie_lib.errors import CassieError, CheckpointError
from cassie_lib.expert.policy import ExpertPolicy
from cassie_lib.logs import CsvLog
from cassie_lib.planning.episodes import load_episodes

TRIALS = 80


def damaged(whole, seed):
    """Copies of a file with one bit flipped (two of three) or cut short (one of three)."""
    chance = random.Random(seed)
    for trial in range(TRIALS):
        copy = bytearray(whole)
        if trial % 3 == 2:
            yield bytes(copy[: chance.randrange(len(copy))])
            continue
        # Headers and directories at both ends are small and matter most.
        near = chance.randrange(min(600, len(copy)))
        place = chance.choice([near, -1 - near, chance.randrange(len(copy))])
        copy[place] ^= 1 << chance.randrange(8)
        yield bytes(copy)


@pytest.fixture
def checkpoint(tmp_path):
    torch.manual_seed(0)
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, {"policy": ExpertPolicy(8).state_dict(), "steps": 3}, "a run")
    return path


def test_no_damaged_checkpoint_is_resumed(checkpoint):
    for content in damaged(checkpoint.read_bytes(), seed=1):
        checkpoint.write_bytes(content)
        with pytest.raises(CheckpointError, match="expected a whole checkpoint") as caught:
            load_checkpoint(checkpoint, "a run")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"PK", b"cassie checkpoint 2 " + b"0" * 50])
def test_what_is_no_checkpoint_is_not_resumed(checkpoint, content):
    checkpoint.write_bytes(content)
    with pytest.raises(CheckpointError, match="remove it to start over"):
        load_checkpoint(checkpoint, "a run")


def test_a_folder_in_the_place_of_a_checkpoint_is_named(checkpoint):
    checkpoint.unlink()
    checkpoint.mkdir()
    with pytest.raises(CheckpointError, match="checkpoint.pt cannot be read"):
        load_checkpoint(checkpoint, "a run")


def test_a_checkpoint_without_digest_is_refused(checkpoint):
    torch.save({"identity": "a run", "content": {"steps": 3}}, checkpoint)
    with pytest.raises(CheckpointError, match="expected a whole checkpoint"):
        load_checkpoint(checkpoint, "a run")


def test_no_damaged_batch_of_a_collection_is_used(tmp_path):
    path = tmp_path / "00000.npz"
    arrays = {"states": np.random.default_rng(0).normal(size=(20, 49)), "phase": np.arange(20)}
    np.savez(path, identity=np.array("a collection"), **arrays)
    for content in damaged(path.read_bytes(), seed=2):
        path.write_bytes(content)
        try:
            found = _read_batch(path, "a collection")
        except CassieError:
            continue
        # None: it is run again.  A bit may be flipped where nothing is kept, as in a date.
        assert found is None or all(np.array_equal(found[k], arrays[k]) for k in arrays)


@pytest.mark.parametrize(
    ("kind", "name", "load"),
    [
        ("cem", "episodes.npz", lambda folder: load_episodes(folder / "episodes.npz")),
        ("causal", "card.json", load_model),
        ("causal", "model.safetensors", load_model),
    ],
)
def test_loaders_of_any_damaged_file_raise_nothing_but_typed_errors(stored, kind, name, load):
    path, messages = stored[kind] / name, []
    for content in damaged(path.read_bytes(), seed=3):
        path.write_bytes(content)
        try:
            load(stored[kind])
        except CassieError as error:
            messages.append(str(error))
    assert len(messages) > TRIALS / 2
    assert not [text for text in messages if "\n" in text]
    assert not [text for text in messages if name not in text and stored[kind].name not in text]


def test_a_damaged_log_loses_its_damaged_rows_only(tmp_path):
    path = tmp_path / "log.csv"
    log = CsvLog(path, seed=0)
    for step in (1, 2, 3):
        log.write(step, 0.5, {"reward": 0.25})
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[0] + lines[1] + b"\xff\xfe\x00,\xb2\r\n" + lines[3] + lines[2][:4])
    CsvLog(path, seed=0, resume_step=9)
    assert path.read_bytes() == lines[0] + lines[1] + lines[3]
