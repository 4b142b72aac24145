"""Does it walk?  The measures that a high reward and an upright robot do not prove."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cassie_lib.errors import ParameterError
from cassie_lib.recording import Recording
from cassie_lib.robot.model import parameters
from cassie_lib.robot.schema import CONTROL_PERIOD_S, GRAVITY, PERIOD

#: A foot carries load when it bears this share of the robot's weight.
_LOADED_SHARE = 0.05
#: A step counts as one when the foot was lifted this high before it came down (m).
_STEP_LIFT_M = 0.02


@dataclass(frozen=True)
class Measure:
    """One line of the report.

    Attributes:
        name: What is measured, with its unit.
        values: One value per episode.
        low: Least accepted value.
        high: Greatest accepted value.
    """

    name: str
    values: np.ndarray
    low: float = -np.inf
    high: float = np.inf

    @property
    def passed(self) -> np.ndarray:
        """Which episodes are within the bounds; an undefined value (NaN) is not."""
        return (self.values >= self.low) & (self.values <= self.high)


@dataclass(frozen=True)
class WalkingReport:
    """All measures of a recording.

    Attributes:
        measures: The lines.
        protocol: How the episodes were run.
    """

    measures: tuple[Measure, ...]
    protocol: str

    @property
    def walks(self) -> np.ndarray:
        """Episodes that pass every measure, ``(N,)``."""
        return np.all([measure.passed for measure in self.measures], axis=0)

    def __getitem__(self, name: str) -> Measure:
        """Measure by the start of its name."""
        for measure in self.measures:
            if measure.name.startswith(name):
                return measure
        raise KeyError(name)

    def rows(self) -> list[dict[str, object]]:
        """Table rows: median and range over the episodes, bound, episodes that pass."""
        table: list[dict[str, object]] = []
        for m in self.measures:
            bound = " to ".join(f"{b:g}" for b in (m.low, m.high) if np.isfinite(b))
            sign = (
                ""
                if np.isfinite(m.low) and np.isfinite(m.high)
                else ("≥ " if np.isfinite(m.low) else "≤ ")
            )
            finite = m.values[np.isfinite(m.values)]
            spread = (
                f"{np.median(finite):.3g} [{finite.min():.3g}, {finite.max():.3g}]"
                if len(finite)
                else "undefined"
            )
            table.append(
                {
                    "measure": m.name,
                    "median [least, greatest]": spread,
                    "bound": sign + bound,
                    "pass": f"{m.passed.sum()}/{len(m.values)}",
                }
            )
        table.append(
            {
                "measure": "all of these",
                "median [least, greatest]": "",
                "bound": "",
                "pass": f"{self.walks.sum()}/{len(self.walks)}",
            }
        )
        return table

    def to_markdown(self) -> str:
        """The table as Markdown, protocol below it."""
        rows = self.rows()
        head = list(rows[0])
        lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
        lines += ["| " + " | ".join(str(row[key]) for key in head) + " |" for row in rows]
        return "\n".join([*lines, "", f"*{self.protocol}*"])

    def _repr_markdown_(self) -> str:
        return self.to_markdown()


def walking_report(
    recording: Recording,
    *,
    begin: int = 2 * PERIOD,
    speed_tolerance: float = 0.05,
    min_reward: float = 0.0,
) -> WalkingReport:
    """Measure a walk.

    Args:
        recording: Episodes of any controller, see :func:`cassie_lib.walking.run_episodes`.
        begin: First control step that counts for the gait measures; before it the robot starts
            (or an expert hands over).
        speed_tolerance: Accepted deviation of the mean forward speed, m/s.
        min_reward: Least accepted mean of plain Eq 3.10.

    Returns:
        The report; gait measures of an episode shorter than ``begin`` plus two cycles are NaN.

    Raises:
        ParameterError: If no episode could be long enough.
    """
    total = recording.actions.shape[1]
    if total < begin + 2 * PERIOD:
        raise ParameterError(
            f"recording has {total} control steps: expected at least {begin + 2 * PERIOD}"
        )
    count = len(recording.length)
    gait_rows = np.full((count, 7), np.nan)
    for episode in range(count):
        length = int(recording.length[episode])
        if length >= begin + 2 * PERIOD:
            gait_rows[episode] = _gait_measures(recording, episode, begin, length)
    lift, left, right, flight, alternation, speed, drift = gait_rows.T
    with np.errstate(invalid="ignore"):
        mean_reward = np.array(
            [
                np.mean(row[:n]) if n else np.nan
                for row, n in zip(recording.reward, recording.length, strict=True)
            ]
        )
    return WalkingReport(
        (
            Measure("control steps without a fall", recording.length.astype(float), low=total),
            Measure("least foot lift of any cycle (m)", lift, low=0.05),
            Measure("left single support (share of time)", left, 0.30, 0.50),
            Measure("right single support (share of time)", right, 0.30, 0.50),
            Measure("both feet in the air (share of time)", flight, high=0.10),
            Measure("touch-downs that change feet (share)", alternation, low=0.99),
            Measure(
                "mean forward speed (m/s)",
                speed,
                recording.speed_mps - speed_tolerance,
                recording.speed_mps + speed_tolerance,
            ),
            Measure("mean sideways speed (m/s)", drift, -0.1, 0.1),
            Measure("plain reward 3.10 per step", mean_reward, low=min_reward),
        ),
        recording.protocol,
    )


def _gait_measures(recording: Recording, episode: int, begin: int, length: int) -> tuple:
    rows = slice(begin, length + 1)
    height = recording.foot_height[episode, rows]
    weight = GRAVITY * sum(body["mass_kg"] for body in parameters()["bodies"])
    loaded = recording.foot_force[episode, rows, :, 2] > _LOADED_SHARE * weight
    cycles = len(height) // PERIOD
    lifts = height[: cycles * PERIOD].reshape(cycles, PERIOD, 2).max(axis=1)
    position = recording.qpos[episode, rows, :2]
    velocity = (position[-1] - position[0]) / ((len(position) - 1) * CONTROL_PERIOD_S)
    return (
        lifts.min(),
        np.mean(loaded[:, 0] & ~loaded[:, 1]),
        np.mean(loaded[:, 1] & ~loaded[:, 0]),
        np.mean(~loaded.any(axis=1)),
        _alternation(height, loaded),
        velocity[0],
        velocity[1],
    )


def _alternation(height: np.ndarray, loaded: np.ndarray) -> float:
    """Share of successive touch-downs, after a real lift, that are of the other foot."""
    sequence, lifted = [], np.zeros(2, dtype=bool)
    for row in range(len(height)):
        lifted |= (height[row] > _STEP_LIFT_M) & ~loaded[row]
        landed = lifted & loaded[row]
        if landed.any():
            # Both at once is a hop: a foot of its own, which never changes.
            sequence.append(2 if landed.all() else int(landed[1]))
        lifted &= ~landed
    if len(sequence) < 2:
        return 0.0
    return float(np.mean(np.diff(sequence) != 0))
