"""The README's section on extending the library: every block runs and does what is said of it."""

from __future__ import annotations

import re

import numpy as np
import pytest
from dynamics_toys import oscillators

from cassie_lib import gait, paths
from cassie_lib.dynamics.model import DynamicsModel
from cassie_lib.dynamics.windows import Transitions
from cassie_lib.planning.stage_reward import WalkingReward

TEXT = paths.README.read_text(encoding="utf-8")
SECTION = TEXT.split("\n## Extending it\n")[1].split("\n## ")[0]
#: What is added, as the bold words before each block say -> its code.
BLOCKS = dict(re.findall(r"\*\*An? ([a-z ]+)\*\*.*?```python\n(.*?)```", SECTION, re.S))


def run(name):
    """Names that a block leaves behind, run as a script of its own would be."""
    namespace = {"__name__": "__main__"}
    exec(compile(BLOCKS[name], f"README.md, {name}", "exec"), namespace)
    return namespace


def test_all_three_are_shown_and_nothing_else_is():
    assert sorted(BLOCKS) == ["dynamics model", "gait", "planner"]
    assert TEXT.count("```python") == len(BLOCKS)


@pytest.mark.parametrize("name", sorted(BLOCKS))
def test_it_is_short(name):
    lines = [line for line in BLOCKS[name].splitlines() if line.strip()]
    assert len(lines) < 30
    assert max(map(len, lines)) <= 100


def test_gait_is_a_reference_that_the_reward_knows(monkeypatch, capsys):
    monkeypatch.setattr(gait, "GAITS", dict(gait.GAITS))
    backward = run("gait")["backward"]
    scores = dict(re.findall(r"against (\S+): (\S+)", capsys.readouterr().out))
    assert float(scores["walk-backward"]) > float(scores["walk"]) + 0.02
    assert "walk-backward" in gait.GAITS
    # The pelvis goes where its velocity says, also from the last phase to the first.
    step = np.diff(backward.qpos[:, 0])
    np.testing.assert_allclose(step, 0.03 * backward.speed_mps, atol=1e-9)
    np.testing.assert_allclose(backward.qvel[:, 0], backward.speed_mps, atol=1e-6)
    motors = backward.motor_position
    slope = (np.roll(motors, -1, 0) - np.roll(motors, 1, 0)) / 0.06
    forward = gait.walk(0.3).motor_position
    np.testing.assert_allclose(slope[5], -((forward[24] - forward[22]) / 0.06), atol=1e-9)
    # A foot that carries load is on the floor, and planners can walk after the gait.
    assert (backward.foot_height_m[backward.in_contact] < 1e-6).all()
    assert WalkingReward(backward).gait is backward


def test_planner_earns_more_than_doing_nothing(capsys):
    run("planner")
    found = re.findall(r"(\w+): (\d+) steps, Eq 3.10 (\S+)", capsys.readouterr().out)
    (first, planned, reward), (second, still, nothing) = found
    assert (first, second) == ("PlannerController", "StandStill")
    assert float(reward) > float(nothing) + 0.01
    assert int(planned) > int(still)


def test_dynamics_model_beats_no_change_and_fits_the_interface():
    found = run("dynamics model")
    score = found["score"]
    assert (score.relative < 0.2 * score.relative_no_change).all()
    assert isinstance(found["train"], Transitions)
    assert isinstance(found["Linear"](oscillators()), DynamicsModel)
