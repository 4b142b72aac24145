"""Speed of the simulator, by hand: ``python tests/benchmarks/bench_simulator.py``.

Prints physics steps per second of N = 64 robots on all cores, the share of twice the rate of one
thread that never leaves C, PPO's control steps per second, and the import time of the package.
Run it on an idle machine.
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
PAIRS = 21


def _start(simulator: Simulator) -> np.ndarray:
    """Robots spread over the cycle of a walk; returns their playback actions' cycle."""
    reference = gait.walk(0.5)
    phase = np.arange(simulator.count) % 28
    simulator.reset(qpos=reference.qpos[phase], qvel=reference.qvel[phase], phase=phase)
    return reference.motor_position - robot.neutral_pose()


def batched_seconds(simulator: Simulator) -> float:
    """Seconds for ten control steps of :class:`Simulator`, Python included."""
    cycle = _start(simulator)
    began = time.perf_counter()
    for _ in range(CONTROL_STEPS):
        simulator.step(cycle[(simulator.phase + 1) % 28])
    return time.perf_counter() - began


def c_only_seconds(simulator: Simulator, data: mujoco.MjData, pool) -> float:
    """Seconds for the same steps by one thread inside one call of ``mujoco.rollout``."""
    cycle = _start(simulator)
    steps = (simulator.phase[:, None] + 1 + np.arange(CONTROL_STEPS)) % 28
    control = np.repeat(cycle[steps], 60, axis=1)
    began = time.perf_counter()
    pool.rollout(simulator.model, data, simulator.physics, control)
    return time.perf_counter() - began


def simulation_rates() -> tuple[np.ndarray, np.ndarray]:
    """Physics steps per second, batched and in C alone, measured in turn: ``(PAIRS,)`` each.

    In turn, because the clock of a shared machine drifts by more than what is measured.
    """
    simulator, seconds = Simulator(ROBOTS), []
    data, steps = mujoco.MjData(simulator.model), ROBOTS * CONTROL_STEPS * 60
    with mujoco.rollout.Rollout(nthread=0) as pool:
        for _ in range(PAIRS):
            seconds.append((batched_seconds(simulator), c_only_seconds(simulator, data, pool)))
    batched, alone = np.array(seconds).T
    return steps / batched, steps / alone


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
    return (
        count * preset.expert.robots * preset.expert.rollout_steps / (time.perf_counter() - began)
    )


def main() -> None:
    """Print the figures."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    batched, alone = simulation_rates()
    share = np.percentile(batched / (cores * alone), (25, 50, 75))
    seconds, torch = import_seconds()
    print(f"cores {cores}")
    print(f"batched, N = {ROBOTS}, 0.5 ms: {np.median(batched):,.0f} physics steps/s")
    print(f"one thread, C only: {np.median(alone):,.0f} steps/s; share of {cores} x that, "
          f"median of {PAIRS} pairs: {share[1]:.1%} "
          f"(quartiles {share[0]:.1%}, {share[2]:.1%})")  # fmt: skip
    print(f"import of robot and simulator: {seconds:.2f} s, torch imported: {torch}")
    print(f"recurrent PPO with learning: {ppo_rate():,.0f} control steps/s")


if __name__ == "__main__":
    main()
