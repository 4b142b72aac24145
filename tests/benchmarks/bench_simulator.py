"""Speed of the simulator, by hand: ``python tests/benchmarks/bench_simulator.py``.

Prints physics steps per second of N = 64 robots on all cores, the share of twice the rate of one
thread that never leaves C, PPO's control steps per second, and the import time of the package.
Run it on an idle machine; every rate is the best of several repetitions.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time

import mujoco
import mujoco.rollout
import numpy as np

from cassie_lib import gait
from cassie_lib.robot import model as robot
from cassie_lib.simulator import Simulator

ROBOTS = 64
CONTROL_STEPS = 10
REPEATS = 5


def _start(simulator: Simulator) -> np.ndarray:
    """Robots spread over the cycle of a walk; returns their playback actions' cycle."""
    reference = gait.walk(0.5)
    phase = np.arange(simulator.count) % 28
    simulator.reset(qpos=reference.qpos[phase], qvel=reference.qvel[phase], phase=phase)
    return reference.motor_position - robot.neutral_pose()


def batched_rate(threads: int | None = None) -> float:
    """Physics steps per second of :class:`Simulator`, Python included."""
    simulator, best = Simulator(ROBOTS, threads=threads), 0.0
    for _ in range(REPEATS):
        cycle = _start(simulator)
        began = time.perf_counter()
        for _ in range(CONTROL_STEPS):
            simulator.step(cycle[(simulator.phase + 1) % 28])
        best = max(best, ROBOTS * CONTROL_STEPS * 60 / (time.perf_counter() - began))
    return best


def c_only_rate() -> float:
    """Physics steps per second of one thread inside one call of ``mujoco.rollout``."""
    simulator = Simulator(ROBOTS, threads=1)
    data, best = mujoco.MjData(simulator.model), 0.0
    with mujoco.rollout.Rollout(nthread=0) as pool:
        for _ in range(REPEATS):
            cycle = _start(simulator)
            steps = (simulator.phase[:, None] + 1 + np.arange(CONTROL_STEPS)) % 28
            control = np.repeat(cycle[steps], 60, axis=1)
            began = time.perf_counter()
            pool.rollout(simulator.model, data, simulator.physics, control)
            best = max(best, ROBOTS * CONTROL_STEPS * 60 / (time.perf_counter() - began))
    return best


def import_seconds() -> tuple[float, bool]:
    """Seconds to import the package and the robot in a new process; whether torch came along."""
    code = "import time; t = time.perf_counter(); import cassie_lib, cassie_lib.simulator, sys; " \
           "print(time.perf_counter() - t, 'torch' in sys.modules)"  # fmt: skip
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    seconds, torch = out.stdout.split()
    return float(seconds), torch == "True"


def ppo_rate() -> float:
    """Control steps per second of recurrent PPO, learning included, at the laptop preset."""
    from cassie_lib.expert.ppo import RecurrentPPO
    from cassie_lib.presets import get_preset

    preset = get_preset("laptop")
    run = RecurrentPPO(preset.expert, preset.simulation.training_timestep_s)
    run._update()
    began, count = time.perf_counter(), 4
    for _ in range(count):
        run._update()
    return count * preset.expert.robots * preset.expert.rollout_steps / (
        time.perf_counter() - began
    )


def main() -> None:
    """Print the figures."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    batched, single = batched_rate(), c_only_rate()
    seconds, torch = import_seconds()
    print(f"cores {cores}")
    print(f"batched, N = {ROBOTS}, 0.5 ms: {batched:,.0f} physics steps/s")
    print(f"one thread, C only: {single:,.0f} steps/s; share of {cores} x that: "
          f"{batched / (cores * single):.1%}")  # fmt: skip
    print(f"import of robot and simulator: {seconds:.2f} s, torch imported: {torch}")
    print(f"recurrent PPO with learning: {ppo_rate():,.0f} control steps/s")


if __name__ == "__main__":
    main()
