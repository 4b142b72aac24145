"""Checkpoints from which a killed training goes on as if it had not been killed."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from cassie_lib import checkpoints
from cassie_lib.errors import CheckpointError
from cassie_lib.files import canonical_json


def tensor_digest(tensors: dict[str, Tensor], extra: str = "") -> str:
    """SHA-256 of named tensors (names, types, shapes, bytes) and of a text."""
    digest = hashlib.sha256(extra.encode())
    for name in sorted(tensors):
        value = tensors[name].detach().cpu().contiguous()
        digest.update(f"{name}:{value.dtype}:{tuple(value.shape)}".encode())
        digest.update(value.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def save_training(
    path: Path,
    model: nn.Module,
    optimiser: torch.optim.Optimizer,
    counters: dict[str, Any],
    identity: dict[str, Any],
) -> None:
    """Save weights, optimiser, random state and counters in one atomic file.

    Args:
        path: File to write.
        model: Weights and buffers are saved.
        optimiser: Its state and learning rates are saved.
        counters: JSON-serialisable state of the loop: step, scheduler, guard, log rows.
        identity: What a resume must agree with: kind, parameters, normalisation, data.
    """
    tensors = {f"model.{name}": value for name, value in model.state_dict().items()}
    state = optimiser.state_dict()
    for index, values in state["state"].items():
        for name, value in values.items():
            tensors[f"optimiser.{index}.{name}"] = torch.as_tensor(value)
    tensors["random.cpu"] = torch.get_rng_state()
    if torch.cuda.is_available():
        tensors["random.cuda"] = torch.cuda.get_rng_state()
    text = json.dumps({"counters": counters, "groups": state["param_groups"]})
    content = {"tensors": tensors, "text": text, "digest": tensor_digest(tensors, text)}
    path.parent.mkdir(parents=True, exist_ok=True)
    checkpoints.save_checkpoint(path, content, canonical_json(identity))


def load_training(
    path: Path, model: nn.Module, optimiser: torch.optim.Optimizer, identity: dict[str, Any]
) -> dict[str, Any] | None:
    """Restore model, optimiser and random state in place.

    Args:
        path: File of :func:`save_training`.
        model: Same architecture as was saved.
        optimiser: Optimiser of ``model``.
        identity: Must equal the one saved.

    Returns:
        The counters, or None when there is no checkpoint yet.

    Raises:
        CheckpointError: If the file is damaged or belongs to another run or architecture.
    """
    content = checkpoints.load_checkpoint(path, canonical_json(identity))
    if content is None:
        return None
    tensors, text = content.get("tensors", {}), content.get("text", "")
    if content.get("digest") != tensor_digest(tensors, text):
        raise CheckpointError(f"{path.name} does not match its SHA-256: it was cut or edited")
    weights = {n.split(".", 1)[1]: v for n, v in tensors.items() if n.startswith("model.")}
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        raise CheckpointError(f"{path.name} belongs to another architecture") from error
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        if name.startswith("optimiser."):
            _, index, key = name.split(".", 2)
            state.setdefault(int(index), {})[key] = value
    saved = json.loads(text)
    optimiser.load_state_dict({"state": state, "param_groups": saved["groups"]})
    torch.set_rng_state(tensors["random.cpu"])
    if "random.cuda" in tensors and torch.cuda.is_available():
        torch.cuda.set_rng_state(tensors["random.cuda"])
    return saved["counters"]


__all__ = ["load_training", "save_training", "tensor_digest"]
