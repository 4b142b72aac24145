"""Small synthetic recordings and models for the tests of the dynamics models."""

from __future__ import annotations

import numpy as np
import torch

from cassie_lib.dynamics.model import History
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.presets import CausalParameters, MLPParameters, TransformerParameters
from cassie_lib.robot import schema

CAUSAL = CausalParameters(
    context=6, model_size=16, heads=2, layers=2, feedforward_size=32, horizon=4, steps=16,
    average_share=0.6, batch_size=8, mirror=False, validation_steps=5, validation_windows=8,
    max_minutes=0.0, checkpoint_seconds=0.0,
)
TRANSFORMER = TransformerParameters(
    context=5, representation_size=12, embedding_size=6, model_size=8, heads=2, encoder_layers=2,
    decoder_layers=2, feedforward_size=16, horizon=3, epochs=4, windows_per_epoch=24,
    batch_size=8, scheduler_patience=1, patience=1,
)
MLP = MLPParameters(
    context=4, hidden_size=24, epochs=3, curriculum_epochs=3, horizon=3, patience=1, batch_size=8
)


def oscillators(episodes=4, length=40, seed=0) -> Transitions:
    """Damped oscillators driven by the actions, in the 46 physical components of a state."""
    random = np.random.default_rng(seed)
    rate = np.linspace(0.1, 0.6, schema.PHYSICAL.stop // 2)
    mix = np.random.default_rng(99).normal(size=(schema.ACTION_SIZE, len(rate))) * 0.3
    actions = random.normal(size=(episodes * length, schema.ACTION_SIZE)) * 0.2
    states = np.zeros((episodes * length, schema.STATE_SIZE))
    phase = np.zeros(episodes * length, dtype=np.int64)
    starts = np.arange(episodes) * length
    for start in starts:
        x, v = random.normal(size=(2, len(rate)))
        phases = (random.integers(schema.PERIOD) + np.arange(length)) % schema.PERIOD
        phase[start : start + length] = phases
        for t in range(start, start + length):
            states[t, 0:46:2], states[t, 1:46:2] = x, v
            v = 0.95 * v - rate * x + actions[t] @ mix
            x = x + 0.3 * v
    quaternion = np.array([1.0, 0, 0, 0]) + 0.1 * states[:, schema.PELVIS_ORIENTATION]
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    states[:, schema.PELVIS_ORIENTATION] = quaternion
    states[:, schema.CLOCK] = schema.clock(phase)
    states[:, schema.SPEED] = 0.0509
    return Transitions(states.astype(np.float32), actions.astype(np.float32), phase, starts)


def make_history(episodes=2, length=6, seed=0, dtype=torch.float32) -> History:
    """History of random oscillator states."""
    window = oscillators(seed=seed).gather(np.arange(episodes) * 3, length)
    return History(
        window.states.to(dtype), window.actions[:, :-1].to(dtype), None, window.phase[:, -1]
    )


def make_actions(episodes=2, candidates=3, steps=4, seed=0, dtype=torch.float32) -> torch.Tensor:
    """Random candidate actions ``(E, N, T, 10)``."""
    generator = torch.Generator().manual_seed(seed)
    shape = (episodes, candidates, steps, schema.ACTION_SIZE)
    return 0.2 * torch.randn(shape, generator=generator, dtype=dtype)


def randomise(model: torch.nn.Module, seed=0, scale=0.2) -> torch.nn.Module:
    """Give every weight a value, also those that start at zero."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(scale * torch.randn(parameter.shape, generator=generator))
    return model
