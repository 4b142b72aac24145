"""Closed-loop episodes of a planner, with what it imagined, as one storable result."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cassie_lib.errors import ArtifactError, ShapeError
from cassie_lib.files import UNREADABLE, replacing
from cassie_lib.packing import packed, unpacked
from cassie_lib.planning.control import PlanLog, PlannerController
from cassie_lib.recording import Recording
from cassie_lib.reward import WEIGHTS
from cassie_lib.robot.schema import ACTION_SIZE, STATE_SIZE
from cassie_lib.walking import run_episodes


class PlannedEpisodes(NamedTuple):
    """Recording of N episodes and the log of the planner that drove them."""

    recording: Recording
    log: PlanLog

    @property
    def planner_steps(self) -> np.ndarray:
        """Control steps that each episode lasted after the hand-over, ``(N,)``."""
        return np.maximum(0, self.recording.length - self.log.handover_step)

    @property
    def planner_limit(self) -> int:
        """The most control steps that an episode can last after the hand-over."""
        return self.recording.actions.shape[1] - self.log.handover_step

    @property
    def plan_time_s(self) -> float:
        """Median wall time of one plan for all episodes that were still upright."""
        return float(np.nanmedian(self.log.plan_time_s))

    def imagined_and_realised(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of imagined and realised return of every step whose horizon ended upright."""
        log, length = self.log, self.recording.length
        rows = np.arange(len(log.plan_time_s))[:, None]
        valid = np.isfinite(log.realised_return) & (rows + _horizon(log) < length[None, :])
        return log.imagined_return[valid], log.realised_return[valid]


def _horizon(log: PlanLog) -> int:
    """Horizon of the plans: the rows at the end without a realised return."""
    known = np.flatnonzero(np.isfinite(log.realised_return).any(axis=1))
    return len(log.plan_time_s) - 1 - known[-1] if len(known) else len(log.plan_time_s)


def plan_episodes(controller: PlannerController, **options) -> PlannedEpisodes:
    """Run episodes of :func:`cassie_lib.walking.run_episodes` and keep the planner's log.

    Args:
        controller: The planner in closed loop.
        options: Passed on: ``episodes``, ``steps``, ``seed``, ``push``, ...
    """
    recording = run_episodes(controller, **options)
    return PlannedEpisodes(recording, controller.log())


def save_episodes(path: Path, found: PlannedEpisodes) -> None:
    """Write episodes to one ``.npz`` file, no pickle.

    What lies over time is packed (:mod:`cassie_lib.packing`), the planner's log is in
    single precision.  Wall times of planning lie in a file beside it, ``timing_<name>.npy``: they
    are no part of the content, which comes out the same every time.
    """
    recording, log = found
    arrays = {f"term_{name}": values for name, values in recording.terms.items()}
    for field in dataclasses.fields(recording):
        if field.name != "terms":
            arrays[field.name] = np.asarray(getattr(recording, field.name))
    stored: dict[str, Any] = dict(packed(arrays))
    columns = {name: np.asarray(value) for name, value in log._asdict().items()}
    times = columns.pop("plan_time_s").astype(np.float32)
    for name, series in columns.items():
        single = series.dtype == np.float64 and series.ndim
        stored[f"log_{name}"] = series.astype(np.float32) if single else series
    with replacing(path) as partial:
        np.savez_compressed(partial, **stored)
    with replacing(_timing_file(path)) as partial:
        np.save(partial, times, allow_pickle=False)


def _timing_file(path: Path) -> Path:
    return path.with_name(f"timing_{path.stem}.npy")


def _check_shapes(recording: Recording, log: PlanLog) -> None:
    count, steps = recording.actions.shape[:2]
    long = (count, steps + 1)
    expected = {
        "states": (*long, STATE_SIZE),
        "actions": (count, steps, ACTION_SIZE),
        "qpos": (*long, 35),
        "foot_position": (*long, 2, 3),
        "foot_height": (*long, 2),
        "foot_force": (*long, 2, 3),
        "phase": long,
        "length": (count,),
    }
    found = {name: getattr(recording, name) for name in expected}
    found |= {f"term_{name}": value for name, value in recording.terms.items()}
    found |= {"log_planned": log.planned, "log_stage_reward": log.stage_reward}
    times, rows = log.plan_time_s.shape, len(log.planned)
    if times != (rows,):
        raise ShapeError(f"plan times of shape {times}: expected {(rows,)}")
    for name, value in found.items():
        # The log ends where all have fallen.
        wanted = (count, steps) if name.startswith("term") else (len(log.planned), count)
        if value.shape != (wanted := expected.get(name, wanted)):
            raise ShapeError(f"{name} has shape {value.shape}: expected {wanted}")


def load_episodes(path: Path) -> PlannedEpisodes:
    """Read what :func:`save_episodes` wrote.

    Raises:
        ArtifactError: If the file is missing, damaged or of another format.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays: dict[str, Any] = dict(unpacked(stored))
        arrays["log_plan_time_s"] = np.load(_timing_file(path), allow_pickle=False)
        terms = {name: arrays.pop(f"term_{name}") for name in WEIGHTS}
        log = PlanLog(**{name: arrays.pop(f"log_{name}") for name in PlanLog._fields})
        arrays["speed_mps"] = float(arrays["speed_mps"])
        arrays["protocol"] = str(arrays["protocol"])
        recording = Recording(terms=terms, **arrays)
        _check_shapes(recording, log)
    except UNREADABLE as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ArtifactError(f"{path.name} holds no planned episodes: {reason}") from error
    return PlannedEpisodes(recording, log._replace(handover_step=int(log.handover_step)))
