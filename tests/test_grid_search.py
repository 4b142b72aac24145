"""The grid of Appendix A.1: its points, their numbers, what is really run, and its jobs."""

from __future__ import annotations

import subprocess
import sys

import pytest

from cassie_lib import grid_search, paths, presets
from cassie_lib.errors import ParameterError
from cassie_lib.presets import replace

THESIS = presets.get_preset("thesis")


def test_the_thesis_grid_has_243_points_and_holds_the_thesis_choice():
    points = grid_search.grid_points(THESIS)
    assert len(points) == 243
    assert [point.number for point in points] == list(range(243))
    assert len({point.values for point in points}) == 243
    for preset in (THESIS, presets.get_preset("laptop")):
        assert grid_search.base_point(preset).values == (128, 30, 1e-4, 0.1, 1e-2)


@pytest.mark.parametrize("name", ["smoke", "laptop", "thesis"])
def test_one_factor_at_a_time_changes_one_factor_each(name):
    preset = presets.get_preset(name)
    base = grid_search.base_point(preset)
    points = grid_search.one_factor_points(preset)
    seeds = preset.grid.base_seeds
    assert [point.seed for point in points[:seeds]] == list(range(seeds))
    changed = [point.changed(base) for point in points]
    assert changed[:seeds] == [{}] * seeds
    assert sorted(name for found in changed[seeds:] for name in found) == sorted(
        name for name in grid_search.FACTORS for _ in getattr(preset.grid, name)[1:]
    )


def test_a_point_is_the_preset_with_the_budget_of_the_grid():
    preset = presets.get_preset("laptop")
    point = grid_search.grid_points(preset)[-1]
    found = grid_search.point_parameters(preset, point)
    assert (found.batch_size, found.context, found.weight_decay) == (256, 50, 1e-1)
    assert found.epochs == preset.grid.epochs
    assert found.max_minutes == 0.0, "a point must not depend on how busy the machine is"
    assert found.model_size == preset.transformer.model_size


def test_a_grid_without_the_choice_is_refused():
    lacking = replace(THESIS, grid=replace(THESIS.grid, dropout=(0.2, 0.3)))
    with pytest.raises(ParameterError, match="grid lacks"):
        grid_search.base_point(lacking)


def test_bad_command_lines_are_named(capsys):
    assert grid_search.main(["point", "243", "--preset", "thesis"]) == 1
    assert "expected 0 to 242" in capsys.readouterr().err
    assert grid_search.main(["list", "--subset", "half"]) == 1
    assert "expected all or one_factor" in capsys.readouterr().err


def test_the_whole_grid_makes_243_jobs(tmp_path):
    pytest.importorskip("snakemake")
    command = [
        sys.executable, "-m", "snakemake", "-s", str(paths.NOTEBOOKS / "grid.smk"), "-n", "-q",
        "rules", "--cores", "1", "--directory", str(tmp_path), "--nolock",
        "--config", "preset=thesis", "subset=all",
    ]  # fmt: skip
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    counts = dict(line.split() for line in found.stdout.splitlines() if len(line.split()) == 2)
    assert counts["point"] == "243"
