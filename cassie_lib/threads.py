"""One torch thread for what is to give the same bits on any number of cores."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Run a block with a single torch thread and restore the number afterwards.

    Planners and small models make many small products one after another: threads that wait for
    each other cost more than they save (a hundred times more on a machine that is busy
    otherwise), and sums come out differently with their number.  The cores are used by computing
    several results at a time, see :mod:`cassie_lib.artifacts.side_by_side`.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


__all__ = ["one_torch_thread"]
