"""What the batch runner asks of Snakemake and what it does afterwards, without running any."""

from __future__ import annotations

import json
import os
from types import SimpleNamespace

import pytest
from artifact_toys import Parameters, damage_empty, make

from cassie_lib import batch, paths
from cassie_lib.artifacts import recompute
from cassie_lib.artifacts.ledger import computed_since
from cassie_lib.artifacts.side_by_side import PROCESSES
from cassie_lib.stamps import stamp_file, write_stamp


@pytest.fixture
def house(tmp_path, monkeypatch, artifact_folders):
    """Notebooks 01 and 02, each with a stamp, of a repository of its own."""
    for name in ("ROOT", "NOTEBOOKS", "FIGURES"):
        monkeypatch.setattr(paths, name, tmp_path / name.lower())
    monkeypatch.delenv("CASSIE_PRESET", raising=False)
    paths.NOTEBOOKS.mkdir()
    for number in ("01", "02"):
        (paths.NOTEBOOKS / f"{number}_toy.ipynb").write_text("{}")
        write_stamp(stamp_file("smoke", number), "hash", [])
    return tmp_path


@pytest.fixture
def commands(monkeypatch):
    """Commands that would be run; ``code`` is what they end with."""
    found = SimpleNamespace(calls=[], code=0, finished=[], environment={})

    def pretend(command, check, env):
        found.calls.append(command)
        found.environment = env
        return SimpleNamespace(returncode=found.code)

    monkeypatch.setattr(batch, "subprocess", SimpleNamespace(run=pretend))
    monkeypatch.setattr(batch, "_finish", found.finished.append)
    return found


def config(command):
    """Configuration handed to Snakemake."""
    return dict(item.split("=", 1) for item in command[command.index("--config") + 1 :])


def test_figures_ask_for_all_notebooks_of_a_preset(house, commands, capsys):
    arguments = ["figures", "--preset", "smoke", "--jobs", "3", "--", "--executor", "slurm"]
    assert batch.main(arguments) == 0
    (command,) = commands.calls
    assert config(command) == {"preset": "smoke", "only": "01+02"}
    assert command[command.index("--cores") + 1] == "3"
    # Further arguments come before the configuration, which takes all that follows.
    assert command.index("slurm") < command.index("--config")
    assert capsys.readouterr().out == "up to date: 01_toy, 02_toy\n"
    assert commands.finished == ["smoke"]
    assert all(stamp_file("smoke", number).exists() for number in ("01", "02"))


def test_notebooks_at_a_time_share_the_cores(house, commands, monkeypatch):
    monkeypatch.delenv(PROCESSES, raising=False)
    assert batch.main(["figures", "--preset", "smoke"]) == 0
    assert PROCESSES not in commands.environment, "each notebook takes all cores"
    assert batch.main(["figures", "--preset", "smoke", "--jobs", "2"]) == 0
    assert commands.environment[PROCESSES] == "1"
    monkeypatch.setenv(PROCESSES, "3")
    assert batch.main(["figures", "--preset", "smoke", "--jobs", "2"]) == 0
    assert commands.environment[PROCESSES] == "3", "unless told otherwise"


def test_only_some_notebooks(house, commands):
    assert batch.main(["figures", "--preset", "smoke", "--only", "2,"]) == 0
    assert config(commands.calls[0])["only"] == "02"


def test_the_environment_overrides_the_preset(house, commands, monkeypatch):
    monkeypatch.setenv("CASSIE_PRESET", "smoke")
    assert batch.main(["figures", "--preset", "laptop"]) == 0
    assert config(commands.calls[0])["preset"] == "smoke"
    assert commands.finished == ["smoke"]


def test_failed_figures_finish_nothing_and_keep_the_request(house, commands, capsys):
    commands.code = 1
    arguments = ["figures", "--preset", "smoke", "--only", "02", "--recompute", "cem,dagger"]
    assert batch.main(arguments) == 1
    assert capsys.readouterr().out == ""
    assert commands.finished == []
    request = json.loads(recompute.request_file("smoke").read_text())
    assert request["stages"] == ["cem", "dagger"]
    assert not stamp_file("smoke", "02").exists(), "what is to be computed anew is run again"
    assert stamp_file("smoke", "01").exists()
    first = config(commands.calls[0])
    assert first["recompute"] == "cem+dagger"
    # Asked again, the request goes on: its moment stays, and so does what was done since.
    write_stamp(stamp_file("smoke", "02"), "hash", [])
    commands.code = 0
    assert batch.main(arguments) == 0
    assert config(commands.calls[1])["since"] == first["since"]
    assert stamp_file("smoke", "02").exists()
    assert not recompute.request_file("smoke").exists()


