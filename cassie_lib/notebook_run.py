"""Execute one notebook so that its result is either whole or not there."""

from __future__ import annotations

import ast
import json
import os
import re
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from ctypes.util import find_library
from pathlib import Path
from typing import Any

from cassie_lib import paths
from cassie_lib.artifacts.recompute import REQUEST, SINCE
from cassie_lib.artifacts.side_by_side import PROCESSES
from cassie_lib.artifacts.store import USED
from cassie_lib.errors import CassieError, ParameterError, unknown_name
from cassie_lib.files import write_text
from cassie_lib.presets import resolve
from cassie_lib.provenance import CHANGED
from cassie_lib.results import MADE, forget_other_claims
from cassie_lib.stamps import inputs_hash, write_stamp


class NotebookError(CassieError):
    """A cell of a notebook failed; the half-executed copy is kept for a look."""


def find_notebook(name: str) -> Path:
    """Find a notebook by number (``6`` or ``06``), stem or path.

    Raises:
        UnknownNameError: If there is no such notebook.
    """
    known = {path.stem: path for path in sorted(paths.NOTEBOOKS.glob("[0-9][0-9]_*.ipynb"))}
    stem = Path(name).stem if name.endswith(".ipynb") else name
    number = f"{int(stem):02d}" if re.fullmatch(r"\d{1,2}", stem) else ""
    for found, path in known.items():
        if stem == found or (number and found.startswith(f"{number}_")):
            return path
    raise unknown_name("notebook", name, known)


def notebook_parameters(notebook: Path) -> dict[str, Any]:
    """Parameters of a notebook and their defaults, from the cell tagged ``parameters``.

    Raises:
        NotebookError: If the file is no JSON.
    """
    try:
        book = json.loads(notebook.read_text(encoding="utf-8"))
    except ValueError:
        raise NotebookError(f"{notebook.name} cannot be read: expected a notebook") from None
    found: dict[str, Any] = {}
    for cell in book["cells"]:
        if "parameters" in cell["metadata"].get("tags", ()):
            for node in ast.parse("".join(cell["source"])).body:
                if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                    found[node.targets[0].id] = ast.literal_eval(node.value)
    return found


def parse_parameter(text: str) -> tuple[str, Any]:
    """Split ``name=value``; the value is a Python literal, or text when it is none.

    Raises:
        ParameterError: If there is no ``=``.
    """
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise ParameterError(f"parameter is {text!r}: expected name=value")
    try:
        return name.strip(), ast.literal_eval(value.strip())
    except (ValueError, SyntaxError):
        return name.strip(), value.strip()


def check_parameters(notebook: Path, given: Mapping[str, Any]) -> None:
    """Refuse what the notebook would ignore or choke on.

    Raises:
        UnknownNameError: If the notebook has no such parameter; the message lists those it has.
        ParameterError: If a value has another type than the default.
    """
    known = notebook_parameters(notebook)
    for name, value in given.items():
        if name not in known:
            raise unknown_name(f"parameter of {notebook.stem}", name, known)
        default = known[name]
        same = type(value) is type(default) or (type(default) is float and type(value) is int)
        if default is not None and not same:
            kind = type(default).__name__
            raise ParameterError(
                f"parameter {name} of {notebook.stem} is {value!r}: expected {kind} like {default}"
            )


@contextmanager
def _environment(values: Mapping[str, str | None]) -> Iterator[None]:
    """Set variables for the kernel (None removes one) and put the old ones back."""
    before = {name: os.environ.get(name) for name in values}

    def apply(wanted: Mapping[str, str | None]) -> None:
        for name, value in wanted.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

    apply(values)
    try:
        yield
    finally:
        apply(before)


def headless_rendering() -> dict[str, str | None]:
    """Have MuJoCo draw through EGL on a Linux machine without a screen, unless told otherwise.

    Without that library the variable must stay unset: MuJoCo could not even be imported.
    """
    if sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("MUJOCO_GL"):
        return {}
    return {"MUJOCO_GL": "egl"} if find_library("EGL") else {}


def _progress(name: str) -> dict[str, Any]:
    # A log file gets a line now and then, a terminal a moving bar.
    seconds = 0.2 if sys.stderr.isatty() else 30.0
    return {"desc": f"[{name}]", "unit": "cell", "mininterval": seconds}


def _kernel_settings() -> Any:
    from traitlets.config import Config

    # Where there are Unix sockets the kernel is reached by nobody else on the machine.
    return Config() if os.name == "nt" else Config(KernelManager={"transport": "ipc"})


