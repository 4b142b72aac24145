"""What the README names exists."""

from __future__ import annotations

import re

import pytest

from cassie_lib import paths, readme, results

TEXT = paths.README.read_text(encoding="utf-8")
NOTATION = TEXT.split("## Notation")[1].split("\n## ")[0]
SOURCE = "\n".join(path.read_text(encoding="utf-8") for path in paths.PACKAGE.rglob("*.py"))


@pytest.mark.parametrize("name", readme.TABLES)
def test_the_tables_are_the_generated_ones(name):
    _, block, rest = readme.split_at_marks(TEXT, name)
    assert block.strip() == readme.TABLES[name]().strip(), "python -m cassie_lib.figures readme"
    assert f"<!-- {name}:begin -->" not in rest


def test_every_claim_is_still_made():
    """A record whose claim is no longer in any source would stay in the table for ever."""
    sources = [*paths.NOTEBOOKS.glob("*.ipynb"), *paths.PACKAGE.rglob("*.py")]
    text = "".join(path.read_text(encoding="utf-8") for path in sources)
    for record in results.read_results("laptop"):
        # Some claims are made once per predicted step.
        assert re.sub(r"\d+$", "", record["id"]) in text, record["id"]


def test_medians_by_round_are_the_stored_ones():
    """Rounded on the first screen."""
    records = {item["id"]: item for item in results.read_results("laptop")}
    reason = records["08-gain-without-wide-data"]["reason"]
    medians = reason.split("medians by round: ")[1].split("; control ")[0].split(", ")
    before, one, two = (int(float(median) + 0.5) for median in medians)
    screen = " ".join(TEXT.split("## Results")[0].split())
    assert f"lasts {before} steps, {one} after one round and {two} after two" in screen


def test_medians_at_the_zero_mean_are_the_stored_ones():
    records = {item["id"]: item for item in results.read_results("laptop")}
    reason = records["08-gain-without-wide-data-zero-mean"]["reason"]
    shown = re.search(r"before and after: (\S+), (\S+); control ([\d.]+)", reason)
    before, after, control = shown.groups()
    gain = records["08-gain-of-the-data-zero-mean"]
    low, high = gain["interval"]
    screen = " ".join(TEXT.split("## Results")[0].split())
    after_two = "after two rounds, as many as in the thesis,"
    assert f"median of {before} steps; {after_two} {after} " in screen
    assert f"lasts {control}; seed by seed the data are worth {gain['value']:g} steps" in screen
    assert f"steps [{low:g}, {high:g}]" in screen


def test_steps_of_both_planners_at_the_zero_mean_are_the_stored_ones():
    records = {item["id"]: item for item in results.read_results("laptop")}
    cem, gradient = (
        records[name]["value"]
        for name in ("06-cem-steps-zero-mean", "07-gradient-cem-steps-zero-mean")
    )
    screen = " ".join(TEXT.split("## Results")[0].split())
    assert f"With CEM they fall after {cem:g} steps (thesis: 101)" in screen
    assert f"With Gradient-CEM they stay up for {gradient:g} (126)" in screen


def test_drift_is_the_stored_one():
    """For Gradient-CEM and the long walk on the first screen."""
    records = {item["id"]: item for item in results.read_results("laptop")}
    speeds = [records[f"{number}-side-speed"]["value"] for number in ("07", "08")]
    screen = " ".join(TEXT.split("## Results")[0].split())
    here, long = (f"{abs(speed):.3f}" for speed in speeds)
    assert f"drifts to the side by {here} m/s here and by {long} m/s in the 92 s" in screen


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(\w+)`", NOTATION))))
def test_code_names_of_the_notation_table_exist(name):
    assert re.search(rf"\b{name}\b", SOURCE)


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`([\w/]+\.py)`", TEXT))))
def test_files_of_the_readme_exist(name):
    assert (paths.ROOT / name).exists() or (paths.PACKAGE / name).exists()


def test_make_targets_and_options_exist():
    makefile = (paths.ROOT / "Makefile").read_text(encoding="utf-8")
    for target in set(re.findall(r"make (figures|test|setup|gallery)", TEXT)):
        assert re.search(rf"^{target}:", makefile, re.M)
    for option in set(re.findall(r"make \w+ ([A-Z_]+)=", TEXT)):
        assert re.search(rf"^{option} \?=", makefile, re.M)


def test_the_symbols_of_the_thesis_are_all_there():
    for symbol in (
        "s_t",
        "a_t",
        "H",
        "τ",
        "N, K, C",
        "G",
        "φ",
        "M",
        "ψ",
        "λ",
        "w",
        "γ",
        "μ0",
        "π*",
        "ρ",
    ):
        assert re.search(rf"^\| [^|]*{re.escape(symbol)}", NOTATION, re.M), symbol


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)\)", TEXT):
        if not target.startswith(("figures", "data")):  # written by make figures
            assert (paths.ROOT / target).exists(), target
