"""Asking for a result only if it is stored, and what a run has computed itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from cassie_lib.errors import ArtifactError

#: Names of the artifacts that this process and those that it began have computed.
_COMPUTED: set[str] = set()
_LOADING_ONLY = ContextVar("_LOADING_ONLY", default=False)


class NotStoredError(ArtifactError):
    """A result would have to be computed, which :func:`loading_only` forbids."""


@contextmanager
def loading_only() -> Iterator[None]:
    """Within this, what would have to be computed raises :class:`NotStoredError`."""
    token = _LOADING_ONLY.set(True)
    try:
        yield
    finally:
        _LOADING_ONLY.reset(token)


def check_may_compute(name: str) -> None:
    """Called before a result is computed.

    Raises:
        NotStoredError: Within :func:`loading_only`.
    """
    if _LOADING_ONLY.get():
        raise NotStoredError(f"{name} is not stored: expected a result that can be loaded")


def note_computed(names: Iterable[str]) -> None:
    """Remember artifacts as computed in this run, by this process or by one that it began."""
    _COMPUTED.update(names)


def computed() -> frozenset[str]:
    """Names of all artifacts that were computed in this run."""
    return frozenset(_COMPUTED)


__all__ = ["NotStoredError", "check_may_compute", "computed", "loading_only", "note_computed"]
