"""Models on disk: weights as safetensors, everything else in a readable JSON card beside them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any, cast

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.dynamics.checkpoint import tensor_digest
from cassie_lib.dynamics.mlp import MLPModel
from cassie_lib.dynamics.model import DynamicsModel
from cassie_lib.dynamics.transformer import TransformerModel
from cassie_lib.errors import (
    ArtifactError,
    CheckpointError,
    NonFiniteError,
    SchemaError,
    unknown_name,
)
from cassie_lib.files import UNREADABLE, replacing, write_json
from cassie_lib.presets import CausalParameters, MLPParameters, TransformerParameters
from cassie_lib.robot import schema

WEIGHTS = "model.safetensors"
CARD = "card.json"
KINDS: dict[str, tuple[type[nn.Module], type]] = {
    "mlp": (MLPModel, MLPParameters),
    "transformer": (TransformerModel, TransformerParameters),
    "causal": (CausalModel, CausalParameters),
}


def schema_digest() -> str:
    """SHA-256 of names, units and derivative orders of the 49 components, in their order."""
    rows = [(c.index, c.name, c.unit, c.order) for c in schema.COMPONENTS]
    text = json.dumps([rows, schema.PERIOD, schema.CLOCK_DIVISOR, schema.MOTOR_NAMES])
    return hashlib.sha256(text.encode()).hexdigest()


def save_model(folder: Path, model: nn.Module, notes: dict[str, Any] | None = None) -> dict:
    """Write ``model.safetensors`` and ``card.json`` into a folder, each atomically.

    Args:
        folder: Made if it does not exist.
        model: A model of this package.
        notes: More entries for the card (data, minutes, measured errors).

    Returns:
        The card.
    """
    tensors = model.state_dict()
    card = {
        "kind": model.kind,
        "parameters": dataclasses.asdict(model.parameters_),
        "parameter_count": sum(p.numel() for p in model.parameters()),
        "schema": schema_digest(),
        "normalisation": model.normalisation.digest(),
        "weights": tensor_digest(tensors),
        "notes": notes or {},
    }
    owned = {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}
    with replacing(folder / WEIGHTS) as partial:
        save_file(owned, str(partial), metadata={"kind": model.kind})
    write_json(folder / CARD, card)
    return card


def read_card(folder: Path) -> dict[str, Any]:
    """Card of a stored model.

    Raises:
        ArtifactError: If the folder or the card is missing or not JSON.
    """
    try:
        card = json.loads((folder / CARD).read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ArtifactError(f"{folder.name}/{CARD} is missing: expected a stored model") from error
    except UNREADABLE as error:
        raise ArtifactError(f"{folder.name}/{CARD} is not JSON: {error}") from error
    if not isinstance(card, dict):
        raise ArtifactError(f"{folder.name}/{CARD} is a {type(card).__name__}: expected a card")
    missing = {"kind", "parameters", "schema", "normalisation", "weights"} - set(card)
    if missing:
        raise ArtifactError(f"{folder.name}/{CARD} lacks {', '.join(sorted(missing))}")
    return card


def load_model(folder: Path, kind: str | None = None) -> DynamicsModel:
    """Load a stored model, in evaluation mode and with frozen weights.

    Args:
        folder: Folder of :func:`save_model`.
        kind: ``"mlp"``, ``"transformer"`` or ``"causal"`` if only that will do.

    Raises:
        ArtifactError: If a file is missing.
        CheckpointError: If the weights are damaged or of another architecture than the card says.
        SchemaError: If they were made for another state schema or normalisation.
        NonFiniteError: If a weight is NaN or infinite.
        UnknownNameError: If the card names an unknown kind.
    """
    card = read_card(folder)
    if card["kind"] not in list(KINDS):
        raise unknown_name(f"model kind in {folder.name}/{CARD}", card["kind"], KINDS)
    if kind is not None and card["kind"] != kind:
        raise CheckpointError(f"{folder.name} holds a {card['kind']} model: expected {kind}")
    if card["schema"] != schema_digest():
        raise SchemaError(f"{folder.name} was made for another state schema than robot/schema.py")
    model = _build(folder, card)
    tensors = _read_weights(folder / WEIGHTS)
    if _architecture(tensors) != _architecture(model.state_dict()):
        raise CheckpointError(f"{folder.name}/{WEIGHTS} has another architecture than its card")
    if tensor_digest(tensors) != card["weights"]:
        raise CheckpointError(f"{folder.name}/{WEIGHTS} does not match the SHA-256 of its card")
    model.load_state_dict(tensors)
    if model.normalisation.digest() != card["normalisation"]:
        raise SchemaError(f"{folder.name} has another normalisation than its card says")
    for name, value in tensors.items():
        if not bool(torch.isfinite(value).all()):
            raise NonFiniteError(
                f"{folder.name}/{WEIGHTS} holds NaN or infinity in {name}: expected finite weights"
            )
    return model.eval().requires_grad_(False)


def _architecture(tensors: dict[str, Tensor]) -> dict[str, tuple]:
    return {name: (value.dtype, tuple(value.shape)) for name, value in tensors.items()}


def _read_weights(path: Path) -> dict[str, Tensor]:
    if not path.exists():
        raise ArtifactError(f"{path.parent.name}/{path.name} is missing: expected a stored model")
    try:
        return load_file(str(path))
    except (SafetensorError, OSError, ValueError, RuntimeError) as error:
        detail = str(error).splitlines()[0]
        raise CheckpointError(f"{path.name} is damaged or half-written: {detail}") from error


def load_causal(folder: Path) -> CausalModel:
    """Load a stored causal model; raises as :func:`load_model`, which refuses any other kind."""
    return cast(CausalModel, load_model(folder, "causal"))


def _build(folder: Path, card: dict[str, Any]) -> nn.Module:
    constructor, parameters = KINDS[card["kind"]]
    try:
        values = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in card["parameters"].items()
        }
        return constructor(parameters(**values))
    except (TypeError, ValueError, AttributeError, RuntimeError, AssertionError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise CheckpointError(f"{folder.name}/{CARD} has unknown parameters: {reason}") from error


__all__ = ["load_causal", "load_model", "read_card", "save_model", "schema_digest"]
