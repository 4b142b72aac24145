"""Stages long enough to be killed on the way, and a parent that kills them at random moments."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import random
import signal
import time

import psutil
import torch
from pipeline_toys import TINY

from cassie_lib import artifacts, paths, pipeline, planner_pipeline
from cassie_lib.planning import resume
from cassie_lib.presets import CollectionParameters, replace

_SET = CollectionParameters("train", 960, 0.06, seed=1, episode_steps=20, robots=4)
UPDATES, STEPS = 10, 30
STAGES = {
    "expert": lambda: pipeline.reward_only_artifact(
        replace(TINY, reward_only_expert=replace(TINY.expert, total_steps=112 * UPDATES))
    ),
    "data": lambda: pipeline.dataset_artifact(
        replace(TINY, data=replace(TINY.data, train=_SET)), "train"
    ),
    "causal": lambda: pipeline.causal_artifact(
        replace(TINY, causal=replace(TINY.causal, steps=60, dropout=0.1))
    ),
    "gradient_cem": lambda: planner_pipeline.planner_trial(TINY, "gradient_cem").artifact,
}


def run(stage, cache):
    """Compute a stage, or go on with it; called in processes of their own, too."""
    paths.CACHE, paths.DATA = cache, cache / "none"
    torch.set_num_threads(1)
    resume.SAVE_EVERY_S = 0.0
    return STAGES[stage]()


def slow_steps(folder):
    """A computation of many steps, each of which is noted."""
    note = folder / artifacts.WORK / "steps"
    done = int(note.read_text()) if note.exists() else 0
    lines = [f"{step} {step**2}\n" for step in range(STEPS)]
    for step in range(done, STEPS):
        time.sleep(0.03)
        (folder / "log.csv").write_text("".join(lines[: step + 1]))
        temporary = note.with_suffix(".tmp")
        temporary.write_text(str(step + 1))
        temporary.replace(note)


def _progress(cache, stage):
    """Times of the last writes below the unfinished artifacts of a stage."""
    found = {}
    for partial in cache.glob(f"{stage}*.partial"):
        # Unlike glob, walk passes over what vanishes meanwhile.
        for folder, _, names in os.walk(partial):
            for name in names:
                with contextlib.suppress(FileNotFoundError):
                    found[folder, name] = os.stat(os.path.join(folder, name)).st_mtime_ns
    return found


def wait_for_progress(cache, stage, alive, writes):
    """Wait until the stage that runs has written so many times, and a random moment more."""
    seen, before, end = 0, _progress(cache, stage), time.monotonic() + 120
    while seen < writes:
        assert alive(), "it ended before it could be killed"
        assert time.monotonic() < end, "waited in vain"
        now = _progress(cache, stage)
        seen, before = seen + (now != before), now
        time.sleep(0.002)


def kill_at_random(stage, cache, seed):
    """Run a stage in a process of its own and kill it there; returns after its death."""
    chance = random.Random(f"{stage} {seed}")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["kill_toys"])
    process = context.Process(target=run, args=(stage, cache))
    process.start()
    wait_for_progress(cache, stage, process.is_alive, chance.randint(1, 4))
    time.sleep(chance.uniform(0.0, 0.04))
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert process.exitcode == -signal.SIGKILL


def kill_tree(process):
    """Kill a process and all that it has started at once."""
    parent = psutil.Process(process.pid)
    for one in (parent, *parent.children(recursive=True)):
        one.send_signal(signal.SIGKILL)
    process.communicate()
