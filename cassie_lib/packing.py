"""Arrays over time in few bytes: rounded to 16 binary digits, then stored as changes.

Long episodes are kept in git, and so are the transitions of DAgger's rounds.  Their
single-precision numbers hold seven more binary digits than anything that is drawn, reported or
learned from them, and those are noise that no compression removes.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

#: Begin the names of packed arrays and of their shapes in a file.
_PACKED, _SHAPE = "packed_", "shape_"
#: Binary digits of the mantissa that are dropped; 16 remain: a relative error of 2**-17.
_DROPPED = 7
RELATIVE_ERROR = 2.0**-17


def pack(values: np.ndarray) -> np.ndarray:
    """Bytes of an array over time, for a compressed file.

    Args:
        values: ``(N, T, ...)`` float32; time is the second axis.

    Returns:
        ``(4, N, C, T)`` uint8: byte planes of the changes from step to step, component by
        component.
    """
    bits = np.ascontiguousarray(values, dtype=np.float32).view(np.uint32).astype(np.int64)
    # Rounded, not cut: the carry into the exponent is right, it is the next power of two.
    whole = ((bits + (1 << (_DROPPED - 1))) >> _DROPPED).reshape(*values.shape[:2], -1)
    change = np.diff(whole, axis=1, prepend=0).transpose(0, 2, 1)
    # Small changes of either sign become small positive numbers, whose high bytes are zero.
    folded = np.where(change < 0, -2 * change - 1, 2 * change).astype("<u4")
    return np.moveaxis(np.ascontiguousarray(folded).view(np.uint8).reshape(*folded.shape, 4), -1, 0)


def unpack(planes: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The inverse of :func:`pack` within :data:`RELATIVE_ERROR`.

    Args:
        planes: ``(4, N, C, T)`` uint8.
        shape: Of the array.

    Raises:
        ValueError: If the bytes do not fit the shape.
    """
    bytes_ = np.ascontiguousarray(np.moveaxis(planes, 0, -1), dtype=np.uint8)
    folded = bytes_.view("<u4")[..., 0].astype(np.int64)
    change = np.where(folded % 2, -(folded + 1) // 2, folded // 2)
    whole = np.cumsum(change, axis=-1).transpose(0, 2, 1)
    bits = (whole << _DROPPED).astype(np.uint32)
    return np.ascontiguousarray(bits).view(np.float32).reshape(shape)


def packed(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays for a compressed file: floats of two or more dimensions packed, others as they are.

    Args:
        arrays: By name; the second dimension of those that are packed is time.
    """
    stored: dict[str, np.ndarray] = {}
    for name, value in arrays.items():
        if value.dtype.kind == "f" and value.ndim >= 2:
            stored[_PACKED + name], stored[_SHAPE + name] = pack(value), np.array(value.shape)
        else:
            stored[name] = value
    return stored


def unpacked(stored: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The inverse of :func:`packed`; arrays that were stored as they are stay so.

    Raises:
        ValueError: If packed bytes do not fit their shape.
        KeyError: If a shape is missing.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, value in stored.items():
        if name.startswith(_PACKED):
            own = name.removeprefix(_PACKED)
            arrays[own] = unpack(value, tuple(stored[_SHAPE + own]))
        elif not name.startswith(_SHAPE):
            arrays[name] = value
    return arrays


__all__ = ["RELATIVE_ERROR", "pack", "packed", "unpack", "unpacked"]
