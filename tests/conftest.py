"""One thread for linear algebra, and stores of a test's own."""

import os

import pytest

# Small tensors on several threads only wait for each other.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")


@pytest.fixture
def artifact_folders(tmp_path, monkeypatch):
    """Empty folders for artifacts, and no request to compute anything anew."""
    from cassie_lib import paths
    from cassie_lib.artifacts import recompute, store

    monkeypatch.setattr(paths, "CACHE", tmp_path / "cache")
    monkeypatch.setattr(paths, "DATA", tmp_path / "data")
    for name in (recompute.REQUEST, recompute.SINCE, store.USED):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(recompute, "_process_since", [])
