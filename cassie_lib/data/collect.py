"""Collection of section 4.3.2: a controller, Gaussian action noise, every episode from s0.

Robots run in batches.  A batch depends on the seed, its number and how much is still wanted, so a
killed collection goes on with the next batch and ends with the same bits.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cassie_lib.artifacts import WORK
from cassie_lib.controllers import Controller
from cassie_lib.data.batch import run_batch
from cassie_lib.data.episodes import FALL, Episodes
from cassie_lib.data.fields import EPISODE_NAMES, SAMPLE_NAMES
from cassie_lib.data.store import CARD, open_dataset, save_dataset
from cassie_lib.errors import DataError, ParameterError
from cassie_lib.files import UNREADABLE, canonical_json, replacing
from cassie_lib.logs import Progress
from cassie_lib.presets import CollectionParameters, NoiseStudyParameters, SimulationParameters
from cassie_lib.simulator import S0_PHASE, Simulator

_BATCHES = "batches"


def collect(
    controller: Controller, parameters: CollectionParameters, simulation: SimulationParameters,
    folder: Path, *, threads: int | None = None, torch_threads: int = 1, progress: bool = True,
) -> Episodes:
    """Collect exactly ``parameters.transitions`` transitions and store them in a folder.

    Episodes count in the order of their number; the last one is cut where the count is reached.

    Args:
        controller: Expert, planner or anything else that acts.
        parameters: How many transitions, at which noise.
        simulation: Physics step and commanded speed.
        folder: Where the data set goes; finished batches found there are used.  The controller is
            known by the name of its class: another one of the same class needs another folder, as
            the pipelines' folders are, whose names hold the controller's weights.
        threads: Threads of the simulator; default one per core.  The result does not depend on it.
        torch_threads: Threads of PyTorch while the controller acts; a planner may want more than
            a policy does, and another number may change the last bits.
        progress: Whether to print how far it is.

    Returns:
        The stored data set, mapped into memory.

    Raises:
        ParameterError: If sigma is negative or a count is out of range.
        DataError: If the folder holds batches of another collection.
    """
    _check(parameters.transitions, parameters.episode_steps, parameters.robots)
    _check_noise(parameters.noise_std_rad)
    plan = _Plan(parameters.name, parameters.robots, parameters.episode_steps, parameters.seed,
                 (parameters.noise_std_rad,), parameters.transitions)  # fmt: skip
    return _collect(controller, plan, simulation, folder, (threads, torch_threads), progress)


def collect_noise_study(
    controller: Controller, parameters: NoiseStudyParameters, simulation: SimulationParameters,
    folder: Path, *, threads: int | None = None, torch_threads: int = 1, progress: bool = True,
) -> Episodes:
    """Run the same number of whole episodes at each of several noise levels.

    Arguments and errors as in :func:`collect`; ``noise_std_rad`` of the result tells the level of
    each episode.
    """
    _check(1, parameters.episode_steps, parameters.robots)
    if not parameters.noise_std_rad:
        raise ParameterError("noise study has no noise level: expected at least one")
    for level in parameters.noise_std_rad:
        _check_noise(level)
    plan = _Plan("noise-study", parameters.robots, parameters.episode_steps, parameters.seed,
                 tuple(parameters.noise_std_rad), 0)  # fmt: skip
    return _collect(controller, plan, simulation, folder, (threads, torch_threads), progress)


@dataclass(frozen=True)
class _Plan:
    """What decides every batch.  Batch b runs at noise level ``levels[b % len(levels)]``."""

    name: str
    robots: int
    episode_steps: int
    seed: int
    levels: tuple[float, ...]
    transitions: int  # 0: one batch per level, nothing is cut

    def batches(self) -> Iterator[tuple[int, float]]:
        """Numbers and noise levels; endless when a number of transitions is wanted."""
        number = 0
        while self.transitions or number < len(self.levels):
            yield number, self.levels[number % len(self.levels)]
            number += 1

    def batch_size(self, done: int) -> int:
        """Robots of the next batch: no more than are needed to reach the wanted number."""
        needed = -(-(self.transitions - done) // self.episode_steps)
        return min(self.robots, max(4, needed)) if self.transitions else self.robots

    @property
    def expected(self) -> int:
        """Control steps to expect if no robot falls."""
        return self.transitions or self.robots * self.episode_steps * len(self.levels)


def _check(transitions: int, episode_steps: int, robots: int) -> None:
    counts = {"transitions": transitions, "episode_steps": episode_steps, "robots": robots}
    for name, value in counts.items():
        if value < 1:
            raise ParameterError(f"{name} is {value}: expected at least 1")


def _check_noise(level: float) -> None:
    if not 0.0 <= level < np.inf:
        raise ParameterError(f"noise_std_rad is {level}: expected a finite number >= 0 rad")


def _collect(
    controller: Controller, plan: _Plan, simulation: SimulationParameters, folder: Path,
    threads: tuple[int | None, int], progress: bool,
) -> Episodes:
    protocol = _protocol(controller, plan, simulation)
    if (folder / CARD).exists():
        stored = open_dataset(folder)
        if stored.card["protocol"] != protocol:
            raise DataError(f"{folder.name} holds another collection: expected an empty folder")
        return stored
    work = folder / WORK / _BATCHES
    work.mkdir(parents=True, exist_ok=True)
    batches, done = [], 0
    meter = Progress(f"collect {plan.name}", plan.expected, quiet=not progress)
    for number, level in plan.batches():
        robots, path = plan.batch_size(done), work / f"{number:05d}.npz"
        identity = canonical_json({**protocol, "batch": number, "batch_robots": robots})
        batch = _read_batch(path, identity)
        if batch is None:
            simulator = Simulator(robots, simulation.timestep_s, threads[0])
            simulator.reset(speed=simulation.speed_mps)
            random = np.random.default_rng([plan.seed, number])
            batch = run_batch(controller, simulator, plan.episode_steps, level, random, threads[1])
            with replacing(path) as partial:
                np.savez(partial, allow_pickle=False, identity=np.array(identity), **batch)
        batches.append(batch)
        done += len(batch["states"])
        meter.update(min(done, plan.expected), {"falls": np.sum(batch["episode_end"] == FALL)})
        if plan.transitions and done >= plan.transitions:
            break
    episodes = _lay_end_to_end(batches)
    if plan.transitions:
        episodes = episodes.part(0, plan.transitions)
    save_dataset(folder, episodes, plan.name, protocol)
    shutil.rmtree(work)
    if not any((folder / WORK).iterdir()):
        (folder / WORK).rmdir()
    return open_dataset(folder)


def _protocol(
    controller: Controller, plan: _Plan, simulation: SimulationParameters
) -> dict[str, Any]:
    levels = ", ".join(f"{level:g}" for level in plan.levels)
    return {
        "text": (
            f"every episode starts at s0 (phase {S0_PHASE}, Appendix A.3) and lasts "
            f"{plan.episode_steps} control steps or until the pelvis leaves 0.4..3.0 m; "
            f"executed action = {type(controller).__name__.lower()} + N(0, sigma^2) on each of 10 "
            f"components, sigma = {levels} rad; section 4.3.2"
        ),
        "controller": type(controller).__name__,
        "speed_mps": simulation.speed_mps,
        "timestep_s": simulation.timestep_s,
        **asdict(plan),
        "levels": list(plan.levels),
    }


def _read_batch(path: Path, identity: str) -> dict[str, np.ndarray] | None:
    """A finished batch, or None when it has to be run; a damaged one is run again."""
    try:
        with np.load(path, allow_pickle=False) as file:
            # NumPy reads no further than a damaged shape says, where no checksum is looked at.
            if file.zip.testzip() is not None:
                return None
            stored = {name: file[name] for name in file.files}
        found = str(stored.pop("identity"))
    except UNREADABLE:
        return None
    if found != identity:
        raise DataError(f"{path.parent.parent.name}/{path.name} is a batch of another collection")
    return stored


def _lay_end_to_end(batches: list[dict[str, np.ndarray]]) -> Episodes:
    sizes = [len(batch["states"]) for batch in batches]
    offsets = np.cumsum([0, *sizes[:-1]])
    joined = {
        name: np.concatenate([batch[name] for batch in batches])
        for name in (*SAMPLE_NAMES, *EPISODE_NAMES)
        if name != "episode_starts"
    }
    starts = [b["episode_starts"] + o for b, o in zip(batches, offsets, strict=True)]
    return Episodes(**joined, episode_starts=np.concatenate(starts), card={})


__all__ = ["collect", "collect_noise_study"]
