"""Atomic checkpoints that refuse to be resumed by another run."""

from __future__ import annotations

import os
from pathlib import Path

import torch

from cassie_lib.errors import CheckpointError


def save_checkpoint(path: Path, content: dict, identity: str) -> None:
    """Write a checkpoint so that a kill at any moment leaves the old or the new one whole.

    Args:
        path: File to write.
        content: Nested dictionaries and lists of tensors, numbers and strings.
        identity: Whatever must agree for a resume to make sense (parameters, seed, schema).
    """
    temporary = path.with_suffix(path.suffix + ".tmp")
    with open(temporary, "wb") as file:
        torch.save({"identity": identity, "content": content}, file)
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
        stored = torch.load(path, map_location="cpu", weights_only=True)
        found, content = stored["identity"], stored["content"]
    except Exception as error:
        raise CheckpointError(
            f"{path} cannot be read ({type(error).__name__}): expected a whole checkpoint; "
            "remove it to start over"
        ) from error
    if found != identity:
        raise CheckpointError(f"{path} belongs to run {found!r}: expected {identity!r}")
    return content
