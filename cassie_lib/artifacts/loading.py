"""Asking for a result only if it is stored."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from cassie_lib.errors import ArtifactError

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


__all__ = ["NotStoredError", "check_may_compute", "loading_only"]
