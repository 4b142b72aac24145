"""Figures carry their data and provenance; results feed the README; intervals and videos."""

from __future__ import annotations

import csv
import json
import re

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from cassie_lib import artifacts, figures, paths, results, video
from cassie_lib.errors import (
    DataError,
    NonFiniteError,
    ParameterError,
    ShapeError,
    UnknownNameError,
)
from cassie_lib.figures import Provenance, bootstrap_interval, record_result, save_figure
from cassie_lib.provenance import CHANGED


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    for name in ("CACHE", "FIGURES", "DATA", "NOTEBOOKS"):
        monkeypatch.setattr(paths, name, tmp_path / name.lower())
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    monkeypatch.setattr(paths, "README", tmp_path / "README.md")
    monkeypatch.delenv("CASSIE_PRESET", raising=False)
    monkeypatch.delenv(CHANGED, raising=False)


@pytest.fixture
def figure():
    with mpl.rc_context():
        figures.use_style()
        made, axes = plt.subplots()
        axes.plot([1.0, 2.0])
        yield made
        plt.close(made)


def luminance(colour):
    return float(np.dot(mpl.colors.to_rgb(colour), [0.299, 0.587, 0.114]))


def test_style_is_one_column_wide_and_lines_differ_without_colour():
    with mpl.rc_context():
        figures.use_style()
        assert mpl.rcParams["figure.figsize"][0] == figures.COLUMN_WIDTH_IN
        cycle = mpl.rcParams["axes.prop_cycle"].by_key()
        assert len({str(line) for line in cycle["linestyle"]}) == len(figures.COLOURS)
        assert min(mpl.rcParams[f"{axis}tick.labelsize"] for axis in "xy") >= 7
    grey = sorted(luminance(colour) for colour in figures.COLOURS.values())
    assert grey[-1] < 0.75, "every line is darker than the paper"


def test_save_figure_writes_pictures_data_and_provenance(figure):
    artifact = artifacts.load_or_compute(
        "walking", {"x": 1}, lambda folder: (folder / "a").write_text("x"), preset="laptop"
    )
    source = Provenance.of("laptop", [0, 1, 2, 5], [artifact])
    found = save_figure(figure, "06-reward", {"step": [0, 1], "reward": [0.1, 0.25]}, source)
    assert {path.name for path in paths.FIGURES.iterdir()} == {
        "06-reward.png", "06-reward.pdf", "06-reward.csv", "06-reward.json",
    }  # fmt: skip
    picture = Image.open(found["png"])
    assert picture.width == pytest.approx(figures.COLUMN_WIDTH_IN * 200, abs=1)
    assert found["pdf"].read_bytes().startswith(b"%PDF")
    assert repr(found) == "saved figures/06-reward .png .pdf .csv .json"
    rows = list(csv.DictReader(found["data"].open()))
    assert [float(row["reward"]) for row in rows] == [0.1, 0.25]
    record = json.loads(found["provenance"].read_text())
    assert record["seeds"] == [0, 1, 2, 5]
    assert record["artifacts"][0]["key"] == artifact.key
    for part in ("preset laptop", "seeds 0-2, 5", f"recomputed {artifact.name}", "commit", "lock"):
        assert part in record["line"]
    assert picture.text["Description"] == record["line"]


def test_the_same_figure_gives_the_same_files(figure):
    source = Provenance("laptop", (0,), commit="c", lock="l")
    first = {k: p.read_bytes() for k, p in save_figure(figure, "f", {"x": [1]}, source).items()}
    again = {k: p.read_bytes() for k, p in save_figure(figure, "f", {"x": [1]}, source).items()}
    assert first == again


