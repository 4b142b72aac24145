"""Mean and spread of the data, kept as buffers so that they travel with the weights."""

from __future__ import annotations

import hashlib

import numpy as np
import torch
from torch import Tensor, nn

from cassie_lib.dynamics.windows import Transitions
from cassie_lib.errors import NonFiniteError, ShapeError
from cassie_lib.robot import schema

#: Under this spread a component counts as constant and is only centred.
FLOOR = 1e-6
_SIZES = {
    "state": schema.STATE_SIZE,
    "difference": schema.STATE_SIZE,
    "action": schema.ACTION_SIZE,
}


class Normalisation(nn.Module):
    """Statistics of states ``(49,)``, one-step differences ``(49,)`` and actions ``(10,)``.

    Buffers ``{state,difference,action}_{mean,std}``, in physical units.
    """

    def __init__(self) -> None:
        super().__init__()
        for name, size in _SIZES.items():
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_std", torch.ones(size))

    @classmethod
    def from_transitions(cls, transitions: Transitions, floor: float = FLOOR) -> Normalisation:
        """Measure the statistics; differences across an episode end do not count."""
        result = cls()
        inside = np.ones(len(transitions) - 1, dtype=bool)
        inside[transitions.episode_starts[1:] - 1] = False
        states = np.asarray(transitions.states, dtype=np.float64)
        samples = {
            "state": states,
            "difference": np.diff(states, axis=0)[inside],
            "action": np.asarray(transitions.actions, dtype=np.float64),
        }
        for name, values in samples.items():
            std = values.std(axis=0)
            result.set(name, values.mean(axis=0), np.where(std < floor, 1.0, std))
        return result

    def set(self, name: str, mean: np.ndarray, std: np.ndarray) -> None:
        """Replace the statistics of ``"state"``, ``"difference"`` or ``"action"``.

        Raises:
            ShapeError: If a length differs.
            NonFiniteError: If a value is not finite or a spread is not positive.
        """
        for kind, value in (("mean", mean), ("std", std)):
            value = np.asarray(value)
            if value.shape != (_SIZES[name],):
                raise ShapeError(f"{name} {kind} has shape {value.shape}: expected {_SIZES[name]}")
            if not np.isfinite(value).all() or (kind == "std" and (value <= 0).any()):
                raise NonFiniteError(f"{name} {kind} must be finite, and positive if a spread")
            getattr(self, f"{name}_{kind}").copy_(torch.as_tensor(value))

    def states(self, states: Tensor) -> Tensor:
        """States ``(..., 49)`` in units of their spread."""
        return (states - self.state_mean) / self.state_std

    def actions(self, actions: Tensor) -> Tensor:
        """Actions ``(..., 10)`` in units of their spread."""
        return (actions - self.action_mean) / self.action_std

    def differences(self, differences: Tensor) -> Tensor:
        """One-step differences ``(..., 49)`` in units of their spread."""
        return (differences - self.difference_mean) / self.difference_std

    def to_differences(self, outputs: Tensor) -> Tensor:
        """Physical differences of normalised outputs ``(..., K)``, the first K components."""
        size = outputs.shape[-1]
        return outputs * self.difference_std[:size] + self.difference_mean[:size]

    def digest(self) -> str:
        """SHA-256 of all six statistics; equal digests mean exchangeable weights."""
        digest = hashlib.sha256()
        for name in sorted(dict(self.named_buffers())):
            values = getattr(self, name).detach().cpu().to(torch.float32)
            digest.update(name.encode())
            digest.update(values.numpy().tobytes())
        return digest.hexdigest()


__all__ = ["FLOOR", "Normalisation"]