def test_the_rest_of_a_request_runs_what_it_had_not_named_before(house, commands):
    for number in ("01", "02"):
        os.utime(stamp_file("smoke", number), (0.0, 0.0))
    commands.code = 1
    arguments = ["figures", "--preset", "smoke", "--recompute", "all"]
    assert batch.main([*arguments, "--only", "01"]) == 1
    write_stamp(stamp_file("smoke", "01"), "hash", [])
    assert stamp_file("smoke", "02").exists()
    assert batch.main(arguments) == 1
    assert stamp_file("smoke", "01").exists(), "made since the request began"
    assert not stamp_file("smoke", "02").exists(), "made before it"


def test_a_dry_run_of_snakemake_is_refused_before_anything_is_forgotten(house, commands, capsys):
    arguments = ["figures", "--preset", "smoke", "--recompute", "all", "--", "-n"]
    assert batch.main(arguments) == 1
    assert capsys.readouterr().err.startswith("error: -n would run nothing: expected")
    assert commands.calls == []
    assert stamp_file("smoke", "01").exists()
    assert not recompute.request_file("smoke").exists()


def test_a_finished_request_says_what_it_has_computed(house, commands, capsys, monkeypatch):
    make(preset="smoke")
    arguments = ["figures", "--preset", "smoke", "--recompute", "data,cem"]
    commands.code = 1
    assert batch.main(arguments) == 1
    # The request was interrupted; what is made from here on belongs to it.
    monkeypatch.setenv(recompute.REQUEST, "data,cem")
    monkeypatch.setenv(recompute.SINCE, config(commands.calls[0])["since"])
    anew = [make(preset="smoke"), make(stage="cem", preset="smoke")]
    damage_empty(make(Parameters(size=4), preset="smoke").path / "manifest.json")
    make(Parameters(size=5), preset="laptop")
    capsys.readouterr()
    commands.code = 0
    assert batch.main(arguments) == 0
    since = float(config(commands.calls[1])["since"])
    assert computed_since(since, "smoke") == (2, sum(item.wall_time_s for item in anew))
    assert "computed anew: 2 results in 0.00 h on the clock" in capsys.readouterr().out


def test_a_single_run_hands_over_parameters_and_its_request(house, monkeypatch):
    seen = []

    def pretend(notebook, preset, parameters, request, stamp):
        seen.append((notebook, preset, parameters, request, stamp))
        assert recompute.request_file("smoke-02").exists() == (request is not None)

    monkeypatch.setattr(batch, "run_notebook", pretend)
    run = ["run", "02", "--preset", "smoke"]
    assert batch.main([*run, "--parameter", "SEEDS=3", "--parameter", "GAIT=walk"]) == 0
    assert seen[0] == ("02", "smoke", {"SEEDS": 3, "GAIT": "walk"}, None, None)
    assert batch.main([*run, "--recompute", "cem+dagger"]) == 0
    stages, since = seen[1][3]
    assert stages == "cem,dagger"
    assert since > 0.0
    assert not recompute.request_file("smoke-02").exists(), "it is done"
    # Nor does it touch what make figures has left unfinished.
    since = recompute.begin_request("all", "smoke")
    assert batch.main([*run, "--recompute", "cem"]) == 0
    assert recompute.begin_request("all", "smoke") == since


def test_a_run_within_a_request_does_not_end_it(house, monkeypatch):
    recompute.begin_request("cem", "smoke")
    requests = []
    monkeypatch.setattr(batch, "run_notebook", lambda *arguments: requests.append(arguments[3]))
    arguments = ["run", "02", "--preset", "smoke", "--recompute", "cem", "--since", "12.5"]
    assert batch.main(arguments) == 0
    assert requests == [("cem", 12.5)]
    assert recompute.request_file("smoke").exists()


@pytest.mark.parametrize(("preset", "updates"), [("laptop", 1), ("smoke", 0)])
def test_only_the_laptop_preset_writes_the_readme(preset, updates, house, monkeypatch, capsys):
    from cassie_lib import gallery, readme

    called = []
    monkeypatch.setattr(readme, "update_readme", lambda: called.append("readme"))
    monkeypatch.setattr(gallery, "build_gallery", lambda name: paths.ROOT / name / "index.html")
    batch._finish(preset)
    assert len(called) == updates
    assert capsys.readouterr().out == f"gallery: {preset}/index.html\n"