def test_smoke_and_changed_runs_never_touch_the_committed_figures(figure, monkeypatch):
    save_figure(figure, "f", {"x": [1]}, Provenance.of("smoke"))
    monkeypatch.setenv(CHANGED, '{"SEEDS": 3}')
    source = Provenance.of("laptop")
    assert "changed SEEDS=3" in source.line()
    save_figure(figure, "f", {"x": [1]}, source)
    save_figure(figure, "f", {"x": [1]}, Provenance("thesis", changed={}))
    assert sorted(path.name for path in paths.FIGURES.iterdir()) == ["thesis"]
    monkeypatch.setenv(CHANGED, "[")
    with pytest.raises(ParameterError, match="expected a JSON object"):
        Provenance.of("laptop")


def test_provenance_says_what_overrode_the_preset_and_what_was_noticed(monkeypatch):
    monkeypatch.setenv("CASSIE_PRESET", "smoke")
    line = str(Provenance.of("smoke", 3))
    assert "set by CASSIE_PRESET" in line
    assert "mean nothing" in line
    item = artifacts.Artifact("data", "0" * 64, paths.DATA, {}, True, ("made by other code",))
    assert "NOTICE: made by other code" in Provenance.of("smoke", 3, [item, item]).line()
    assert figures.provenance_line("smoke", 3) == line


def test_series_of_different_lengths_become_one_long_table():
    data = {"cem": {"step": [0, 1], "reward": [1.0, 0.5]}, "still": {"step": [0], "level": [0.9]}}
    rows = list(csv.reader(figures.write_plotted_data(paths.FIGURES, "f", data).open()))
    assert rows == [
        ["series", "step", "reward", "level"],
        ["cem", "0", "1", ""], ["cem", "1", "0.5", ""], ["still", "0", "", "0.9"],
    ]  # fmt: skip


def test_arrays_of_more_axes_become_npz_and_replace_a_former_table():
    figures.write_plotted_data(paths.FIGURES, "f", {"x": [1, 2]})
    path = figures.write_plotted_data(paths.FIGURES, "f", {"map": np.eye(3), "x": [1.0]})
    with np.load(path, allow_pickle=False) as stored:
        assert np.array_equal(stored["map"], np.eye(3))
    assert [item.name for item in paths.FIGURES.iterdir()] == ["f.npz"]


@pytest.mark.parametrize("data", [{}, {"x": [1], "y": [1, 2]}])
def test_figures_without_sound_data_are_refused(figure, data):
    with pytest.raises(ShapeError):
        save_figure(figure, "f", data, Provenance.of("smoke"))


def test_figure_names_are_checked(figure):
    with pytest.raises(ParameterError, match=r"'\.\./x'"):
        save_figure(figure, "../x", {"x": [1]}, Provenance.of("smoke"))


def result(claim_id="06-reward", preset="laptop", **changes):
    known = {
        "figure": "Figure 5.6", "value": 0.8, "interval": (0.7, 0.9), "seeds": 10,
        "protocol": "median", "wall_time_s": 90.0, "thesis_value": 0.6, "verdict": "better",
    }  # fmt: skip
    return record_result(claim_id, preset=preset, **{**known, **changes})


def test_results_are_merged_by_claim_and_sorted():
    result("07-steps", value=500.0)
    result("06-reward", value=0.5)
    result("06-reward", value=0.81)
    stored = json.loads((paths.FIGURES / "results.json").read_text())
    assert [(item["id"], item["value"]) for item in stored] == [
        ("06-reward", 0.81), ("07-steps", 500.0),
    ]  # fmt: skip
    result("06-reward", preset="smoke", value=0.1)
    assert results.read_results("laptop") == stored
    shown = repr(result("08-steps", value=3210.0, interval=(999, 12345), unit="steps"))
    assert shown.startswith("08-steps: 3210 steps [999, 12345], 10 seeds; thesis (Figure 5.6) 0.6")


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"claim_id": "reward"}, ParameterError),
        ({"verdict": "great"}, UnknownNameError),
        ({"preset": "big"}, UnknownNameError),
        ({"value": float("nan")}, NonFiniteError),
        ({"interval": (0.9, 0.7)}, ParameterError),
    ],
)
def test_bad_results_are_refused(changes, error):
    with pytest.raises(error):
        result(**changes)
    assert not (paths.FIGURES / "results.json").exists()


