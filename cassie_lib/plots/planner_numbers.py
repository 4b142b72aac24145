"""Numbers of notebooks 06 to 08: planner-only steps with intervals, and honest verdicts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from cassie_lib.errors import ParameterError, ShapeError
from cassie_lib.intervals import bootstrap_interval
from cassie_lib.planning.episodes import PlannedEpisodes
from cassie_lib.plots.planner_measures import planner_report, side_speed, stepping_share
from cassie_lib.provenance import Provenance
from cassie_lib.results import record_result


class Verdict(NamedTuple):
    """A median of planner-only steps beside a number of the thesis.

    Attributes:
        median: Planner-only control steps.
        interval: Its 95 % bootstrap interval over the seeds.
        verdict: As :data:`cassie_lib.results.VERDICTS` names it.
        reason: Why, in a few words.
    """

    median: float
    interval: tuple[float, float]
    verdict: str
    reason: str


def against_thesis(found: PlannedEpisodes, thesis_steps: float) -> Verdict:
    """Compare planner-only steps with the thesis's number of steps until its fall.

    ``better`` when the whole interval is above it, ``reproduced`` when the interval reaches it,
    and neither when the robot stays upright without stepping in most of its cycles, or when the
    trial ended, with robots upright, before it could tell.
    """
    steps = found.planner_steps
    total = found.planner_limit
    low, high = bootstrap_interval(steps)
    median, upright = float(np.median(steps)), int((~found.recording.fell).sum())
    reasons = [f"{upright} of {len(steps)} seeds upright at the end, after {total} steps"]
    share = stepping_share(found)
    stepping = np.isfinite(share).any() and float(np.nanmedian(share)) >= 0.5
    verdict = "better" if low > thesis_steps else "reproduced"
    if high < thesis_steps and high >= total:
        verdict = "not comparable"
        reasons.append(f"the trial ended after {total} steps, before the thesis's robot fell")
    elif high < thesis_steps:
        verdict = "not reproduced"
        reasons.append("fell earlier than the thesis's robot")
    elif not stepping:
        verdict = "not comparable"
        reasons.append("does not lift both feet in most cycles")
    reasons.append("thesis: one run, its total probably includes a prefix; ours counts none")
    return Verdict(median, (low, high), verdict, "; ".join(reasons))


def _walking(found: PlannedEpisodes) -> str:
    """How many seeds pass the walking report; nothing when the trial is too short for one."""
    try:
        walks = planner_report(found).walks
    except ParameterError:
        return ""
    return f"{walks.sum()} of {len(walks)} pass the walking report"


def record_steps(
    claim_id: str,
    figure: str,
    claim: str,
    found: PlannedEpisodes,
    thesis_steps: float,
    provenance: Provenance,
    note: str = "",
) -> str:
    """Record planner-only steps beside a number of the thesis; arguments as ``record_result``.

    The time from nothing is that of all artifacts of the provenance.  The reason also says how
    many seeds pass the walking report: to stay upright is not to walk.

    Args:
        claim_id, figure, claim: As for ``record_result``.
        found: Episodes of a planner.
        thesis_steps: Control steps until the thesis's robot fell.
        provenance: Of the notebook.
        note: What else the table's reader must know.

    Returns:
        One line for the reader.
    """
    result, seeds = against_thesis(found, thesis_steps), len(found.planner_steps)
    reason = "; ".join(filter(None, (_walking(found), note, result.reason)))
    record_result(
        claim_id, figure, provenance.preset, result.median, result.interval, seeds,
        found.recording.protocol, provenance.from_nothing_s, thesis_steps, result.verdict,
        claim=claim, unit="steps", reason=reason,
    )  # fmt: skip
    low, high = result.interval
    return (
        f"{claim}: thesis {thesis_steps:g} in all, here {result.median:g} by the planner alone "
        f"(95 % interval {low:g} to {high:g}): {result.verdict} ({reason})"
    )


def improvement(before: PlannedEpisodes, after: PlannedEpisodes) -> tuple[float, float, float]:
    """Median gain in planner-only steps of the same seeds, and its 95 % interval.

    The longer trial is cut off at the length of the shorter one: more steps to walk are no gain.

    Raises:
        ShapeError: If the trials have different numbers of seeds.
    """
    if len(after.planner_steps) != len(before.planner_steps):
        raise ShapeError(
            f"trials of {len(before.planner_steps)} and {len(after.planner_steps)} seeds: "
            "expected the same seeds in both"
        )
    limit = min(before.planner_limit, after.planner_limit)
    gain = np.minimum(after.planner_steps, limit) - np.minimum(before.planner_steps, limit)
    low, high = bootstrap_interval(gain)
    return float(np.median(gain)), low, high


def record_gain(
    claim_id: str,
    figure: str,
    claim: str,
    before: PlannedEpisodes,
    after: PlannedEpisodes,
    provenance: Provenance,
    *,
    thesis: str | None = "126 to 155",
    note: str = "",
    control: PlannedEpisodes | None = None,
) -> str:
    """Record what a change gained in planner-only steps: median over the differences of each seed.

    Reproduced when the whole interval is above zero; not comparable when no robot falls before or
    after the change, so that there was nothing to gain, and when a control without the change gains
    as much.

    Args:
        claim_id, figure, claim: As for ``record_result``.
        before: Episodes before the change (of model or planner).
        after: Episodes of the same seeds after it.
        provenance: Of the notebook.
        thesis: The thesis's numbers; None where it has none.
        note: What else the table's reader must know.
        control: Episodes of the same seeds with everything but what the change is said to be.

    Returns:
        One line for the reader.
    """
    median, low, high = improvement(before, after)
    verdict, reason = "reproduced", ""
    if low <= 0:
        verdict, reason = "not reproduced", "the interval of the gain reaches zero"
        if high < 0:
            reason = "it costs steps"
        limit = min(before.planner_limit, after.planner_limit)
        if min(before.planner_steps.min(), after.planner_steps.min()) >= limit:
            verdict, reason = "not comparable", "nothing to gain: no seed falls without it either"
    if verdict == "reproduced" and control is not None and improvement(control, after)[1] <= 0:
        verdict, reason = "not comparable", "the control gains as much"
    if thesis is None:
        verdict = "not comparable"
    share = stepping_share(after)
    # Of a seed that falls within its first cycle the share says nothing.
    walked = share[np.isfinite(share)]
    still = "no seed lifts both feet in any cycle" if len(walked) and not walked.any() else ""
    how = "median of the seeds' own differences"
    reason = "; ".join(filter(None, (reason, still, how, note)))
    record_result(
        claim_id, figure, provenance.preset, median, (low, high), len(after.planner_steps),
        after.recording.protocol, provenance.from_nothing_s, thesis, verdict,
        claim=claim, unit="steps", reason=reason,
    )  # fmt: skip
    reason = f" ({reason})"
    told = verdict if thesis is not None else "the thesis has no number"
    return f"{claim}: {median:+g} (95 % interval {low:+g} to {high:+g}): {told}{reason}"


def steps_table(trials: Mapping[str, PlannedEpisodes], limit: int = 0):
    """Planner-only steps of several trials as a pandas frame.

    Args:
        trials: Trials by label.
        limit: Control steps, hand-over included, after which all are cut off so that trials of
            different length compare; 0 for none.
    """
    import pandas as pd

    rows = []
    for label, found in trials.items():
        total = min(limit or 10**9, found.recording.actions.shape[1]) - found.log.handover_step
        steps = np.minimum(found.planner_steps, total)
        low, high = bootstrap_interval(steps)
        share = stepping_share(found)
        known = share[np.isfinite(share)]
        rows.append(
            {
                "trial": label,
                "median planner-only steps": f"{np.median(steps):g}",
                "95 % interval": f"{low:g} to {high:g}",
                "least, greatest": f"{steps.min()}, {steps.max()}",
                "still upright at its end": f"{(steps >= total).sum()}/{len(steps)} after {total}",
                "cycles with both feet lifted 5 cm": f"{np.median(known):.0%}"
                if len(known)
                else "–",
                "sideways speed, m/s": _median(side_speed(found, limit)),
            }
        )
    return pd.DataFrame(rows).set_index("trial")


def _median(values: np.ndarray) -> str:
    """Median of what is known, or a dash."""
    known = values[np.isfinite(values)]
    return f"{np.median(known):+.3f}" if len(known) else "–"


def target_line(found: PlannedEpisodes, target: int) -> str:
    """One line that says whether the median reaches a target."""
    median = float(np.median(found.planner_steps))
    verdict = "reached" if median >= target else "NOT reached"
    return f"target of {target} planner-only steps (median): {verdict} with {median:g}"