def run_notebook(
    name: str,
    preset: str = "laptop",
    parameters: Mapping[str, Any] | None = None,
    recompute: tuple[str, float] | None = None,
    stamp: Path | None = None,
) -> Path:
    """Execute a notebook with papermill.

    The executed copy replaces the former one only when the last cell has passed.

    Args:
        name: Number, stem or path of the notebook.
        preset: Name of the preset; ``CASSIE_PRESET`` overrides it.
        parameters: Further parameters; they send the results to the cache.
        recompute: Stages to compute anew, and since when (Unix time).
        stamp: File to write at the end, see :mod:`cassie_lib.stamps`.

    Returns:
        The executed notebook.

    Raises:
        UnknownNameError: If the notebook, preset or a parameter does not exist.
        ParameterError: If a parameter has another type than its default.
        NotebookError: If a cell fails or the kernel dies.
    """
    import papermill
    from nbclient.exceptions import DeadKernelError

    notebook, preset, changed = find_notebook(name), resolve(preset).name, dict(parameters or {})
    if "PRESET" in changed:
        raise ParameterError(f"PRESET = {changed['PRESET']!r} is a parameter: expected --preset")
    injected = {**({} if preset == "laptop" else {"PRESET": preset}), **changed}
    check_parameters(notebook, injected)
    target = paths.executed_folder(preset, bool(changed)) / notebook.name
    partial = paths.CACHE / "running" / f"{preset}-{os.getpid()}-{notebook.name}"
    used, made = partial.with_suffix(".artifacts"), partial.with_suffix(".claims")
    partial.parent.mkdir(parents=True, exist_ok=True)
    for log in (used, made):
        log.unlink(missing_ok=True)  # of a killed process that had the same number
    environment: dict[str, str | None] = {
        USED: str(used),
        MADE: str(made),
        CHANGED: json.dumps(changed),
        REQUEST: recompute[0] if recompute else os.environ.get(REQUEST),
        SINCE: repr(recompute[1]) if recompute else os.environ.get(SINCE),
        PROCESSES: os.environ.get(PROCESSES) or str(_processes(preset)),
        "MPLBACKEND": None,  # otherwise the figures are not shown in the notebook
        "KINETO_LOG_LEVEL": "99",  # PyTorch's profiler would write into the notebook
        **headless_rendering(),
    }
    print(f"[{notebook.stem}] started, preset {preset}", flush=True)
    begun, inputs = time.time(), inputs_hash(notebook)
    try:
        with _environment(environment):
            papermill.execute_notebook(
                notebook, partial, injected, kernel_name="python3", language="python",
                cwd=paths.NOTEBOOKS, progress_bar=_progress(notebook.stem), start_timeout=180,
                config=_kernel_settings(),
            )  # fmt: skip
            forget_other_claims(preset, notebook.name[:2], made)
    except (papermill.PapermillExecutionError, DeadKernelError) as error:
        failed = paths.CACHE / "failed" / notebook.name
        failed.parent.mkdir(parents=True, exist_ok=True)
        partial.replace(failed)
        used.unlink(missing_ok=True)
        made.unlink(missing_ok=True)
        what = ": its kernel was killed, perhaps for want of memory; run again, it goes on"
        if isinstance(error, papermill.PapermillExecutionError):
            what = f", In [{error.exec_count}]: {error.ename}: {error.evalue}"
        raise NotebookError(
            f"{notebook.name}{what}; executed so far: {short_path(failed)}"
        ) from None
    seconds = time.time() - begun
    write_text(target, _cleaned(partial, seconds))
    partial.unlink()
    if stamp is not None:
        lines = used.read_text(encoding="utf-8").splitlines() if used.exists() else []
        write_stamp(stamp, inputs, lines)
    used.unlink(missing_ok=True)
    made.unlink(missing_ok=True)
    print(f"[{notebook.stem}] done in {seconds / 60:.1f} min: {short_path(target)}", flush=True)
    return target


def _processes(preset: str) -> int:
    """Results to compute at a time: one per core.

    A smoke test is over before a process has begun, and ``thesis`` shares one graphics card.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return cores or 1 if preset == "laptop" else 1


def short_path(path: Path) -> str:
    """A path below the repository as a reader would type it; others stay whole."""
    inside = path.is_relative_to(paths.ROOT)
    return (path.relative_to(paths.ROOT) if inside else path).as_posix()


def _cleaned(executed: Path, seconds: float) -> str:
    """Text of an executed notebook without this machine's paths and the moments of each cell."""
    book = json.loads(executed.read_text(encoding="utf-8"))
    parameters = book["metadata"].get("papermill", {}).get("parameters", {})
    book["metadata"]["papermill"] = {"duration": round(seconds, 1), "parameters": parameters}
    for cell in book["cells"]:
        cell["metadata"] = {k: v for k, v in cell["metadata"].items() if k == "tags"}
    text = json.dumps(book, indent=1, ensure_ascii=False) + "\n"
    for place, short in ((paths.ROOT, "."), (Path.home(), "~")):
        text = text.replace(json.dumps(str(place), ensure_ascii=False)[1:-1] + "/", f"{short}/")
    return text
