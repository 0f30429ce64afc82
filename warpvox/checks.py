"""Validation of values from users: the error says what was expected and what was given."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from warpvox.errors import ConfigError, WarpvoxError, did_you_mean, listing

if TYPE_CHECKING:
    from torch import Tensor
    from typing_extensions import TypeIs


def is_integer(value: object) -> TypeIs[int]:
    """Return whether a value is an integer of Python or numpy, but not a bool."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a finite int or float of Python."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def is_list(value: object) -> TypeGuard[Sequence[Any] | np.ndarray]:
    """Return whether a value is a sequence or an array."""
    return isinstance(value, Sequence | np.ndarray)


def is_mapping(value: object) -> TypeGuard[Mapping[str, Any]]:
    """Return whether a value is a mapping."""
    return isinstance(value, Mapping)


def design_of(thing: Any) -> Any:
    """Return the attribute ``design`` of a robot, run or policy, or the argument itself if it has none."""
    return getattr(thing, "design", thing)


def check_choice(name: str, value: object, choices: Iterable[object], error: type[WarpvoxError] = ConfigError) -> None:
    """Raise ``error`` unless ``value`` is one of ``choices``; True does not count as 1."""
    options = list(choices)
    if isinstance(value, bool) or not any(isinstance(value, type(one)) and value == one for one in options):
        hint = did_you_mean(value, options)
        raise error(f"{name} must be one of {listing(options)}, got {value!r:.80}.{hint}")


def check_flag(name: str, value: object) -> bool:
    """Return ``value`` as a bool; ConfigError if it is something else."""
    if not isinstance(value, bool | np.bool_):
        raise ConfigError(f"{name} must be True or False, got {value!r:.80}.")
    return bool(value)


def check_path(name: str, value: Any) -> Path:
    """Return ``value`` as a path with ``~`` expanded; ConfigError if it is no path."""
    if not isinstance(value, str | Path) or "\0" in str(value):
        raise ConfigError(f"{name} must be a path, got {value!r:.80}.")
    return Path(value).expanduser()


def check_integer(
    name: str, value: object, low: int, high: int | None = None, error: type[Exception] = ConfigError
) -> int:
    """Return ``value`` as an int; raise ``error`` with the valid range if it is out of range or no integer."""
    if not is_integer(value) or value < low or (high is not None and value > high):
        limits = f">= {low}" if high is None else f"from {low} to {high}"
        raise error(f"{name} must be an integer {limits}, got {value!r:.80}.")
    return int(value)


def check_shape(name: str, value: Any, error: type[Exception] = ConfigError) -> tuple[int, int]:
    """Return ``value`` as (rows, columns); raise ``error`` if it is no valid size."""
    try:
        sizes = list(value)
    except TypeError:
        sizes = []
    if len(sizes) != 2 or not all(is_integer(size) and size >= 1 for size in sizes):
        raise error(f"{name} must be two integers >= 1, (rows, columns), got {value!r:.80}.")
    return int(sizes[0]), int(sizes[1])


def check_mask(mask: Any, like: Tensor, error: type[Exception] = ConfigError) -> Tensor:
    """Return ``mask`` as a bool tensor with the shape and device of ``like`` (``[num_envs]``), or raise ``error``."""
    import torch

    try:
        found = torch.as_tensor(mask, device=like.device)
    except Exception:  # `as_tensor` may raise anything for what is no array
        found = None
    if found is None or found.shape != like.shape or found.dtype != torch.bool:
        got = f"{mask!r:.60}" if found is None else f"{found.dtype} {list(found.shape)}"
        raise error(f"mask must be bool {list(like.shape)}, got {got}.")
    return found
