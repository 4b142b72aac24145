"""How fast the machine is at this moment, for protocols of measured times."""

from __future__ import annotations

import time

SIZE = 1024
TURNS = 5


def core_gflops() -> float:
    """Rate of one core at multiplying float32 matrices: 10^9 operations per processor second.

    The best of a few turns; a shared machine gives the same code half the speed on another day, and
    times compare only beside this.
    """
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        left, right = torch.rand(2, SIZE, SIZE).unbind()
        spent = []
        for _ in range(TURNS):
            began = time.process_time()
            left @ right
            spent.append(time.process_time() - began)
    finally:
        torch.set_num_threads(threads)
    return 2.0 * SIZE**3 / min(spent) / 1e9


__all__ = ["core_gflops"]
