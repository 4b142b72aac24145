"""Stored data sets: open format, equal bytes, and every damage is told in one line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from data_toys import toy_episodes

from cassie_lib.data import CARD, open_dataset, save_dataset
from cassie_lib.data import store as store_module
from cassie_lib.data.fields import FIELDS
from cassie_lib.errors import DataError, SchemaError
from cassie_lib.files import sha256_file

PROTOCOL = {"text": "a toy", "seed": 0}


@pytest.fixture
def stored(tmp_path):
    folder = tmp_path / "toy"
    save_dataset(folder, toy_episodes([30, 12], [True, False]), "toy", PROTOCOL)
    return folder


def reseal(folder, change):
    """Edit a card the way a program would that writes one of its own."""
    card = json.loads((folder / CARD).read_text())
    change(card)
    card["seal"] = store_module._seal(card)
    (folder / CARD).write_text(json.dumps(card))


def test_opens_as_memory_maps_with_the_same_content(stored):
    opened, made = open_dataset(stored), toy_episodes([30, 12], [True, False])
    for item in FIELDS:
        found = getattr(opened, item.name)
        assert isinstance(found, np.memmap)
        np.testing.assert_array_equal(found, getattr(made, item.name))
        # Any tool that reads .npy reads them: no pickles, C order, little-endian.
        assert found.flags.c_contiguous
        assert found.dtype.str == item.dtype


def test_card_says_what_a_stranger_needs(stored):
    card = json.loads((stored / CARD).read_text())
    counts = card["counts"]
    assert (counts["transitions"], counts["episodes"], counts["falls"]) == (42, 2, 1)
    assert counts["falling_samples"] == 28
    assert card["licence"]
    assert card["protocol"] == PROTOCOL
    assert len(card["schema"]["components"]) == 49
    for item in FIELDS:
        facts = card["fields"][item.name]
        assert facts["sha256"] == sha256_file(stored / facts["file"])
        assert facts["description"]
        assert facts["shape"][1:] == list(item.shape)
    assert card["fields"]["foot_force"]["unit"] == "N"


def test_equal_data_give_equal_bytes(stored, tmp_path):
    again = tmp_path / "again"
    save_dataset(again, toy_episodes([30, 12], [True, False]), "toy", PROTOCOL)
    for path in stored.iterdir():
        assert path.read_bytes() == (again / path.name).read_bytes()


@pytest.mark.parametrize("name", [f"{item.name}.npy" for item in FIELDS])
@pytest.mark.parametrize("damage", ["cut", "edited", "missing"])
def test_damaged_file_is_named(stored, name, damage):
    path = stored / name
    content = bytearray(path.read_bytes())
    if damage == "cut":
        path.write_bytes(content[:-1])
    elif damage == "edited":
        content[-1] ^= 1
        path.write_bytes(content)
    else:
        path.unlink()
    with pytest.raises(DataError, match=name) as caught:
        open_dataset(stored)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "missing"), ("", "cannot be read"), ("[1]", "cannot be read"), ("{}", "cannot")],
)
def test_damaged_card_is_named(stored, content, message):
    path = stored / CARD
    path.unlink() if content is None else path.write_text(content)
    with pytest.raises(DataError, match=message):
        open_dataset(stored)


def test_edited_card_is_noticed(stored):
    path = stored / CARD
    path.write_text(path.read_text().replace('"falls": 1', '"falls": 0'))
    with pytest.raises(DataError, match="seal"):
        open_dataset(stored)


def test_other_schema_is_refused(stored):
    reseal(stored, lambda card: card["schema"].update(digest="0" * 64))
    with pytest.raises(SchemaError, match="another state schema"):
        open_dataset(stored)


def test_other_format_is_refused(stored):
    reseal(stored, lambda card: card.update(format=99))
    with pytest.raises(DataError, match="format 99"):
        open_dataset(stored)


def test_missing_field_in_card_is_refused(stored):
    reseal(stored, lambda card: card["fields"].pop("foot_force"))
    with pytest.raises(SchemaError, match="foot_force"):
        open_dataset(stored)


def test_file_of_another_type_is_refused(stored):
    np.save(stored / "actions.npy", np.zeros((42, 10)))
    digest = sha256_file(stored / "actions.npy")
    reseal(stored, lambda card: card["fields"]["actions"].update(sha256=digest))
    with pytest.raises(SchemaError, match="actions.npy holds <f8"):
        open_dataset(stored)


def test_pickles_are_never_read(stored):
    np.save(stored / "phase.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    digest = sha256_file(stored / "phase.npy")
    reseal(stored, lambda card: card["fields"]["phase"].update(sha256=digest))
    with pytest.raises(DataError, match="phase.npy cannot be read"):
        open_dataset(stored)


def test_files_of_two_recordings_do_not_mix(stored):
    np.save(stored / "foot_height.npy", np.zeros((41, 2), dtype="<f4"))
    digest = sha256_file(stored / "foot_height.npy")
    reseal(stored, lambda card: card["fields"]["foot_height"].update(sha256=digest))
    with pytest.raises(ValueError, match="foot_height has shape"):
        open_dataset(stored)
