"""Run notebooks: one (``run``) or all that are needed (``figures``, by Snakemake).

``python -m cassie_lib.batch run 06 --preset smoke --parameter SEEDS=3``
``python -m cassie_lib.batch figures --preset laptop --only 01 -- --executor slurm``
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

from cassie_lib import paths
from cassie_lib.artifacts.ledger import computed_since
from cassie_lib.artifacts.recompute import (
    begin_request,
    end_request,
    requested_stages,
    spending_time,
)
from cassie_lib.artifacts.side_by_side import PROCESSES
from cassie_lib.errors import CassieError, ParameterError
from cassie_lib.files import locked
from cassie_lib.notebook_run import find_notebook, parse_parameter, run_notebook, short_path
from cassie_lib.presets import resolve
from cassie_lib.stamps import stamp_file

#: Notebooks whose stored results a notebook starts from; each computes what is missing itself.
NEEDS = {
    "01": (),
    "02": (),
    "03": ("02",),
    "04": ("03",),
    "05": ("03",),
    "06": ("05",),
    "07": ("05",),
    "08": ("05",),
}
_DRY_RUN = {"-n", "--dry-run", "--dryrun"}


def select(only: str) -> list[Path]:
    """Notebooks to run: all, or those named by numbers separated by commas.

    Raises:
        UnknownNameError: If there is no such notebook.
    """
    if only.strip():
        return sorted({find_notebook(name.strip()) for name in only.split(",") if name.strip()})
    return sorted(paths.NOTEBOOKS.glob("[0-9][0-9]_*.ipynb"))


def run_figures(
    preset: str, only: str = "", recompute: str = "", jobs: int = 1, extra: tuple[str, ...] = ()
) -> int:
    """Bring the notebooks up to date in the order of what they need.

    A notebook is run when it has not been run with this preset, or when it, the library, the lock
    or an artifact that it used has changed since.  A killed run goes on where it was.

    Args:
        preset: Name of the preset; ``CASSIE_PRESET`` overrides it.
        only: Numbers of notebooks separated by commas; empty for all.
        recompute: ``all`` or stages to compute anew; empty for none.
        jobs: Notebooks at the same time.
        extra: Further arguments for Snakemake, e.g. ``("--executor", "slurm")``.

    Returns:
        Exit code of Snakemake.

    Raises:
        UnknownNameError: If the preset, a notebook or a stage does not exist.
        ParameterError: If Snakemake is asked to run nothing.
    """
    preset = resolve(preset).name
    notebooks = select(only)
    requested_stages(recompute)
    if dry := _DRY_RUN & set(extra):
        raise ParameterError(f"{min(dry)} would run nothing: expected another argument")
    config = [f"preset={preset}", "only=" + "+".join(path.name[:2] for path in notebooks)]
    if recompute:
        begun = time.time()
        since = begin_request(recompute, preset)
        config += [f"since={since!r}", "recompute=" + recompute.replace(",", "+")]
        for notebook in notebooks:
            stamp = stamp_file(preset, notebook.name[:2])
            # Of an interrupted request, which may have named fewer notebooks, what has been done
            # since stays.
            if since >= begun or (stamp.exists() and stamp.stat().st_mtime < since - 1.0):
                stamp.unlink(missing_ok=True)
    (paths.CACHE / "batch").mkdir(parents=True, exist_ok=True)
    environment = dict(os.environ)
    if jobs > 1:
        environment.setdefault(PROCESSES, "1")  # the notebooks share the cores
    # Snakemake's own lock would outlive a kill; this one does not.
    with (
        locked(paths.CACHE / "locks" / f"batch-{preset}.lock", f"it runs preset {preset}"),
        spending_time(preset) if recompute else nullcontext(),
    ):
        command = _snakemake(jobs, extra, config)
        code = subprocess.run(command, check=False, env=environment).returncode
    if code == 0:
        print(f"up to date: {', '.join(path.stem for path in notebooks)}")
    if code == 0 and recompute:
        clock = end_request(preset)
        count, seconds = computed_since(since, preset)
        print(
            f"computed anew: {count} results in {clock / 3600:.2f} h on the clock, all runs "
            f"of the request together; {seconds / 3600:.2f} h if one after another"
        )
    return code


def _snakemake(jobs: int, extra: tuple[str, ...], config: list[str]) -> list[str]:
    return [
        sys.executable, "-m", "snakemake", "--snakefile", str(paths.SNAKEFILE), "--directory",
        str(paths.CACHE / "batch"), "--cores", str(jobs), "--rerun-triggers", "params",
        "--rerun-incomplete", "--keep-going", "--nolock", "--quiet", "all",
        *extra, "--config", *config,
    ]  # fmt: skip


def _finish(preset: str) -> None:
    from cassie_lib.gallery import build_gallery
    from cassie_lib.readme import update_readme

    if preset == "laptop":
        update_readme()
    print(f"gallery: {short_path(build_gallery(preset))}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m cassie_lib.batch", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="execute one notebook")
    run.add_argument("notebook", help="number, name or path")
    run.add_argument("--preset", default="laptop")
    run.add_argument("--parameter", action="append", default=[], metavar="NAME=VALUE")
    run.add_argument("--recompute", default="", help="all, or stages joined by + or ,")
    run.add_argument("--since", type=float, default=0.0, help=argparse.SUPPRESS)
    run.add_argument("--stamp", type=Path, help=argparse.SUPPRESS)
    figures = commands.add_parser("figures", help="bring all notebooks up to date")
    figures.add_argument("--preset", default="laptop")
    figures.add_argument("--only", default="", help="numbers separated by commas")
    figures.add_argument("--recompute", default="", help="all, or stages separated by commas")
    figures.add_argument("--jobs", type=int, default=1)
    figures.add_argument("extra", nargs="*", help="after --: arguments for Snakemake")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        if options.command == "run":
            number = find_notebook(options.notebook).name[:2]
            # Not the request of make figures, which may be unfinished.
            own = f"{resolve(options.preset).name}-{number}"
            parameters = dict(parse_parameter(text) for text in options.parameter)
            stages = options.recompute.replace("+", ",")
            since = (options.since or begin_request(stages, own)) if stages else 0.0
            request = (stages, since) if stages else None
            run_notebook(options.notebook, options.preset, parameters, request, options.stamp)
            if stages and not options.since:
                end_request(own)
            return 0
        code = run_figures(
            options.preset, options.only, options.recompute, options.jobs, tuple(options.extra)
        )
        if code == 0:
            _finish(resolve(options.preset).name)
        return code
    except CassieError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
