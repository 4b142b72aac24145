"""Verdicts of notebooks 06 to 08: better, reproduced or not, and nothing better than it is."""

from __future__ import annotations

import json

import numpy as np
import pytest
from recording_toys import toy_trial

from cassie_lib import artifacts, paths
from cassie_lib.errors import ParameterError, ShapeError
from cassie_lib.plots import planner_measures as measures
from cassie_lib.plots import planner_numbers as numbers
from cassie_lib.provenance import CHANGED, Provenance
from cassie_lib.robot.schema import PERIOD

HANDOVER, STEPS = 28, 228
THESIS = 100


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    for name in ("CACHE", "FIGURES", "DATA"):
        monkeypatch.setattr(paths, name, tmp_path / name.lower())
    monkeypatch.delenv(CHANGED, raising=False)


@pytest.fixture
def provenance():
    made = [
        artifacts.load_or_compute(
            "walking", {"x": x}, lambda folder: (folder / "a").write_text("x"), preset="laptop"
        )
        for x in (1, 2)
    ]
    return Provenance.of("laptop", 4, made)


def trial(planner_steps, **options):
    lengths = HANDOVER + np.asarray(planner_steps)
    return toy_trial(lengths, STEPS, handover=HANDOVER, **options)


def stored():
    return json.loads((paths.FIGURES / "results.json").read_text())


@pytest.mark.parametrize(
    ("planner_steps", "lift_m", "verdict", "reason"),
    [
        ([150, 160, 170, 200], 0.1, "better", "1 of 4 seeds upright"),
        ([80, 90, 110, 120], 0.1, "reproduced", "0 of 4 seeds upright"),
        ([30, 40, 50, 60], 0.1, "not reproduced", "fell earlier"),
        # Standing lasts as long as you like, but it is no walk.
        ([200, 200, 200, 200], 0.04, "not comparable", "does not lift both feet"),
        # Short and without a step: that it fell early is what counts.
        ([30, 40, 50, 60], 0.0, "not reproduced", "fell earlier"),
    ],
)
def test_verdict_follows_from_interval_and_steps(planner_steps, lift_m, verdict, reason):
    found = numbers.against_thesis(trial(planner_steps, lift_m=lift_m), THESIS)
    assert found.verdict == verdict
    assert reason in found.reason
    assert "probably includes a prefix" in found.reason
    assert found.median == np.median(planner_steps)
    assert min(planner_steps) <= found.interval[0] <= found.median <= found.interval[1]


def test_an_interval_that_just_reaches_the_thesis_reproduces_it_and_no_more():
    same = trial([THESIS] * 4)
    assert numbers.against_thesis(same, THESIS).verdict == "reproduced"
    assert numbers.against_thesis(same, THESIS - 1).verdict == "better"
    assert numbers.against_thesis(same, THESIS + 1).verdict == "not reproduced"


def test_a_trial_that_ended_upright_before_the_thesis_fell_proves_nothing():
    found = numbers.against_thesis(trial([200] * 4), 500)
    assert found.verdict == "not comparable"
    assert "ended after 200 steps" in found.reason
    assert "fell earlier" not in found.reason


def test_stepping_counts_cycles_in_which_both_feet_rise():
    walks = trial([200, 200, 20])
    share = measures.stepping_share(walks)
    np.testing.assert_allclose(share[:2], 1.0)
    assert np.isnan(share[2]), "no whole cycle"
    height = walks.recording.foot_height
    # The right foot stays down in the second of seven cycles of one episode.
    height[0, HANDOVER + PERIOD : HANDOVER + 2 * PERIOD, 1] = 0.0
    assert measures.stepping_share(walks)[0] == pytest.approx(6 / 7)
    # What the expert does before the hand-over does not count.
    height[1, :HANDOVER] = 0.0
    assert measures.stepping_share(walks)[1] == 1.0


def test_record_holds_median_interval_seeds_verdict_and_time(provenance):
    found = trial([80, 90, 110, 120])
    line = numbers.record_steps("06-toy", "Figure 5.6", "toy steps", found, THESIS, provenance)
    (record,) = stored()
    expected = numbers.against_thesis(found, THESIS)
    assert record["value"] == 100.0
    assert tuple(record["interval"]) == expected.interval
    assert (record["seeds"], record["thesis_value"], record["unit"]) == (4, THESIS, "steps")
    assert record["verdict"] == expected.verdict
    passed = int(measures.planner_report(found).walks.sum())
    assert record["reason"] == f"{passed} of 4 pass the walking report; {expected.reason}"
    assert record["protocol"] == "a toy"
    time = provenance.from_nothing_s
    assert record["wall_time_s"] == pytest.approx(time, abs=0.05)
    assert line.startswith("toy steps: thesis 100 in all, here 100 by the planner alone")
    assert "reproduced" in line


@pytest.mark.parametrize(
    ("before", "after", "verdict"),
    [
        ([20, 40, 50, 60], [60, 70, 90, 95], "reproduced"),
        ([20, 40, 50, 60], [10, 40, 60, 90], "not reproduced"),
        ([200] * 4, [200] * 4, "not comparable"),
        ([200] * 4, [90] * 4, "not reproduced"),
        ([200] * 4, [90, 200, 200, 200], "not reproduced"),
    ],
)
def test_gain_compares_the_same_seeds(before, after, verdict, provenance):
    first, later = trial(before), trial(after)
    gain = numbers.improvement(first, later)
    assert gain[0] == np.median(np.subtract(after, before))
    assert gain[1] <= gain[0] <= gain[2]
    line = numbers.record_gain("08-toy", "Figure 5.8", "gain", first, later, provenance)
    (record,) = stored()
    assert (record["value"], *record["interval"]) == gain
    assert record["verdict"] == verdict
    why = record["reason"].removesuffix("median of the seeds' own differences")
    assert bool(why) == (verdict != "reproduced")
    assert record["reason"] in line
    assert record["thesis_value"] == "126 to 155"


