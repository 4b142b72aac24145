"""Progress lines: how far, how fast, how much longer."""

from __future__ import annotations

import pytest

from cassie_lib import logs


@pytest.fixture
def clock(monkeypatch):
    """A clock that only moves when told to."""
    now = [1000.0]
    monkeypatch.setattr(logs.time, "monotonic", lambda: now[0])
    return now


def test_a_line_every_so_often_and_one_at_the_end(clock, capsys):
    meter = logs.Progress("collect", 2000, every_s=15.0)
    for done in (500, 1000, 1500, 2000):
        clock[0] += 10.0
        meter.update(done, {"falls": 3})
    assert capsys.readouterr().out.splitlines() == [
        "collect 1,000/2,000  50/s  0.3 min left  falls 3",
        "collect 2,000/2,000  50/s  0.0 min left  falls 3",
    ]
    logs.Progress("collect", 1, quiet=True).update(1, {})
    assert not capsys.readouterr().out


def test_a_training_that_goes_on_counts_from_there(clock, capsys):
    tell = logs.step_progress("causal model", 1000)
    for step in range(401, 522):
        tell(step, None)
        clock[0] += 0.5
    assert capsys.readouterr().out == "causal model 521/1,000  2.02/s  4.0 min left\n"
