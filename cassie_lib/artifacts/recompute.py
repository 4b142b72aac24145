"""Which stages a run was asked to compute anew.

``CASSIE_RECOMPUTE`` is ``all`` or a comma-separated list of stages.  An artifact that was finished
after the request was made is new, so each is computed once, whichever process meets it first, and
a killed run that is started again goes on where it was.  ``CASSIE_RECOMPUTE_SINCE`` (Unix time,
seconds) carries the moment of the request; the batch runner keeps it on disk until all is done.
Without it the request dates from the moment that the process first asks.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cassie_lib import paths
from cassie_lib.artifacts.stages import get_stage
from cassie_lib.errors import ParameterError
from cassie_lib.files import write_json

REQUEST, SINCE = "CASSIE_RECOMPUTE", "CASSIE_RECOMPUTE_SINCE"
_process_since: list[float] = []


def requested_stages(text: str) -> frozenset[str]:
    """Stages named in a request; ``{"all"}`` stands for every one.

    Raises:
        UnknownNameError: If one of them does not exist.
    """
    names = frozenset(name.strip() for name in text.split(",") if name.strip())
    for name in names - {"all"}:
        get_stage(name)
    return names


def recompute_since(stage: str) -> float:
    """Unix time before which an artifact of a stage counts as old; 0 when none does.

    Raises:
        UnknownNameError: If ``CASSIE_RECOMPUTE`` names an unknown stage.
        ParameterError: If ``CASSIE_RECOMPUTE_SINCE`` is not a number.
    """
    names = requested_stages(os.environ.get(REQUEST, ""))
    if not names & {"all", stage}:
        return 0.0
    text = os.environ.get(SINCE)
    if text is None:
        if not _process_since:
            _process_since.append(time.time())
        return _process_since[0]
    try:
        return float(text)
    except ValueError:
        raise ParameterError(f"{SINCE} is {text!r}: expected seconds as a number") from None


def share_request() -> None:
    """Put the moment of a request into the environment, for processes begun from here on.

    Otherwise each of them would date it anew and compute again what this one has just computed.
    """
    if os.environ.get(REQUEST) and SINCE not in os.environ and _process_since:
        os.environ[SINCE] = repr(_process_since[0])


def request_file(preset: str) -> Path:
    """Where the batch runner keeps the unfinished request of a preset."""
    return paths.CACHE / f"recompute-{preset}.json"


def begin_request(text: str, preset: str) -> float:
    """Start a request, or go on with the same one when it was interrupted.

    Args:
        text: ``all`` or stages separated by commas.
        preset: Name of the preset.

    Returns:
        Unix time of the request's start, for ``CASSIE_RECOMPUTE_SINCE``.

    Raises:
        UnknownNameError: If it names an unknown stage.
    """
    stages = sorted(requested_stages(text))
    found = _read_request(preset)
    if found.get("stages") == stages:
        return found["since"]
    since = time.time()
    write_json(request_file(preset), {"stages": stages, "since": since, "spent_s": 0.0})
    return since


def _read_request(preset: str) -> dict[str, Any]:
    """The unfinished request: stages, since (Unix time, s) and spent_s; empty if there is none."""
    try:
        found = json.loads(request_file(preset).read_text(encoding="utf-8"))
        spent = float(found.get("spent_s", 0.0))
        return {"stages": list(found["stages"]), "since": float(found["since"]), "spent_s": spent}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


@contextmanager
def spending_time(preset: str, every_s: float = 20.0) -> Iterator[None]:
    """Add the time inside to what the unfinished request has taken so far.

    It is noted every ``every_s`` seconds, so that a run that is killed loses no more than that:
    the sum is the time on the clock over all runs that the request took.
    """
    before, over = _read_request(preset), threading.Event()
    began = time.monotonic()

    def note() -> None:
        spent = before["spent_s"] + time.monotonic() - began
        write_json(request_file(preset), {**before, "spent_s": round(spent, 1)})

    def keep_noting() -> None:
        while not over.wait(every_s):
            note()

    if not before:
        yield
        return
    thread = threading.Thread(target=keep_noting, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        note()


def end_request(preset: str) -> float:
    """Forget the request: all that it asked for has been computed.

    Returns:
        The time that it took, in s: see :func:`spending_time`.
    """
    spent = _read_request(preset).get("spent_s", 0.0)
    request_file(preset).unlink(missing_ok=True)
    return spent
