"""Time and memory of the thesis's three collections: python tests/benchmarks/bench_data.py [share]

The requirement is 173,950 transitions at 0.5 ms physics in at most 3 min on 2 cores, and windows
of 100 states for at most 100 MB beside the data.  Needs the expert of the laptop preset; an
untrained one falls at once and would be slower.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

from cassie_lib import pipeline
from cassie_lib.data import collect
from cassie_lib.presets import get_preset, replace


def main(share: float = 1.0) -> None:
    """Collect a share of the three sets and print what it took."""
    preset = get_preset("laptop")
    expert = pipeline.expert(preset)
    total, begun, processor = 0, time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        for name in ("train", "validation", "test"):
            wanted = getattr(preset.data, name)
            wanted = replace(wanted, transitions=round(wanted.transitions * share))
            data = collect(expert, wanted, preset.simulation, Path(folder) / name, progress=False)
            total += len(data)
        seconds, processor = time.perf_counter() - begun, time.process_time() - processor
        print(f"{total:,} transitions: {seconds:.1f} s, processor {processor:.1f} s; "
              f"173,950 would take {seconds / total * 173_950:.0f} s")  # fmt: skip
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        windows = data.windows(100)
        windows.gather("states", slice(0, 128))
        grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        print(f"{windows.report()}; process grew by {grown / 1024:.1f} MB")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0)
