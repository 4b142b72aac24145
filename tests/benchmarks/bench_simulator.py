"""Speed of the simulator, by hand: ``python tests/benchmarks/bench_simulator.py``.

Prints physics steps per second of N = 64 robots on all cores; the share of twice the rate of one
thread that never leaves C, beside the share that as many threads reach without leaving C (what the
machine itself loses) and the share of the time that the cores were busy (what Python and waiting
for the last robot lose, whatever the clock does); PPO's control steps per second; the import time
of the package.  Run it on an idle machine.  Shares are medians over turns with 95 % bootstrap
intervals: a shared machine gives one turn a fifth more or less than the next.
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
from cassie_lib.intervals import bootstrap_interval
from cassie_lib.robot import model as robot
from cassie_lib.simulator import Simulator

ROBOTS = 64
CONTROL_STEPS = 3
TURNS = 81


def _start(simulator: Simulator) -> np.ndarray:
    """Robots spread over the cycle of a walk; returns their playback actions' cycle."""
    reference = gait.walk(0.5)
    phase = np.arange(simulator.count) % 28
    simulator.reset(qpos=reference.qpos[phase], qvel=reference.qvel[phase], phase=phase)
    return reference.motor_position - robot.neutral_pose()


def batched_seconds(simulator: Simulator) -> tuple[float, float]:
    """Wall and processor seconds for a few steps of :class:`Simulator`, Python included."""
    cycle = _start(simulator)
    began, used = time.perf_counter(), time.process_time()
    for _ in range(CONTROL_STEPS):
        simulator.step(cycle[(simulator.phase + 1) % 28])
    return time.perf_counter() - began, time.process_time() - used


def c_only_seconds(simulator: Simulator, data: list[mujoco.MjData], pool) -> float:
    """Seconds for the same steps inside one call of ``mujoco.rollout``, a thread per ``data``."""
    cycle = _start(simulator)
    steps = (simulator.phase[:, None] + 1 + np.arange(CONTROL_STEPS)) % 28
    control = np.repeat(cycle[steps], 60, axis=1)
    began = time.perf_counter()
    pool.rollout([simulator.model] * ROBOTS, data, simulator.physics, control, chunk_size=1)
    return time.perf_counter() - began


def simulation_rates(cores: int) -> tuple[np.ndarray, np.ndarray]:
    """Rates and busy share of the cores, turn by turn.

    Measured in turn, because the clock of a shared machine drifts by more than what is measured.

    Returns:
        Physics steps per second batched, by one thread in C alone and by all in C alone,
        ``(3, TURNS)``; and the share of the batched time that the cores were busy, ``(TURNS,)``.
    """
    simulator, seconds, busy = Simulator(ROBOTS), [], []
    data = [mujoco.MjData(simulator.model) for _ in range(cores)]
    steps = ROBOTS * CONTROL_STEPS * 60
    one, all_ = mujoco.rollout.Rollout(nthread=0), mujoco.rollout.Rollout(nthread=cores)
    with one, all_:
        for _ in range(TURNS):
            wall, used = batched_seconds(simulator)
            alone = c_only_seconds(simulator, data[:1], one)
            seconds.append((wall, alone, c_only_seconds(simulator, data, all_)))
            busy.append(used / (cores * wall))
    return steps / np.array(seconds).T, np.array(busy)


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


def with_interval(shares: np.ndarray) -> str:
    """Median of the turns and its interval."""
    low, high = bootstrap_interval(shares)
    return f"{np.median(shares):.1%} [{low:.1%}, {high:.1%}]"


def main() -> None:
    """Print the figures."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    (batched, alone, threaded), busy = simulation_rates(cores)
    seconds, torch = import_seconds()
    print(f"cores {cores}")
    print(f"batched, N = {ROBOTS}, 0.5 ms: {np.median(batched):,.0f} physics steps/s")
    print(f"one thread, C only: {np.median(alone):,.0f} steps/s; share of {cores} x that in "
          f"{TURNS} turns: {with_interval(batched / (cores * alone))}")  # fmt: skip
    print(f"{cores} threads, C only, the same share: {with_interval(threaded / (cores * alone))}")
    print(f"batched beside {cores} threads in C: {with_interval(batched / threaded)}")
    print(f"cores busy while batched: {with_interval(busy)}")
    print(f"import of robot and simulator: {seconds:.2f} s, torch imported: {torch}")
    print(f"recurrent PPO with learning: {ppo_rate():,.0f} control steps/s")


if __name__ == "__main__":
    main()
