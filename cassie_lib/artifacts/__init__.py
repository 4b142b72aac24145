"""Load-or-compute: every expensive result is stored under the hash of what decides it.

A changed parameter, stage version or upstream result has another hash, so an old result is never
taken for a new one.  Every file is checked against its SHA-256 on load.
"""

from __future__ import annotations

from cassie_lib.artifacts.manifest import Artifact
from cassie_lib.artifacts.pending import Pending
from cassie_lib.artifacts.stages import STAGES, Stage
from cassie_lib.artifacts.store import WORK, Upstream, keep, load, load_or_compute, stored

__all__ = [
    "STAGES",
    "WORK",
    "Artifact",
    "Pending",
    "Stage",
    "Upstream",
    "keep",
    "load",
    "load_or_compute",
    "stored",
]
