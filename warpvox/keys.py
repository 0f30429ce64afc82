"""What a key of a configuration knows of itself: its meaning and its valid values, as metadata of a dataclass field."""

from __future__ import annotations

import dataclasses
from dataclasses import field
from typing import Any

from warpvox.errors import ConfigError, did_you_mean, listing

__all__ = ["MISSING", "check_values", "key"]

MISSING: Any = "???"
"""A key without a value of its own: one of the group's YAML files must set it."""


def key(
    default: Any,
    meaning: str,
    *,
    choices: tuple[str, ...] | None = None,
    low: float | None = None,
    above: float | None = None,
    high: float | None = None,
    form: str | None = None,
    path: str | None = None,
) -> Any:
    """A field that knows its meaning and valid values: ``low <= value <= high`` and ``value > above``.

    ``form``: how a list of fixed length is written, such as ``[width,height]``. ``path``: the value names something
    that may lie on a disk, which is ``read`` (one path, or several of a sweep) or ``written``; the command
    line takes it as it is typed.
    """
    limits = {"choices": choices, "low": low, "above": above, "high": high, "form": form, "path": path}
    metadata = {"help": meaning} | {name: limit for name, limit in limits.items() if limit is not None}
    if isinstance(default, list):
        return field(default_factory=lambda: list(default), metadata=metadata)
    if isinstance(default, type):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def check_values(config: Any, prefix: str = "") -> None:
    """Check choices and ranges of a dataclass of the schema.

    Raises:
        ConfigError: the first value that is not valid.
    """
    for item in dataclasses.fields(config):
        name, value = prefix + item.name, getattr(config, item.name)
        if dataclasses.is_dataclass(value):
            check_values(value, name + ".")
        elif value is not None:
            form = item.metadata.get("form")
            if form and len(value) != form.count(",") + 1:
                raise ConfigError(f"{name} must be {form}, got {value}.")
            for entry in value if isinstance(value, (list, tuple)) and item.name != "design" else [value]:
                _check_entry(name, entry, item.metadata)


def _check_entry(name: str, value: Any, limits: Any) -> None:
    choices = limits.get("choices")
    if choices is not None and value not in choices:
        hint = did_you_mean(value, choices)
        raise ConfigError(f"{name} must be one of {listing(choices)}; got {value!r}.{hint}")
    if not isinstance(value, int | float) or isinstance(value, bool):
        return
    if not abs(value) < 1e308:
        raise ConfigError(f"{name} must be a finite number, got {value!r:.40}.")
    for bound, valid, words in (
        ("low", lambda limit: value >= limit, "at least"),
        ("above", lambda limit: value > limit, "greater than"),
        ("high", lambda limit: value <= limit, "at most"),
    ):
        if bound in limits and not valid(limits[bound]):
            raise ConfigError(f"{name} must be {words} {limits[bound]}, got {value!r}.")
