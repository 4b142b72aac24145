"""How the cost of a plan grows: with N, tau and H, with gradients on K or N, without a cache."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from cassie_lib import gait
from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.planning.assemble import make_planner
from cassie_lib.planning.cost import (
    Uncached,
    gradient_memory,
    gradient_seconds,
    plan_seconds,
)
from cassie_lib.planning.objective import Objective
from cassie_lib.planning.stage_reward import WalkingReward
from cassie_lib.presets import CausalParameters, CEMParameters, replace
from cassie_lib.simulator import S0_SPEED_MPS

#: Candidates of the uncached model in one forward pass: bounds its memory.
_MAX_ROWS = 250


class Sweep(NamedTuple):
    """Processor time of one CEM plan against one of its sizes.

    Attributes:
        name: What was varied: ``"N"``, ``"tau"`` or ``"H"``.
        values: ``(n,)``.
        seconds: ``(n,)``.
    """

    name: str
    values: np.ndarray
    seconds: np.ndarray

    @property
    def exponent(self) -> float:
        """Slope of log time against log size: 1 is linear, 0 is no cost at all."""
        return float(np.polyfit(np.log(self.values), np.log(self.seconds), 1)[0])


class GradientCost(NamedTuple):
    """One gradient of the return on so many sequences: bytes held and processor time in s."""

    sequences: int
    memory_bytes: int
    seconds: float


def untrained(parameters: CausalParameters, **changes) -> CausalModel:
    """A causal model with random weights, which cost what trained ones cost."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = CausalModel(replace(parameters, **changes))
    return model.eval().requires_grad_(False)


def plan_sweeps(
    parameters: CEMParameters,
    model: CausalParameters,
    samples: Sequence[int],
    horizons: Sequence[int],
    contexts: Sequence[int],
    repeats: int = 2,
) -> list[Sweep]:
    """Time one plan of plain CEM with one iteration against N, tau and H.

    Args:
        parameters: What is not varied.
        model: Sizes of the causal model.
        samples: Values of N, each at least K.
        horizons: Values of tau.
        contexts: Values of H.
        repeats: Plans per value, the shortest of which counts.
    """
    base = replace(parameters, iterations=1, mean="zero", terminal_weight=0.0)
    base = replace(base, elites=min(base.elites, *samples))
    causal = untrained(model)
    planners = {
        "N": (samples, lambda n: make_planner(causal, replace(base, samples=n))),
        "tau": (horizons, lambda t: make_planner(causal, replace(base, horizon=t))),
        "H": (contexts, lambda h: make_planner(untrained(model, context=h), base)),
    }
    return [
        Sweep(
            name, np.array(values),
            np.array([plan_seconds(make(value), repeats=repeats) for value in values]),
        )
        for name, (values, make) in planners.items()
    ]  # fmt: skip


def gradient_costs(
    model: CausalParameters, sequences: Sequence[int], horizon: int, repeats: int = 1
) -> list[GradientCost]:
    """Memory and time of one gradient on K elites, or on all N samples as in reference [3].

    Args:
        model: Sizes of the causal model.
        sequences: Numbers of sequences improved at once, e.g. K and N.
        horizon: tau.
        repeats: Gradients per number, the shortest of which counts.
    """
    objective = Objective(untrained(model), WalkingReward(gait.walk(S0_SPEED_MPS)))
    return [
        GradientCost(
            count,
            gradient_memory(objective, count, horizon),
            gradient_seconds(objective, count, horizon, repeats),
        )
        for count in sequences
    ]


def cache_gain(parameters: CEMParameters, model: CausalParameters) -> tuple[float, float]:
    """Time (s) of one CEM plan with one iteration, with the key-value cache and without it.

    More iterations make the cache gain more: the history is encoded once per plan.
    """
    base = replace(parameters, iterations=1, mean="zero", terminal_weight=0.0)
    causal = untrained(model)
    cached = plan_seconds(make_planner(causal, base), repeats=1)
    naive = make_planner(Uncached(causal), base, max_rows=_MAX_ROWS)
    return cached, plan_seconds(naive, repeats=1)
