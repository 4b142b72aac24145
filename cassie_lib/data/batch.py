"""One batch of episodes, recorded while it runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import torch

from cassie_lib.controllers import Controller, Observation
from cassie_lib.data.episodes import FALL, TIME
from cassie_lib.data.fields import SAMPLE_FIELDS, SAMPLE_NAMES
from cassie_lib.robot.schema import PERIOD
from cassie_lib.simulator import Simulator


@contextmanager
def _torch_threads(count: int) -> Iterator[None]:
    """Sums in a policy may come out otherwise with another number of threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def run_batch(
    controller: Controller, simulator: Simulator, steps: int, level: float,
    random: np.random.Generator, torch_threads: int = 1,
) -> dict[str, np.ndarray]:
    """Run one episode per robot from where the simulator stands.

    Args:
        controller: What acts; it is reset first.
        simulator: N robots, reset to s0.
        steps: Longest episode in control steps.
        level: Standard deviation of the action noise, rad.
        random: Source of the noise.
        torch_threads: Threads of PyTorch while the controller acts.

    Returns:
        The fields of :mod:`cassie_lib.data.fields`, episodes laid end to end.
    """
    controller.reset(simulator.count, int(random.integers(2**31)))
    rows: dict[str, list[np.ndarray]] = {name: [] for name in SAMPLE_NAMES if name != "falling"}
    length = np.full(simulator.count, steps)
    final = simulator.states.astype(np.float32)
    with _torch_threads(torch_threads):
        for step in range(steps):
            before = simulator.fallen.copy()
            sample = _observe(simulator)
            observation = Observation(
                simulator.states, simulator.physics.copy(), simulator.phase.copy(),
                simulator.pelvis_position, step,
            )  # fmt: skip
            wanted = np.asarray(controller.act(observation), dtype=np.float64)
            noisy = wanted + level * random.standard_normal(wanted.shape)
            # Rounded before it is executed: the recorded action is the executed one to the bit.
            executed = noisy.astype(np.float32)
            for name, value in {**sample, "mean_actions": wanted, "actions": executed}.items():
                rows[name].append(value)
            simulator.step(executed.astype(np.float64))
            after = simulator.states
            final[~before] = after[~before]
            length[simulator.fallen & ~before] = step + 1
            if simulator.fallen.all():
                break
    return _end_to_end(rows, length, simulator.fallen, final, level)


def _observe(simulator: Simulator) -> dict[str, np.ndarray]:
    return {
        "states": simulator.states,
        "phase": simulator.phase.copy(),
        "pelvis_position": simulator.pelvis_position,
        "foot_position": simulator.foot_position,
        "foot_height": simulator.foot_height,
        "foot_force": simulator.foot_force,
    }


def _end_to_end(
    rows: Mapping[str, list[np.ndarray]], length: np.ndarray, fallen: np.ndarray,
    final: np.ndarray, level: float,
) -> dict[str, np.ndarray]:
    steps = np.arange(int(length.max()))
    inside = steps[None, :] < length[:, None]
    falling = inside & fallen[:, None] & (steps[None, :] >= length[:, None] - PERIOD)
    batch = {
        item.name: np.stack(rows[item.name], axis=1)[inside].astype(item.dtype)
        for item in SAMPLE_FIELDS
        if item.name != "falling"
    }
    return {
        **batch,
        "falling": falling[inside],
        "episode_starts": np.cumsum(np.append(0, length[:-1])),
        "episode_end": np.where(fallen, FALL, TIME).astype(np.uint8),
        "final_states": final,
        "noise_std_rad": np.full(len(length), float(level)),
    }


__all__ = ["run_batch"]
