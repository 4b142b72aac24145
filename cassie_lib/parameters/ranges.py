"""Ranges of hyper-parameters, checked where they are put together and not hours later."""

from __future__ import annotations

import math
from typing import Any

from cassie_lib.errors import ParameterError


def require(parameters: Any, *names: str, least: float, most: float = math.inf) -> None:
    """Check that fields hold finite numbers within bounds.

    Args:
        parameters: A dataclass of hyper-parameters.
        names: Its fields.
        least: Smallest accepted value.
        most: Largest accepted value.

    Raises:
        ParameterError: If one does not; it names the field, its value and the bounds.
    """
    for name in names:
        value = getattr(parameters, name)
        if not (math.isfinite(value) and least <= value <= most):
            bounds = f"at least {least:g}" if most == math.inf else f"{least:g} to {most:g}"
            raise ParameterError(
                f"{type(parameters).__name__}.{name} = {value}: expected {bounds}"
            )


__all__ = ["require"]
