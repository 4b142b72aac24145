"""Typed errors.  Each message is one line that names the value and what was expected."""

from __future__ import annotations


class CassieError(ValueError):
    """Base of every error that this library raises on bad input."""


class ShapeError(CassieError):
    """An array has another shape than the one documented."""


class NonFiniteError(CassieError):
    """A value is NaN or infinite where a finite one is needed."""


class UnknownNameError(CassieError):
    """A preset, gait, stage or option name does not exist; the message lists those that do."""


class ParameterError(CassieError):
    """A hyper-parameter is out of its range or contradicts another one."""


class TrajectoryError(CassieError):
    """A recorded trajectory cannot be read or has another format."""


class RenderingError(CassieError):
    """No OpenGL context is to be had, or a camera or size is wrong."""


class ArtifactError(CassieError):
    """A stored artifact is missing, damaged or half-written."""


class SchemaError(CassieError):
    """Data or weights were made for another state schema or normalisation."""


class CheckpointError(CassieError):
    """A checkpoint belongs to another architecture, preset or run."""


class DataError(CassieError):
    """A data set is truncated, edited, empty or of mixed schemas."""


class TrainingError(CassieError):
    """Training cannot go on; the last good checkpoint is kept."""


def unknown_name(kind: str, name: object, known: object) -> UnknownNameError:
    """Build the error for a name that is not one of ``known``.

    Args:
        kind: What is named, e.g. ``"preset"``.
        name: The value that was given.
        known: Iterable of the accepted names.
    """
    accepted = ", ".join(sorted(str(item) for item in known))  # type: ignore[attr-defined]
    return UnknownNameError(f"unknown {kind} {name!r}: expected one of {accepted}")
