"""Checks of values that others give: what was expected, what was got."""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard

import numpy as np

from warpvox.errors import ConfigError, UnknownArgumentError, WarpvoxError, did_you_mean, listing

if TYPE_CHECKING:
    from torch import Tensor
    from typing_extensions import TypeIs


def is_integer(value: object) -> TypeIs[int]:
    """Return whether a value is an integer of Python or numpy; ``True`` is none."""
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
    """Return ``thing.design``, such as the body of a robot of the zoo, a run or a policy; without it, ``thing``."""
    return getattr(thing, "design", thing)


def check_choice(name: str, value: object, choices: Iterable[object], error: type[WarpvoxError] = ConfigError) -> None:
    """Raise ``error`` unless ``value`` is one of ``choices``; True is not 1."""
    options = list(choices)
    if isinstance(value, bool) or not any(isinstance(value, type(one)) and value == one for one in options):
        hint = did_you_mean(value, options)
        raise error(f"{name} must be one of {listing(options)}, got {value!r:.80}.{hint}")


def check_flag(name: str, value: object) -> bool:
    """Return ``value`` as bool, or raise ConfigError."""
    if not isinstance(value, bool | np.bool_):
        raise ConfigError(f"{name} must be True or False, got {value!r:.80}.")
    return bool(value)


def check_path(name: str, value: Any) -> Path:
    """Return ``value`` as a path with ``~`` expanded, or raise ConfigError."""
    if not isinstance(value, str | Path) or "\0" in str(value):
        raise ConfigError(f"{name} must be a path, got {value!r:.80}.")
    return Path(value).expanduser()


def check_known(given: Iterable[str], *functions: Callable[..., Any], without: Iterable[str] = ()) -> None:
    """Raise UnknownArgumentError if an argument is none of ``functions``' arguments; it lists them all.

    Args:
        functions: the one that was called, and those (or dataclasses) that get what it does not know; the last may
            take anything.
        without: arguments of the latter that the former sets itself.
    """
    left_out = ("self",)
    names: dict[str, None] = {}
    for function in functions:
        named, takes_any = _arguments(function)
        names |= dict.fromkeys(name for name in named if name not in left_out)
        left_out = ("self", *without)
    for name in () if takes_any else given:
        if name not in names:
            owner = functions[0].__qualname__.removesuffix(".__init__")
            hint = did_you_mean(name, names)
            known = f"There are {listing(names, len(names))}."
            raise UnknownArgumentError(f"{owner} got an unexpected keyword argument {name!r}.{hint} {known}")


@functools.lru_cache
def _arguments(function: Callable[..., Any]) -> tuple[tuple[str, ...], bool]:
    """Return the names of a function's arguments, and whether it takes others by name."""
    found = inspect.signature(function).parameters.values()
    named = tuple(one.name for one in found if one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL))
    return named, any(one.kind is one.VAR_KEYWORD for one in found)


def check_integer(
    name: str, value: object, low: int, high: int | None = None, error: type[Exception] = ConfigError
) -> int:
    """Return ``value`` as int, or raise ``error`` with the valid range."""
    if not is_integer(value) or value < low or (high is not None and value > high):
        limits = f">= {low}" if high is None else f"from {low} to {high}"
        raise error(f"{name} must be an integer {limits}, got {value!r:.80}.")
    return int(value)


def check_shape(name: str, value: Any, error: type[Exception] = ConfigError) -> tuple[int, int]:
    """Return ``value`` as (rows, columns), or raise ``error``."""
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
