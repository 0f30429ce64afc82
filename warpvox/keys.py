"""Keys of configurations as fields of dataclasses: meaning and its valid values, as metadata of a dataclass field."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import operator
import os
from collections.abc import Collection, Mapping
from dataclasses import field
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, cast, get_args, get_origin, get_type_hints

import numpy as np

from warpvox.checks import check_choice, check_known, design_of
from warpvox.errors import ConfigError

if TYPE_CHECKING:
    from typing_extensions import Self

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
    nodes: Mapping[str, Any] | None = None,
) -> Any:
    """Return a dataclass field with a description and valid values: ``low <= value <= high`` and ``value > above``.

    Args:
        form: how a list of fixed length is written, such as ``[width,height]``.
        nodes: the dataclasses, or instances of them, that the key may have, by the names that choose them.
    """
    limits = {"choices": choices, "low": low, "above": above, "high": high, "form": form, "nodes": nodes}
    metadata = {"help": meaning} | {name: limit for name, limit in limits.items() if limit is not None}
    if isinstance(default, list):
        return field(default_factory=lambda: list(default), metadata=metadata)
    if callable(default):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


class _OfInit:
    """The signature of a class as that of ``__init__``, not that of ``__new__``."""

    def __get__(self, _: object, kind: type) -> inspect.Signature:
        return inspect.signature(functools.partial(kind.__init__, None))


class Settings:
    """Base of dataclasses that check their arguments and values when an object is made.

    Raises:
        ConfigError: an unknown argument, or a value of the wrong type or out of range.
    """

    __signature__ = _OfInit()
    prefix = ""

    def __new__(cls, *_: Any, **given: Any) -> Self:
        check_known(given, cls.__init__)
        return super().__new__(cls)

    @classmethod
    def of(cls, values: Mapping[str, Any], origin: object = "The stored configuration") -> Self:
        """Return the settings from a stored configuration; keys that are no fields are ignored.

        Raises:
            ConfigError: values that are not valid; ``origin``, such as the file that they are from, is named.
        """
        names = {item.name for item in dataclasses.fields(cast(Any, cls))}
        try:
            return cls(**{name: value for name, value in values.items() if name in names})
        except ConfigError as error:
            raise ConfigError(f"{origin} is not valid: {error}") from None

    def __post_init__(self) -> None:
        convert(self, self.prefix)
        check_values(self, self.prefix)


def check_values(config: Any, prefix: str = "") -> None:
    """Raise ConfigError unless all values of a dataclass are valid choices in range; nested parts are not checked."""
    for item in dataclasses.fields(config):
        _check_value(prefix + item.name, getattr(config, item.name), item.metadata)


def _check_value(name: str, value: Any, limits: Mapping[str, Any]) -> None:
    """Raise ConfigError unless a value, or each entry of a list, is a valid choice in range; None is valid."""
    form = limits.get("form")
    if form and value is not None and len(value) != form.count(",") + 1:
        raise ConfigError(f"{name} must be {form}, got {value}.")
    for entry in value if isinstance(value, (list, tuple)) and name != "design" else [value]:
        if "choices" in limits and entry is not None:
            check_choice(name, entry, limits["choices"])
        if not isinstance(entry, int | float) or isinstance(entry, bool):
            continue
        if not abs(entry) < 1e308:
            raise ConfigError(f"{name} must be a finite number, got {entry!r:.40}.")
        if isinstance(entry, int) and abs(entry) >= 1 << 63:  # as a seed torch does not take it
            raise ConfigError(f"{name} must be an integer of at most 63 bits, got {entry!r:.40}.")
        for bound, valid, words in (
            ("low", operator.ge, "at least"),
            ("above", operator.gt, "greater than"),
            ("high", operator.le, "at most"),
        ):
            if bound in limits and not valid(entry, limits[bound]):
                raise ConfigError(f"{name} must be {words} {limits[bound]}, got {entry!r}.")


def convert(config: Any, prefix: str = "", without: Collection[str] = ()) -> None:
    """Convert the values of a dataclass to the types of its fields, except the fields ``without``.

    Numpy's numbers, tuples and mappings are converted.

    ConfigError: a value of another type, or a part that has no field of a name.
    """
    hints = _hints(type(config))
    for item in dataclasses.fields(config):
        if item.name not in without:
            value = getattr(config, item.name)
            usual = item.default_factory
            if isinstance(value, Mapping) and callable(usual) and dataclasses.is_dataclass(hints[item.name]):
                value = changed(usual(), value, prefix + item.name)
            # also of a frozen dataclass
            object.__setattr__(config, item.name, converted(value, hints[item.name], prefix + item.name))


@functools.lru_cache
def _hints(kind: type) -> dict[str, Any]:
    """Return the types of the fields of a dataclass."""
    return get_type_hints(kind)


def flat(values: Mapping[str, Any], whole: Collection[str] = (), prefix: str = "") -> dict[str, Any]:
    """Return nested values by dotted keys; the values of keys in ``whole`` are kept even if they are dictionaries."""
    found = {}
    for name, value in values.items():
        key = prefix + name
        found |= flat(value, whole, f"{key}.") if isinstance(value, dict) and key not in whole else {key: value}
    return found


def changed(usual: Any, values: Mapping[str, Any], name: str) -> Any:
    """Return the settings ``usual`` with some of their ``values`` replaced; errors begin with ``name``."""
    for wrong in values:
        if not isinstance(wrong, str):
            raise ConfigError(f"{name} takes settings by name, got {wrong!r:.80}.")
    try:
        return dataclasses.replace(usual, **values)
    except ConfigError as error:
        text = str(error)
        first = text.partition(" ")[0].partition(".")[0]  # in many errors the field
        joint = "." if first in usual.__dataclass_fields__ else ": "
        raise ConfigError(f"{name}{joint}{text}") from None


def converted(value: Any, kind: Any, name: str, none: str = "None") -> Any:
    """Return ``value`` in the type of a field: numpy's numbers as Python's, tuples as lists.

    ConfigError: it is of another type; ``name``: of the field, ``none``: how the user writes None.
    """
    optional = type(None) in get_args(kind)
    kind = get_args(kind)[0] if optional else kind
    if kind is Any or (optional and isinstance(value, type(None))):
        return value
    if hasattr(kind, "__dataclass_fields__"):
        if not isinstance(value, kind):
            raise ConfigError(f"{name} must be {kind.__name__}(...) or values by name, got {value!r:.80}.")
        return value
    plain = get_origin(kind) or kind
    accepted = {
        int: Integral,
        float: Real,
        bool: bool | np.bool_,
        str: str | os.PathLike,
        list: list | tuple | np.ndarray,
    }
    if not isinstance(value, accepted[plain]) or (plain is not bool and isinstance(value, bool)):
        kinds = {int: "an integer", float: "a number", bool: "true or false", str: "text", list: "a list"}
        raise ConfigError(f"{name} must be {kinds[plain]}{f' or {none}' if optional else ''}, got {value!r:.80}.")
    if plain is list:
        return [converted(entry, get_args(kind)[0], name) for entry in value]
    if plain is str:
        text = value if isinstance(value, str) else os.path.expanduser(value)
        if "\0" in text:  # which no path has
            raise ConfigError(f"{name} must be a text without null characters, got {value!r:.80}.")
        return text
    try:
        return plain(value)
    except OverflowError:  # an integer of more digits than a float can have
        raise ConfigError(f"{name} must be a finite number, got {value!r:.40}.") from None


def plain(value: Any, name: str) -> Any:
    """Return ``value`` as lists, mappings, strings and numbers, converted from arrays, tuples, paths and the like.

    An object with a body is replaced by the body.

    ConfigError: it is or holds anything else.
    """
    value = design_of(value)
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain(entry, name) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry, name) for entry in value]
    if isinstance(value, os.PathLike):
        return os.path.expanduser(value)
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise ConfigError(f"{name} cannot be a {type(value).__name__}: expected text, a number, a list or an array.")
