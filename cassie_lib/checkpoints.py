"""Atomic checkpoints that refuse to be resumed by another run."""

from __future__ import annotations

import hashlib
import io
import os
from pathlib import Path

import torch

from cassie_lib.errors import CheckpointError

#: First bytes of a checkpoint; the SHA-256 of what follows comes next.  PyTorch itself does not
#: notice a flipped bit in a tensor.
_HEAD = b"cassie checkpoint 1 "
_DIGEST_SIZE = 32


def save_checkpoint(path: Path, content: dict, identity: str) -> None:
    """Write a checkpoint so that a kill at any moment leaves the old or the new one whole.

    Args:
        path: File to write.
        content: Nested dictionaries and lists of tensors, numbers and strings.
        identity: Whatever must agree for a resume to make sense (parameters, seed, schema).
    """
    buffer = io.BytesIO()
    torch.save({"identity": identity, "content": content}, buffer)
    temporary = path.with_suffix(path.suffix + ".tmp")
    with open(temporary, "wb") as file:
        file.write(_HEAD + hashlib.sha256(buffer.getbuffer()).digest())
        file.write(buffer.getbuffer())
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def load_checkpoint(path: Path, identity: str) -> dict | None:
    """Read a checkpoint of the same run.

    Args:
        path: File to read.
        identity: The identity that it must have been saved with.

    Returns:
        The content, or None when there is no checkpoint yet.

    Raises:
        CheckpointError: If the file is damaged or belongs to another run.
    """
    if not path.exists():
        return None
    try:
        stored = torch.load(_whole(path.read_bytes()), map_location="cpu", weights_only=True)
        found, content = stored["identity"], stored["content"]
    except Exception as error:
        raise CheckpointError(
            f"{path} cannot be read ({type(error).__name__}): expected a whole checkpoint; "
            "remove it to start over"
        ) from error
    if found != identity:
        raise CheckpointError(f"{path} belongs to run {found!r}: expected {identity!r}")
    return content


def _whole(data: bytes) -> io.BytesIO:
    """The part that PyTorch reads, after checking it against its digest."""
    start = len(_HEAD) + _DIGEST_SIZE
    if not data.startswith(_HEAD):
        raise ValueError("no checkpoint")
    if hashlib.sha256(data[start:]).digest() != data[len(_HEAD) : start]:
        raise ValueError("another SHA-256 than when it was written")
    return io.BytesIO(data[start:])
