"""What notebooks 06 to 08 claim besides steps until a fall: costs of a plan, drift of the walk."""

from __future__ import annotations

import numpy as np

from cassie_lib import machine
from cassie_lib.intervals import bootstrap_interval
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.cost import plan_seconds
from cassie_lib.planning.episodes import PlannedEpisodes
from cassie_lib.plots.planner_measures import side_speed
from cassie_lib.presets import CEMParameters, GradientCEMParameters
from cassie_lib.provenance import Provenance
from cassie_lib.results import record_result

#: Measurements of a plan; the least counts, as other work on the machine only adds.
MEASUREMENTS = 5


def _sizes(parameters: CEMParameters) -> str:
    """Sizes of a planner in the thesis's letters."""
    p = parameters
    letters = {"N": p.samples, "K": p.elites, "C": p.iterations}
    if isinstance(p, GradientCEMParameters):
        letters["G"] = p.gradient_iterations
    return ", ".join(f"{name} = {value}" for name, value in {**letters, "tau": p.horizon}.items())


def record_plan_time(claim_id: str, section: str, planner: CEM, provenance: Provenance) -> str:
    """Measure one plan of one robot on one core, and record it.

    Args:
        claim_id: As for ``record_result``.
        section: Of the thesis.
        planner: The planner on its trained model.
        provenance: Of the notebook.

    Returns:
        One line for the reader.
    """
    plan_ms = 1e3 * min(plan_seconds(planner) for _ in range(MEASUREMENTS))
    how = (
        f"least of {MEASUREMENTS} measurements, one core of {machine.core_gflops():.0f} GFLOP/s, "
        + _sizes(planner.parameters)
    )
    name = "Gradient-CEM" if isinstance(planner.parameters, GradientCEMParameters) else "CEM"
    claim = f"one {name} plan, processor time"
    record_result(
        claim_id, section, provenance.preset, plan_ms, None, 1, how, provenance.from_nothing_s,
        None, "not comparable", claim=claim, unit="ms",
        reason=f"the control period is 30 ms; {how}",
    )  # fmt: skip
    return f"{claim}: {plan_ms:.0f} ms ({how})"


def record_gradient_memory(
    preset: str, elites: int, samples: int, horizon: int, memory_ratio: float
) -> str:
    """Record what gradients on the elites alone save (Algorithm 2, lines 4-7).

    Args:
        preset: Name of the preset that really ran.
        elites: K.
        samples: N.
        horizon: Control steps of a candidate.
        memory_ratio: Memory of gradients on N sequences over that on K.

    Returns:
        One line for the reader.
    """
    how, claim = (
        f"tau = {horizon}, one run",
        f"memory that gradients of {samples} sequences hold, over that of {elites}",
    )
    record_result(
        "07-gradient-memory", "section 5.2.2", preset, memory_ratio, None, 1, how, 0.0, None,
        "not comparable", claim=claim, reason=how,
    )  # fmt: skip
    return f"{claim}: {memory_ratio:.3g}"


def record_cache_gain(preset: str, parameters: CEMParameters, gain: float) -> str:
    """Record what the causal model's cache saves.

    Args:
        preset: Name of the preset that really ran.
        parameters: The planner that was timed, with one iteration.
        gain: Time of a plan without the cache over that with it.

    Returns:
        One line for the reader.
    """
    how = f"CEM, N = {parameters.samples}, C = 1, tau = {parameters.horizon}, one core"
    claim = "time of a plan without the cache, over that with it"
    record_result(
        "07-cache-gain", "section 5.2.2", preset, gain, None, 1, how, 0.0, None,
        "not comparable", claim=claim, reason=how,
    )  # fmt: skip
    return f"{claim}: {gain:.3g}"


def record_side_speed(
    claim_id: str, figure: str, claim: str, found: PlannedEpisodes, provenance: Provenance
) -> str:
    """Record how fast a walk drifts to the side: median over the seeds, and its interval.

    Args:
        claim_id, figure, claim: As for ``record_result``.
        found: Episodes of a planner.
        provenance: Of the notebook.

    Returns:
        One line for the reader.
    """
    speed = side_speed(found)
    known = speed[np.isfinite(speed)]
    value = float(np.median(known)) if len(known) else None
    interval = bootstrap_interval(known) if len(known) else None
    commanded = found.recording.speed_mps
    reason = (
        f"{len(known)} of {len(speed)} seeds; left positive, commanded: 0 and {commanded:.3g} ahead"
    )
    record_result(
        claim_id, figure, provenance.preset, value, interval, len(speed), found.recording.protocol,
        provenance.from_nothing_s, None, "not comparable", claim=claim, unit="m/s", reason=reason,
    )  # fmt: skip
    told = "unknown" if value is None else f"{value:+.3f} m/s"
    if interval is not None:
        told += f" [{interval[0]:+.3f}, {interval[1]:+.3f}]"
    return f"{claim}: {told} ({reason})"


__all__ = [
    "record_cache_gain",
    "record_gradient_memory",
    "record_plan_time",
    "record_side_speed",
]
