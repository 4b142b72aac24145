"""Results that do not need each other, computed in several processes.

Models are trained and planners run on one core each, so that the number of cores does not change
their bits; most results of a notebook do not depend on each other.  ``CASSIE_PROCESSES`` says how
many are computed at a time.  The batch runner sets it to the number of cores; where it is unset,
one after another is computed.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_EXCEPTION, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait as wait_for
from typing import TypeVar

from cassie_lib.artifacts.loading import NotStoredError, computed, loading_only, note_computed
from cassie_lib.artifacts.recompute import share_request
from cassie_lib.errors import ArtifactError, ParameterError

PROCESSES = "CASSIE_PROCESSES"
_T = TypeVar("_T")


def process_count() -> int:
    """Results to compute at a time, from ``CASSIE_PROCESSES``; 1 where it is unset.

    Raises:
        ParameterError: If that is not a whole number from 1 on.
    """
    text = os.environ.get(PROCESSES) or "1"
    if not (text.isdecimal() and int(text) >= 1):
        raise ParameterError(f"{PROCESSES} is {text!r}: expected a whole number from 1 on")
    return int(text)


def side_by_side(calls: Sequence[Callable[[], _T]], costs: Iterable[float] = ()) -> list[_T]:
    """Make calls that load or compute stored results; those that have to compute run together.

    A call runs in a process of its own and is repeated here, where it finds its result stored:
    what comes out is the same, whatever the number of processes.

    Args:
        calls: Functions without arguments, each computing at least one artifact.  They and their
            arguments are pickled when there is more than one process: use
            :class:`functools.partial` of functions that can be imported.
        costs: What each takes, in any unit: the longest begins first.

    Returns:
        What the calls return, in their order.

    Raises:
        ParameterError: If ``CASSIE_PROCESSES`` is no whole number from 1 on.
        ArtifactError: If a process was killed.  What the others have finished is stored.
    """
    processes = process_count()
    if processes > 1:
        missing = [number for number, call in enumerate(calls) if not _is_stored(call)]
        weights = list(costs) or [1.0] * len(calls)
        missing.sort(key=lambda number: -weights[number])
        if len(missing) > 1:
            _compute([calls[number] for number in missing], min(processes, len(missing)))
    return [call() for call in calls]


def _is_stored(call: Callable[[], object]) -> bool:
    try:
        with loading_only():
            call()
    except NotStoredError:
        return False
    return True


def _compute(calls: list[Callable[[], object]], processes: int) -> None:
    share_request()
    # A forked process would inherit the threads' locks but not the threads.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(processes, context, initializer=_begin_process)
    try:
        futures = [pool.submit(_run, call) for call in calls]
        for future in wait(futures, return_when=FIRST_EXCEPTION).done:
            note_computed(future.result())
    except BrokenProcessPool:
        raise ArtifactError(
            f"one of {processes} processes was killed, perhaps for want of memory: "
            f"expected {len(calls)} results; run again, it goes on"
        ) from None
    finally:
        # After an error nobody waits for the others: what they finish is stored all the same.
        pool.shutdown(wait=False, cancel_futures=True)


def _run(call: Callable[[], object]) -> frozenset[str]:
    """Runs in a process of its own: the result stays in the store, its name is sent back."""
    call()
    return computed()


def _begin_process() -> None:
    os.environ[PROCESSES] = "1"  # what it computes starts no further processes
    parent = multiprocessing.parent_process()

    def end_with_parent() -> None:
        if parent is not None:
            wait_for([parent.sentinel])
            os._exit(1)  # a killed notebook leaves nothing behind that goes on computing

    threading.Thread(target=end_with_parent, daemon=True).start()


__all__ = ["PROCESSES", "process_count", "side_by_side"]
