"""Measures what planning costs; run by hand: ``python tests/benchmarks/bench_planning.py``.

An untrained causal model and critic of the ``laptop`` sizes: weights do not change the time.
"""

from __future__ import annotations

import argparse
import json

import torch

from cassie_lib.dynamics.causal import CausalModel
from cassie_lib.expert.policy import Expert, ExpertPolicy
from cassie_lib.gait import walk
from cassie_lib.planning.assemble import make_planner
from cassie_lib.planning.cost import Uncached, gradient_memory, gradient_seconds, plan_seconds
from cassie_lib.planning.objective import Objective
from cassie_lib.planning.stage_reward import WalkingReward
from cassie_lib.presets import get_preset, replace


def model(**changes) -> CausalModel:
    """Untrained causal model of the laptop preset."""
    torch.manual_seed(0)
    made = CausalModel(replace(get_preset("laptop").causal, **changes))
    return made.eval().requires_grad_(False)


def plans() -> dict:
    """Time of one plan by preset, for one episode and for ten."""
    found, expert = {}, Expert(ExpertPolicy().eval())
    for name in ("smoke", "laptop"):
        preset = get_preset(name)
        for label, parameters in (("cem", preset.cem), ("gradient_cem", preset.gradient_cem)):
            planner = make_planner(model(), parameters, expert=expert)
            found[f"{name} {label}"] = {
                f"{count} episodes, ms": round(1e3 * plan_seconds(planner, count), 1)
                for count in (1, 10)
            }
    return found


def cache() -> dict:
    """Cached against naive at the thesis's N = 1000, K = 50, C = 10, tau = 10."""
    parameters = get_preset("thesis").cem
    causal = model()
    cached = plan_seconds(make_planner(causal, parameters), repeats=1, warm=False)
    slow = make_planner(Uncached(causal), parameters, max_rows=250)
    naive = plan_seconds(slow, repeats=1, warm=False)
    return {"cached_s": round(cached, 2), "naive_s": round(naive, 2), "ratio": naive / cached}


def gradients() -> dict:
    """Memory and time of one gradient on K = 50 elites and on all N = 1000 samples."""
    objective = Objective(model(), WalkingReward(walk(0.0509)))
    memory = {count: gradient_memory(objective, count, 10) for count in (50, 1000)}
    time = {count: gradient_seconds(objective, count, 10, 2) for count in (50, 1000)}
    return {
        "bytes": memory, "memory_ratio": memory[1000] / memory[50],
        "seconds": time, "time_ratio": time[1000] / time[50],
    }


def scaling() -> dict:
    """Time of a CEM plan (C = 1) against N, tau and H."""
    base = replace(get_preset("laptop").cem, samples=256, elites=16, iterations=1,
                   terminal_weight=0.0)  # fmt: skip
    causal = model()
    return {
        "samples": {
            n: plan_seconds(make_planner(causal, replace(base, samples=n)))
            for n in (64, 128, 256, 512, 1024)
        },
        "horizon": {
            t: plan_seconds(make_planner(causal, replace(base, horizon=t)))
            for t in (2, 5, 10, 20)
        },
        "context": {
            h: plan_seconds(make_planner(model(context=h), base)) for h in (8, 15, 30, 60, 120)
        },
    }


PARTS = {"plans": plans, "cache": cache, "gradients": gradients, "scaling": scaling}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=list(PARTS), help=", ".join(PARTS))
    for part in parser.parse_args().parts:
        print(part, json.dumps(PARTS[part](), indent=1), flush=True)
