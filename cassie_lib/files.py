"""Small file helpers: nothing is ever left half-written, everything can be hashed."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile

import numpy as np
from filelock import FileLock, Timeout

from cassie_lib.errors import ParameterError

#: What reading a damaged JSON, ``.npy`` or ``.npz`` file may raise, found by flipping bits.
UNREADABLE = (
    OSError, ValueError, KeyError, TypeError, EOFError, RuntimeError, MemoryError, OverflowError,
    BadZipFile, zlib.error, TokenError,
)  # fmt: skip


def plain(value: Any, name: str = "parameters") -> Any:
    """Turn dataclasses, mappings, sequences and NumPy scalars into what JSON can hold.

    Args:
        value: The value.
        name: How an error names it.

    Raises:
        ParameterError: If a part is not finite or is of a kind without a canonical form.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name), f"{name}.{f.name}") for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item, f"{name}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, f"{name}[{index}]") for index, item in enumerate(value)]
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), name)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        raise ParameterError(f"{name} is {value}: expected a finite number")
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    kind = type(value).__name__
    raise ParameterError(f"{name} is a {kind}: expected numbers, text, sequences or dataclasses")


def canonical_json(value: Any) -> str:
    """The one JSON text of a value: sorted keys, no spaces.

    Raises:
        ParameterError: See :func:`plain`.
    """
    return json.dumps(plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False)


def sha256_text(text: str) -> str:
    """SHA-256 of a text, 64 hexadecimal digits."""
    return hashlib.sha256(text.encode()).hexdigest()


def sha256_file(path: Path) -> str:
    """SHA-256 of a file, 64 hexadecimal digits."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path that replaces ``path`` at the end, and vanishes after an error."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # The suffix stays last: savefig and numpy read the format from it.
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        with suppress(OSError), open(temporary, "rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text file in one step (UTF-8, ``\\n`` line ends)."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file in one step, indented for reading, keys in the given order."""
    write_text(path, json.dumps(plain(value, path.name), indent=1, ensure_ascii=False) + "\n")


#: A wait that is over in a moment is not worth a line.
_PATIENCE_S = 1.0


@contextmanager
def locked(path: Path, reason: str) -> Iterator[None]:
    """Hold an inter-process lock; a killed process gives its lock back.

    Args:
        path: The lock file; it stays, empty, for the next one.
        reason: What is waited for, printed once when another process holds the lock for long.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = FileLock(path)
    try:
        lock.acquire(timeout=_PATIENCE_S)
    except Timeout:
        print(f"waiting for another process: {reason}", file=sys.stderr, flush=True)
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
