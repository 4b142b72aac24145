"""The rate that stands beside measured times."""

from __future__ import annotations

import torch

from cassie_lib import machine


def test_the_rate_is_counted_from_processor_time_of_one_thread(monkeypatch):
    clock = iter([0.0, 0.5, 1.0, 1.1, 2.0, 2.2, 3.0, 3.4, 4.0, 4.3])
    seen = []

    def process_time():
        seen.append(torch.get_num_threads())
        return next(clock)

    monkeypatch.setattr(machine.time, "process_time", process_time)
    before = torch.get_num_threads()
    # The fastest turn took 0.1 s for 2 n^3 operations.
    assert abs(machine.core_gflops() - 2 * machine.SIZE**3 / 0.1 / 1e9) < 1e-6
    assert set(seen) == {1}
    assert torch.get_num_threads() == before


def test_a_real_rate_is_positive():
    assert 0.1 < machine.core_gflops() < 1e5
