"""What notebooks 06 and 07 claim of the cost of planning, written to ``results.json``."""

from __future__ import annotations

from cassie_lib import machine
from cassie_lib.planning.cem import CEM
from cassie_lib.planning.cost import plan_seconds
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


__all__ = ["record_cache_gain", "record_gradient_memory", "record_plan_time"]