README = """before
<!-- results:begin -->old<!-- results:end -->
<!-- replicates:begin -->old<!-- replicates:end -->
after
"""


def test_readme_tables_are_written_between_their_marks():
    paths.NOTEBOOKS.mkdir()
    (paths.NOTEBOOKS / "06_cem.ipynb").write_text("{}")
    executed = paths.FIGURES / "executed" / "06_cem.ipynb"
    executed.parent.mkdir(parents=True)
    executed.write_text('{"metadata": {"papermill": {"duration": 120}}}')
    result(claim="reward | step", reason="model | gap", unit="1")
    result("07-steps", value=None, interval=None, thesis_value="about 126", seeds=1)
    paths.README.write_text(README)
    assert figures.main(["readme"]) == 0
    text = paths.README.read_text()
    assert "old" not in text
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    row = next(line for line in text.splitlines() if "reward" in line)
    assert "[06](figures/executed/06_cem.ipynb)" in row
    assert "2.0 / 1.5" in row
    assert "0.8 1 [0.7, 0.9], 10 seeds" in row
    assert len(re.split(r"(?<!\\)\|", row)) == 10
    assert not figures.update_readme(), "nothing changes the second time"


def test_damaged_results_and_readme_are_reported(capsys):
    assert "make figures" in figures.results_table()
    paths.README.write_text("no marks")
    assert figures.main(["readme"]) == 1
    assert "lacks a mark" in capsys.readouterr().err
    assert figures.main(["other"]) == 2
    paths.FIGURES.mkdir()
    (paths.FIGURES / "results.json").write_text("[{")
    with pytest.raises(DataError, match=r"results\.json cannot be read"):
        result()


def test_bootstrap_interval_has_its_coverage_and_its_seed():
    assert bootstrap_interval([3.0]) == (3.0, 3.0)
    values = np.random.default_rng(1).normal(size=40)
    assert bootstrap_interval(values) == bootstrap_interval(values)
    low, high = bootstrap_interval(values, np.mean)
    exact = 1.96 * values.std() / np.sqrt(40)
    assert low == pytest.approx(values.mean() - exact, abs=0.05)
    assert high == pytest.approx(values.mean() + exact, abs=0.05)
    narrow = bootstrap_interval(values, np.mean, level=0.5)
    assert low < narrow[0] < narrow[1] < high
    for bad, error in (([], ShapeError), ([[1.0]], ShapeError), ([np.inf], NonFiniteError)):
        with pytest.raises(error):
            bootstrap_interval(bad)
    with pytest.raises(ParameterError):
        bootstrap_interval(values, level=95)


@pytest.fixture
def frames():
    pictures = np.zeros((12, 61, 81, 3), np.uint8)
    for index, picture in enumerate(pictures):
        picture[20:40, 4 * index : 4 * index + 20] = (200, 80, 20)
    return pictures


def test_videos_are_small_and_play(frames, tmp_path):
    shown = video.show_video(frames, 33.3)
    assert shown.data.startswith("<video")
    assert len(shown.data) < 20_000
    content = Image.open(video.write_gif(frames, tmp_path / "walk.gif", 33.3, width=40))
    assert content.n_frames == 12
    assert content.width == 40
    assert content.info["duration"] == 30


def test_without_an_encoder_a_gif_is_shown(frames, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    shown = video.show_video(frames, 20)
    assert "data:image/gif" in shown.data


@pytest.mark.parametrize(
    ("bad", "fps", "error"),
    [
        (np.zeros((3, 4, 4), np.uint8), 30, ShapeError),
        (np.zeros((3, 4, 4, 3)), 30, ShapeError),
        (np.zeros((0, 4, 4, 3), np.uint8), 30, ShapeError),
        (np.zeros((3, 4, 4, 3), np.uint8), 0, ParameterError),
    ],
)
def test_bad_frames_are_refused(bad, fps, error):
    with pytest.raises(error):
        video.show_video(bad, fps)