def test_notes_stand_in_the_reason(provenance):
    found = trial([80, 90, 110, 120])
    numbers.record_steps("06-toy", "Figure 5.6", "x", found, THESIS, provenance, "a note")
    numbers.record_gain("07-toy", "Figure 5.7", "x", found, found, provenance,
                        thesis="101 to 126", note="another note")  # fmt: skip
    steps, gain = stored()
    assert "; a note; " in steps["reason"]
    assert gain["reason"].endswith("; another note")
    assert gain["thesis_value"] == "101 to 126"


def test_a_gain_that_the_thesis_has_no_number_for_has_no_verdict_either(provenance):
    numbers.record_gain("08-toy", "Figure 5.8", "x", trial([20, 40, 50]), trial([60, 70, 90]),
                        provenance, thesis=None)  # fmt: skip
    (record,) = stored()
    assert (record["thesis_value"], record["verdict"]) == (None, "not comparable")
    assert record["value"] == 40


@pytest.mark.parametrize(
    ("control", "verdict"),
    [([25, 45, 55, 60], "reproduced"), ([60, 70, 90, 95], "not comparable"),
     ([80, 90, 99, 99], "not comparable")],
)  # fmt: skip
def test_a_gain_that_the_control_reaches_as_well_is_not_reproduced(control, verdict, provenance):
    line = numbers.record_gain("08-toy", "Figure 5.8", "x", trial([20, 40, 50, 60]),
                               trial([60, 70, 90, 95]), provenance,
                               control=trial(control))  # fmt: skip
    (record,) = stored()
    assert record["verdict"] == verdict
    assert ("the control gains as much" in record["reason"]) == (verdict == "not comparable")
    assert record["value"] == 37.5, "the gain itself stays"
    assert verdict in line


@pytest.mark.parametrize(
    ("steps", "lift_m", "told"), [(90, 0.0, True), (90, 0.1, False), (PERIOD - 2, 0.0, False)]
)
def test_a_gain_says_when_nobody_steps_and_not_when_no_cycle_could_tell(
    steps, lift_m, told, provenance
):
    later = trial([steps] * 4, lift_m=lift_m)
    numbers.record_gain("08-toy", "Figure 5.8", "x", trial([9] * 4), later, provenance)
    (record,) = stored()
    assert ("no seed lifts both feet in any cycle" in record["reason"]) == told


def test_gain_refuses_other_seeds():
    with pytest.raises(ShapeError, match="trials of 2 and 3 seeds: expected the same seeds"):
        numbers.improvement(trial([20, 40]), trial([20, 40, 60]))


def test_table_cuts_trials_of_different_length_to_the_same():
    trials = {"long": trial([50, 150, 200]), "padded": toy_trial([100, 120, 150], 150)}
    table = numbers.steps_table(trials, limit=128)
    # 128 control steps, of which the expert drives 28 in the first trial and none in the second.
    assert table["median planner-only steps"].tolist() == ["100", "120"]
    assert table["least, greatest"].tolist() == ["50, 100", "100, 128"]
    assert table["still upright at its end"].tolist() == ["2/3 after 100", "1/3 after 128"]
    whole = numbers.steps_table(trials).loc["long"]
    assert whole["median planner-only steps"] == "150"
    assert whole["still upright at its end"] == "1/3 after 200"
    assert whole["cycles with both feet lifted 5 cm"] == "100%"
    short = numbers.steps_table({"short": trial([5, 9])})
    assert short["cycles with both feet lifted 5 cm"].tolist() == ["–"]


def test_side_speed_is_of_whole_cycles_that_the_planner_drove():
    found = trial([200, 60, 55])
    y = found.recording.qpos[..., 1]
    # The expert's steps go the other way, and a sway comes back after each cycle.
    y[:] = -0.5 * 0.03 * np.arange(y.shape[1])
    driven = np.arange(y.shape[1] - HANDOVER)
    drift, sway = 0.04 * 0.03 * driven, 0.05 * np.sin(2 * np.pi * driven / PERIOD)
    y[:, HANDOVER:] = y[:, [HANDOVER]] + drift + sway
    speed = measures.side_speed(found)
    np.testing.assert_allclose(speed, [0.04, 0.04, np.nan])
    y[:, HANDOVER + 100 :] += 9.0
    np.testing.assert_allclose(measures.side_speed(found, limit=128)[:2], 0.04)
    assert measures.side_speed(found)[0] > 1.0
    table = numbers.steps_table({"long": found, "short": trial([9, 30])}, limit=128)
    assert table["sideways speed, m/s"].tolist() == ["+0.040", "–"]


def test_report_leaves_out_what_the_expert_did():
    report = measures.planner_report(trial([200]))
    # Lifts 0.1 m; before the hand-over and in a padded start's first cycles nothing counts.
    assert report["least foot lift"].values == [pytest.approx(0.1)]
    padded = toy_trial([200], 200)
    padded.recording.foot_height[:, : 2 * PERIOD] = 0.0
    assert measures.planner_report(padded)["least foot lift"].values == [pytest.approx(0.1)]
    with pytest.raises(ParameterError, match="expected at least"):
        measures.planner_report(toy_trial([60], 60, handover=28))


def test_median_episode_and_target():
    found = trial([150, 20, 90, 60])
    assert measures.median_episode(found) == 2, "the upper one of the two in the middle"
    assert numbers.target_line(found, 75).endswith("reached with 75")
    assert "NOT reached with 75" in numbers.target_line(found, 76)
