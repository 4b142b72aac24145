"""Everything that recurrent PPO needs to continue as if it had never been killed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import torch

from cassie_lib.simulator import Snapshot

if TYPE_CHECKING:
    from cassie_lib.expert.ppo import RecurrentPPO


def capture(run: RecurrentPPO) -> dict:
    """Collect the state of a run: networks, optimiser, random generators, robots, counters."""
    task = run.task
    simulator = task.simulator
    arrays = {
        "age": task.age,
        "gait_index": task._gait_index,
        "mean_velocity": task._mean_velocity,
        "since_push": task.pushes.since,
        "line": task.pushes.line_m,
        "push": simulator._push,
        "push_steps": simulator._push_steps,
        **{f"snapshot_{name}": value for name, value in simulator.snapshot()._asdict().items()},
    }
    return {
        "policy": run.policy.state_dict(),
        "optimiser": run.optimiser.state_dict(),
        "torch_generator": run.generator.get_state(),
        # JSON, because the generator's state holds integers of 128 bits.
        "numpy_generator": json.dumps(task.rng.bit_generator.state),
        "memory": list(run.memory),
        "starts": run.starts,
        "arrays": {name: torch.from_numpy(np.array(value)) for name, value in arrays.items()},
        "counters": {"steps": run.steps, "seconds": run.seconds, "inputs": run.input_count},
    }


def reinstate(run: RecurrentPPO, stored: dict) -> None:
    """Put a captured state back into a run of the same parameters."""
    run.policy.load_state_dict(stored["policy"])
    run.optimiser.load_state_dict(stored["optimiser"])
    run.generator.set_state(stored["torch_generator"])
    run.task.rng.bit_generator.state = json.loads(stored["numpy_generator"])
    run.memory, run.starts = tuple(stored["memory"]), stored["starts"]
    arrays = {name: value.numpy().copy() for name, value in stored["arrays"].items()}
    simulator = run.task.simulator
    simulator.restore(Snapshot(*(arrays[f"snapshot_{name}"] for name in Snapshot._fields)))
    simulator._push, simulator._push_steps = arrays["push"], arrays["push_steps"]
    run.task.age, run.task._gait_index = arrays["age"], arrays["gait_index"]
    run.task._mean_velocity = arrays["mean_velocity"]
    run.task.pushes.since, run.task.pushes.line_m = arrays["since_push"], arrays["line"]
    counters = stored["counters"]
    run.steps, run.seconds = counters["steps"], counters["seconds"]
    run.input_count = counters["inputs"]
