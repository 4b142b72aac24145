"""The expert pi*: an LSTM actor and an LSTM critic with the input normalisation inside."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from cassie_lib.errors import CheckpointError, ShapeError
from cassie_lib.robot.schema import ACTION_SIZE, STATE_SIZE

#: Normalised inputs beyond this many standard deviations are clipped.
_INPUT_LIMIT = 10.0
WEIGHTS_FILE = "expert.safetensors"
CARD_FILE = "card.json"


class RecurrentNetwork(nn.Module):
    """Stacked LSTM cells and a linear head; the memory is cleared where an episode starts."""

    def __init__(self, inputs: int, hidden: int, layers: int, outputs: int, gain: float) -> None:
        """Build the network.

        Args:
            inputs: Size of the input.
            hidden: Size of each layer's memory.
            layers: Number of LSTM layers.
            outputs: Size of the output.
            gain: Scale of the head's initial weights; small ones start near zero output.
        """
        super().__init__()
        self.hidden = hidden
        self.cells = nn.ModuleList(
            nn.LSTMCell(inputs if index == 0 else hidden, hidden) for index in range(layers)
        )
        self.head = nn.Linear(hidden, outputs)
        nn.init.orthogonal_(self.head.weight, gain)
        nn.init.zeros_(self.head.bias)

    def initial_memory(self, batch: int) -> Tensor:
        """Cleared memory ``(layers, 2, B, hidden)``: hidden and cell state of each layer."""
        return torch.zeros(len(self.cells), 2, batch, self.hidden)

    def forward(self, inputs: Tensor, memory: Tensor, starts: Tensor) -> tuple[Tensor, Tensor]:
        """Run a sequence.

        Args:
            inputs: ``(T, B, inputs)``.
            memory: ``(layers, 2, B, hidden)`` before the first step.
            starts: ``(T, B)``, 1 where an episode starts: there the memory is cleared first.

        Returns:
            Outputs ``(T, B, outputs)`` and the memory after the last step.
        """
        keep = (1.0 - starts).unsqueeze(-1)
        sequence, final = inputs.unbind(0), []
        for index, cell in enumerate(self.cells):
            hidden, carry = memory[index, 0], memory[index, 1]
            outputs = []
            for step, value in enumerate(sequence):
                hidden, carry = cell(value, (hidden * keep[step], carry * keep[step]))
                outputs.append(hidden)
            sequence = outputs
            final.append(torch.stack((hidden, carry)))
        return self.head(torch.stack(tuple(sequence))), torch.stack(final)


class ExpertPolicy(nn.Module):
    """Actor and critic of recurrent PPO (thesis section 4.3.1).

    The actor gives the mean of a Gaussian over PD-target offsets in rad with a standard
    deviation that the training sets; both read the 49-component state of Table 4.1, normalised by
    stored statistics.
    """

    def __init__(self, hidden_size: int = 128, layers: int = 2) -> None:
        """Build both networks with unit input statistics."""
        super().__init__()
        self.architecture = {"hidden_size": hidden_size, "layers": layers}
        self.actor = RecurrentNetwork(STATE_SIZE, hidden_size, layers, ACTION_SIZE, gain=0.01)
        self.critic = RecurrentNetwork(STATE_SIZE, hidden_size, layers, 1, gain=1.0)
        self.register_buffer("input_mean", torch.zeros(STATE_SIZE))
        self.register_buffer("input_std", torch.ones(STATE_SIZE))

    def normalise(self, states: Tensor) -> Tensor:
        """Centre and scale states ``(..., 49)``; outliers are clipped."""
        scaled = (states - self.input_mean) / self.input_std
        return scaled.clamp(-_INPUT_LIMIT, _INPUT_LIMIT)

    def initial_memory(self, batch: int) -> tuple[Tensor, Tensor]:
        """Cleared memories of actor and critic for ``batch`` robots."""
        return self.actor.initial_memory(batch), self.critic.initial_memory(batch)


class Expert:
    """The trained policy as a controller: mean actions, one memory per robot."""

    def __init__(self, policy: ExpertPolicy) -> None:
        """Wrap a policy; its weights are not copied."""
        self.policy = policy.eval()
        self.reset(1)

    def reset(self, count: int, seed: int = 0) -> None:
        """Clear the memories of ``count`` robots; the mean action uses no randomness."""
        del seed
        self._memory = self.policy.actor.initial_memory(count)

    @torch.inference_mode()
    def act(self, observation) -> np.ndarray:
        """Mean actions ``(N, 10)`` rad for an observation with ``states (N, 49)``.

        Raises:
            ShapeError: If the number of robots differs from that of the last :meth:`reset`.
        """
        states = torch.as_tensor(np.asarray(observation.states), dtype=torch.float32)
        if len(states) != self._memory.shape[2]:
            raise ShapeError(
                f"states of {len(states)} robots: expected {self._memory.shape[2]}, as at reset"
            )
        inputs = self.policy.normalise(states).unsqueeze(0)
        starts = torch.zeros(1, len(states))
        actions, self._memory = self.policy.actor(inputs, self._memory, starts)
        return actions[0].double().numpy()


def save_expert(policy: ExpertPolicy, folder: Path, card: dict) -> None:
    """Write weights and model card into a folder.

    Args:
        policy: The policy to store.
        folder: Existing folder.
        card: JSON-serialisable facts: parameters, seed, wall time, protocol.
    """
    save_file(
        {name: value.contiguous() for name, value in policy.state_dict().items()},
        folder / WEIGHTS_FILE,
    )
    text = json.dumps({**card, "architecture": policy.architecture}, indent=2, sort_keys=True)
    (folder / CARD_FILE).write_text(text + "\n")


def load_expert(folder: Path) -> Expert:
    """Read a policy that :func:`save_expert` wrote; no pickle is involved.

    Raises:
        CheckpointError: If a file is missing or damaged, or the weights do not fit the card.
    """
    try:
        architecture = json.loads((folder / CARD_FILE).read_text())["architecture"]
        weights = load_file(folder / WEIGHTS_FILE)
        policy = ExpertPolicy(**architecture)
        policy.load_state_dict(weights)
        bad = [name for name, value in weights.items() if not bool(value.isfinite().all())]
        if bad:
            raise ValueError(f"{bad[0]} is not finite")
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, SafetensorError) as error:
        reason = str(error).splitlines()[0][:120]
        raise CheckpointError(
            f"{folder} holds no usable expert ({reason}): expected {WEIGHTS_FILE} and {CARD_FILE} "
            "of one architecture"
        ) from error
    return Expert(policy)
