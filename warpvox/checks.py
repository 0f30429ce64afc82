"""Checks of values that others give: what was expected, what was got."""

from __future__ import annotations

import math
from numbers import Integral
from typing import TYPE_CHECKING, Any, TypeGuard

from warpvox.errors import ConfigError

if TYPE_CHECKING:
    from typing_extensions import TypeIs

__all__ = ["check_integer", "check_shape", "is_integer", "is_number"]


def is_integer(value: object) -> TypeIs[int]:
    """Whether a value is an integer of Python or numpy; ``True`` is none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value is a finite int or float of Python."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def check_integer(
    name: str, value: object, low: int, high: int | None = None, error: type[Exception] = ConfigError
) -> int:
    """``value`` as int, or an ``error`` that names the valid range."""
    if not is_integer(value) or value < low or (high is not None and value > high):
        limits = f">= {low}" if high is None else f"from {low} to {high}"
        raise error(f"{name} must be an integer {limits}, got {value!r:.80}.")
    return int(value)


def check_shape(name: str, value: Any, error: type[Exception] = ConfigError) -> tuple[int, int]:
    """``value`` as (rows, columns), or an ``error``."""
    try:
        sizes = list(value)
    except TypeError:
        sizes = []
    if len(sizes) != 2 or not all(is_integer(size) and size >= 1 for size in sizes):
        raise error(f"{name} must be two integers >= 1, (rows, columns), got {value!r:.80}.")
    return int(sizes[0]), int(sizes[1])
