"""Claims of notebooks 06 and 07 about the cost of planning: what was timed is what is told."""

from __future__ import annotations

import pytest
from planning_toys import cem_parameters, gradient_parameters, planner

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
