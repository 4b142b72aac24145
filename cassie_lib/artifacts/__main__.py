"""``python -m cassie_lib.artifacts list | verify | keep STAGE | renew``."""

from __future__ import annotations

import argparse
import sys

from cassie_lib import paths
from cassie_lib.artifacts.manifest import read_manifest
from cassie_lib.artifacts.renew import renew
from cassie_lib.artifacts.stages import STAGES, get_stage
from cassie_lib.artifacts.store import keep, load, stored
from cassie_lib.errors import CassieError


def _describe(folder) -> str:
    manifest = read_manifest(folder)
    size = sum(facts["bytes"] for facts in manifest["files"].values())
    place = "cache" if folder.parent == paths.CACHE else "git"
    minutes = manifest["wall_time_s"] / 60
    return (
        f"{folder.name:32s} {place:5s} {manifest['preset'] or '-':7s} {minutes:7.1f} min"
        f" {size / 1e6:8.2f} MB  {manifest['commit']}"
    )


def list_artifacts(stage: str) -> int:
    """Print one line for each stored artifact; returns the number of unreadable ones."""
    bad = 0
    for folder in stored(stage):
        try:
            print(_describe(folder))
        except CassieError as error:
            bad += 1
            print(error)
    return bad


def verify_artifacts(stage: str) -> int:
    """Check every file of every stored artifact; returns the number of damaged ones."""
    bad = 0
    for folder in stored(stage):
        try:
            notice = load(folder).notice
            print(f"{folder.name}: whole", *notice, sep="\n  ")
        except CassieError as error:
            bad += 1
            print(error)
    return bad


def keep_artifacts(stage: str) -> int:
    """Copy the laptop artifacts of a stage from the cache to ``data/``; returns 0."""
    for folder in stored(stage):
        if folder.parent != paths.CACHE or read_manifest(folder)["preset"] != "laptop":
            continue
        print(f"kept {keep(load(folder)).relative_to(paths.ROOT).as_posix()}")
    return 0


def renew_artifacts(stage: str) -> int:
    """Take back notices that recomputed upstream results have disproved; returns 0."""
    for name, lines in renew().items():
        print(f"{name}: taken back", *lines, sep="\n  ")
    return 0


COMMANDS = {
    "list": list_artifacts,
    "verify": verify_artifacts,
    "keep": keep_artifacts,
    "renew": renew_artifacts,
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m cassie_lib.artifacts", description=__doc__)
    parser.add_argument("command", choices=tuple(COMMANDS))
    parser.add_argument("stage", nargs="?", default="", help=", ".join(STAGES))
    options = parser.parse_args(arguments)
    try:
        if options.stage or options.command == "keep":
            get_stage(options.stage)
        return 1 if COMMANDS[options.command](options.stage) else 0
    except CassieError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
