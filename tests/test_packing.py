"""Packed arrays come back within their stated error, whatever is in them."""

from __future__ import annotations

import io
import zlib

import numpy as np
import pytest

from cassie_lib.packing import RELATIVE_ERROR, pack, packed, unpack, unpacked


def back(values):
    return unpack(pack(values), values.shape)


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (2, 7, 4), (2, 6, 2, 3)])
@pytest.mark.parametrize("scale", [1e-20, 1e-3, 1.0, 1e6])
def test_relative_error(shape, scale):
    values = (scale * np.random.default_rng(0).normal(size=shape)).astype(np.float32)
    found = back(values)
    assert found.dtype == np.float32
    assert (np.abs(found - values) <= RELATIVE_ERROR * np.abs(values)).all()


def test_numbers_of_few_digits_come_back_exactly():
    values = np.array([[0.0, 1.0, -1.0, 0.5, -1024.0, 3.0, 65535.0, -0.0]], dtype=np.float32)
    assert (back(values) == values).all()
    assert np.signbit(back(values)[0, -1])


def test_rounding_up_over_a_power_of_two():
    values = np.nextafter(np.float32([[2.0, -2.0]]), np.float32(0.0))
    assert (back(values) == [[2.0, -2.0]]).all()


def test_what_is_not_finite_stays_so():
    values = np.array([[np.inf, -np.inf, np.nan, 1.0]], dtype=np.float32)
    assert back(values)[0, :2].tolist() == [np.inf, -np.inf]
    assert np.isnan(back(values)[0, 2])
    assert back(values)[0, 3] == 1.0


def test_packing_twice_changes_nothing_more():
    values = np.random.default_rng(1).normal(size=(2, 9, 3)).astype(np.float32)
    assert (back(back(values)) == back(values)).all()


def test_a_smooth_motion_takes_half_the_bytes_of_its_floats():
    time = np.linspace(0.0, 20.0, 2000)
    values = np.sin(time[None, :, None] * np.arange(1, 6)).astype(np.float32)
    plain = io.BytesIO()
    np.savez_compressed(plain, values=values)
    assert len(zlib.compress(pack(values).tobytes())) < 0.6 * len(plain.getvalue())


def test_bytes_of_another_shape_are_refused():
    with pytest.raises(ValueError, match="reshape"):
        unpack(pack(np.zeros((2, 3, 4), dtype=np.float32)), (2, 3, 5))


def test_only_floats_over_time_are_packed_and_all_come_back_by_name(tmp_path):
    random = np.random.default_rng(2)
    arrays = {
        "motion": random.normal(size=(2, 5, 3)), "length": np.array([5, 4]),
        "weights": random.normal(size=4), "phase": np.zeros((2, 5), int),
    }  # fmt: skip
    np.savez_compressed(tmp_path / "a.npz", **packed(arrays))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as stored:
        assert set(arrays) - set(stored.files) == {"motion"}
        found = unpacked(stored)
    assert set(found) == set(arrays)
    for name in ("length", "weights", "phase"):
        np.testing.assert_array_equal(found[name], arrays[name])
    np.testing.assert_allclose(found["motion"], arrays["motion"], rtol=1.01 * RELATIVE_ERROR)


def test_a_packed_array_without_its_shape_is_refused():
    stored = packed({"motion": np.zeros((2, 5, 3))})
    del stored["shape_motion"]
    with pytest.raises(KeyError, match="shape_motion"):
        unpacked(stored)
