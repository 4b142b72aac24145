"""Claims besides steps until a fall: what was timed or measured is what is told."""

from __future__ import annotations

import numpy as np
import pytest
from planning_toys import cem_parameters, gradient_parameters, planner
from recording_toys import toy_trial

from cassie_lib import planner_claims as claims
from cassie_lib.provenance import Provenance
from cassie_lib.results import read_results

SOURCE = Provenance("laptop", (0,), ())
pytestmark = pytest.mark.usefixtures("figure_folders")


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (cem_parameters, ("one CEM plan", "N = 64, K = 8, C = 4, tau = 4")),
        (gradient_parameters, ("one Gradient-CEM plan", "N = 16, K = 4, C = 2, G = 10, tau = 4")),
    ],
)
def test_the_least_time_of_a_plan_is_told_with_the_planners_sizes(monkeypatch, make, told):
    times, asked = iter([0.3, 0.2, 0.25, 0.4, 0.5]), []

    def seconds(made):
        asked.append(made)
        return next(times)

    monkeypatch.setattr(claims, "plan_seconds", seconds)
    monkeypatch.setattr(claims.machine, "core_gflops", lambda: 73.4)
    made = planner(make())
    line = claims.record_plan_time("06-plan-time", "section 5.2.1", made, SOURCE)
    (found,) = read_results()
    assert asked == [made] * 5
    assert found["value"] == pytest.approx(200.0)
    assert found["unit"] == "ms"
    assert told[0] in found["claim"]
    assert f"one core of 73 GFLOP/s, {told[1]}" in found["protocol"]
    assert "200 ms" in line


def test_ratios_are_recorded_with_what_they_compare():
    claims.record_gradient_memory("laptop", 50, 1000, 10, 19.9)
    claims.record_cache_gain("laptop", cem_parameters(samples=1000, horizon=10), 30.0)
    cache, memory = read_results()
    assert (memory["value"], cache["value"]) == (19.9, 30.0)
    assert memory["claim"].endswith("of 1000 sequences hold, over that of 50")
    assert "tau = 10" in memory["protocol"]
    assert "N = 1000, C = 1, tau = 10" in cache["protocol"]


def test_drift_is_the_median_of_the_seeds_that_lasted():
    found = toy_trial([228, 228, 228, 50], 228, handover=28)
    steps = 0.03 * np.arange(found.recording.qpos.shape[1])
    found.recording.qpos[..., 1] = steps * np.array([[0.01], [0.02], [-0.06], [5.0]])
    line = claims.record_side_speed("07-side-speed", "Figure 5.7", "drift", found, SOURCE)
    (record,) = read_results()
    assert record["value"] == pytest.approx(0.01)
    assert record["interval"] == pytest.approx([-0.06, 0.02])
    assert "3 of 4 seeds; left positive" in record["reason"]
    assert "drift: +0.010 m/s [-0.060, +0.020]" in line


def test_drift_of_robots_that_all_fall_at_once_is_unknown():
    found = toy_trial([30, 40], 228, handover=28)
    line = claims.record_side_speed("07-side-speed", "Figure 5.7", "drift", found, SOURCE)
    (record,) = read_results()
    assert record["value"] is None
    assert "0 of 2 seeds" in line
