"""Planned episodes that are killed: the rest comes out as if nothing had happened."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from planning_toys import CONTEXT, DoubleIntegrator, cem_parameters, gradient_parameters, planner
from test_planning_control import Lazy, drive

from cassie_lib.errors import CheckpointError
from cassie_lib.planning import resume
from cassie_lib.planning.control import PlannerController
from cassie_lib.planning.resume import CHECKPOINT, ResumableController

STEPS = 14
PLANNERS = {
    "CEM with nothing to remember": lambda: cem_parameters(mean="zero"),
    "CEM with elites and its last plan": lambda: cem_parameters(
        mean="warm", elite_reuse=0.5, noise_colour=2.0, include_mean=True
    ),
    "Gradient-CEM": lambda: gradient_parameters(mean="warm", keep_best=True),
}


@pytest.fixture(autouse=True)
def every_step(monkeypatch):
    monkeypatch.setattr(resume, "SAVE_EVERY_S", 0.0)


def resumable(folder, parameters, expert=None, identity="toy"):
    model = DoubleIntegrator()
    return model, ResumableController(planner(parameters, model), expert, folder, identity)


@pytest.mark.parametrize("expert", [None, Lazy], ids=["padded", "handover"])
@pytest.mark.parametrize("name", PLANNERS)
def test_a_resume_ends_with_the_same_bits_and_plans_nothing_twice(tmp_path, name, expert):
    parameters = PLANNERS[name]()

    def driver():
        return expert() if expert else None

    whole = PlannerController(planner(parameters), driver())
    _, expected = drive(whole, STEPS)
    planned = STEPS - (CONTEXT if expert else 0)
    for stop in (6, 7, 11):
        _, some = drive(resumable(tmp_path, parameters, driver())[1], stop)
        assert torch.equal(some, expected[:, :stop])
    model, last = resumable(tmp_path, parameters, driver())
    _, actions = drive(last, STEPS)
    assert torch.equal(actions, expected)
    single, alone = DoubleIntegrator(), parameters
    drive(PlannerController(planner(alone, single), driver()), STEPS)
    assert model.predictions == single.predictions * (STEPS - 11) / planned
    for column, same in zip(last.log()._asdict().items(), whole.log(), strict=True):
        if column[0] != "plan_time_s":
            np.testing.assert_array_equal(column[1], same, err_msg=column[0])
    assert np.isfinite(last.log().plan_time_s[-planned:]).all(), "times of both sessions"


def test_what_the_expert_remembers_is_not_saved(tmp_path):
    drive(resumable(tmp_path, cem_parameters(), Lazy())[1], CONTEXT)
    assert not (tmp_path / CHECKPOINT).exists()
    drive(resumable(tmp_path, cem_parameters(), Lazy())[1], CONTEXT + 1)
    assert (tmp_path / CHECKPOINT).exists()


@pytest.mark.parametrize(
    ("kept", "other"),
    [
        ({}, {"count": 3}),
        ({}, {"seed": 4}),
        ({"identity": "toy"}, {"identity": "another protocol"}),
    ],
    ids=["robots", "seed", "protocol"],
)
def test_other_episodes_are_refused(tmp_path, kept, other):
    def start(identity="toy", **options):
        drive(resumable(tmp_path, cem_parameters(), identity=identity)[1], 3, **options)

    start(**kept)
    with pytest.raises(CheckpointError, match="belongs to run .*: expected"):
        start(**other)
    start(**kept)


def test_a_long_trial_tells_how_far_it_is(tmp_path, capsys):
    parameters = cem_parameters()

    def told(stop):
        made = ResumableController(planner(parameters), None, tmp_path, "toy", STEPS)
        drive(made, stop)
        return capsys.readouterr().out.splitlines()

    first, second = told(4), told(STEPS)
    assert first[3].startswith("CEM of 2 robots 4/14")
    assert first[3].endswith("planned for 2")
    assert len(second) == STEPS - 4, "what is replayed is not told again"
    assert second[-1].startswith("CEM of 2 robots 14/14")
    assert "0.0 min left" in second[-1]


def test_other_physics_is_refused(tmp_path):
    drive(resumable(tmp_path, cem_parameters())[1], 5)
    with pytest.raises(CheckpointError, match="rounds in another way.*remove it to start over"):
        drive(resumable(tmp_path, cem_parameters())[1], 9, height=np.nextafter(1.0, 2.0, dtype="f"))


def test_a_damaged_checkpoint_is_refused(tmp_path):
    drive(resumable(tmp_path, cem_parameters())[1], 5)
    path = tmp_path / CHECKPOINT
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.raises(CheckpointError, match="cannot be read.*remove it to start over"):
        drive(resumable(tmp_path, cem_parameters())[1], 9)
