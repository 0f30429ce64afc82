"""Names and values of arguments and keys: synonyms, and dataclass fields with valid ranges."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import operator
import os
import sys
from abc import ABCMeta
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import field
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np

from warpvox.checks import check_choice, design_of
from warpvox.errors import ConfigError, UnknownArgumentError, did_you_mean, listing

if TYPE_CHECKING:
    from typing_extensions import Self

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Kind = TypeVar("_Kind")

SYNONYMS = {
    "body": ("design", "designs"),
    "bodies": ("designs", "design"),
    "design": ("body", "designs"),
    "designs": ("design",),
    "eval_envs": ("episodes",),
    "evaluation": ("fitness",),
    "max_evaluations": ("max_designs",),
    "steps": ("num_steps",),
}
"""Other names of arguments and keys, each with the real names in order of preference."""

ELSEWHERE = {
    "body": "start",
    "design": "start",
    "env": "task",
    "fitness": "protocol",
    "lr": "learning_rate",
    "n_envs": "num_envs",
    "num_envs": "envs",
    "batch_size": "minibatches",
    "out": "file",
    "evaluations": "max_designs",
    "generations": "max_designs",
    "steps": "max_iterations",
    "timesteps": "max_iterations",
    "total_timesteps": "max_iterations",
    "gif": "export",
    "mp4": "export",
    "video": "export",
}
"""Names of arguments and keys in other libraries, with our name, for hints in error messages."""

MISSING: Any = "???"
"""Placeholder for a key that one of the group's YAML files must set."""


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
    """Declare a dataclass field with a description and valid values: ``low <= value <= high`` and ``value > above``.

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


def renamed(given: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """Replace :data:`SYNONYMS` in arguments by the real names; ConfigError: an argument is given twice."""
    found = {}
    for name, value in given.items():
        others = () if name in names else SYNONYMS.get(name, ())
        own = next((other for other in others if other in names), name)
        if own in found or (own != name and own in given):
            raise ConfigError(f"{name} and {own} are two names of one argument: give one of them.")
        found[own] = value
    return found


def check_known(
    given: Mapping[str, Any], *functions: Callable[..., Any], without: Collection[str] = ()
) -> dict[str, Any]:
    """Rename and check keyword arguments for ``functions``, which together define the valid names.

    Args:
        functions: the one that was called, and those (or dataclasses) that get what it does not know; the last may
            take anything.
        without: arguments of the latter that the former sets itself.

    Raises:
        UnknownArgumentError: an argument that none of them has; the message says where it belongs, or lists all.
    """
    left_out: Collection[str] = ("self",)
    names: dict[str, None] = {}
    takes_any = False
    for function in functions:
        named, takes_any = _arguments(function)
        names |= dict.fromkeys(name for name in named if name not in left_out)
        left_out = ("self", *without)
    given = renamed(given, names)
    for name in () if takes_any else given:
        if name not in names:
            owner = functions[0].__qualname__.removesuffix(".__init__")
            what = f"{owner} got an unexpected keyword argument {name!r}."
            for one in (name, ELSEWHERE.get(name, "")):
                if place := next(_ways_to_pass(one, functions[-1]), None):
                    raise UnknownArgumentError(f"{what} It is a setting of a part: {place}.")
            raise UnknownArgumentError(f"{what}{_hint(name, names)} It takes {listing(names, len(names))}.")
    return given


@functools.lru_cache
def _arguments(function: Callable[..., Any]) -> tuple[tuple[str, ...], bool]:
    """Return the names of a function's arguments, and whether it accepts any keyword."""
    found = inspect.signature(function).parameters.values()
    named = tuple(one.name for one in found if one.kind not in (one.VAR_KEYWORD, one.VAR_POSITIONAL))
    return named, any(one.kind is one.VAR_KEYWORD for one in found)


def _hint(name: str, names: Collection[str]) -> str:
    """Build a hint about an unknown argument: the most similar name, or the settings class that has it."""
    if name == "resume" and "folder" in names:
        return " A search goes on when it is called again with folder='...', its folder."
    if ELSEWHERE.get(name) in names:
        return f" Did you mean '{ELSEWHERE[name]}'?"
    if near := did_you_mean(name, names):
        return near
    kinds = _subclasses(Settings)
    owners = [kind.__name__ for kind in kinds if _is_public(kind) and name in getattr(kind, "__dataclass_fields__", ())]
    return f" It is a setting of wv.{owners[0]}." if owners else ""


def _ways_to_pass(name: str, whole: Any) -> Iterator[str]:
    """Yield ways to pass a nested setting, for instance ``ppo=wv.Ppo(steps=...)``."""
    for item in dataclasses.fields(whole) if dataclasses.is_dataclass(whole) else ():
        usual = type(item.default_factory()) if callable(item.default_factory) else None
        if usual is None or not issubclass(usual, Settings):
            continue
        # Beside a search or an evaluation the others of its kind
        base: Any = usual.__bases__[0]
        for kind in dict.fromkeys([usual, *(_subclasses(base) if base.prefix else ())]):
            fields = getattr(kind, "__dataclass_fields__", ())
            inner = f"{name}=..." if name in fields else next(_ways_to_pass(name, kind), None)
            if inner and _is_public(kind):
                yield f"{item.name}=wv.{kind.__name__}({inner})"
            elif inner:
                yield f"{item.name}={{{inner.replace(name, repr(name)).replace('=', ': ')}}}"


def _subclasses(kind: type) -> list[type]:
    """List all subclasses of ``kind``."""
    return [one for child in kind.__subclasses__() for one in (child, *_subclasses(child))]


def _is_public(kind: type) -> bool:
    return kind.__name__ in sys.modules["warpvox"].__all__


def in_words(function: _Function) -> _Function:
    """Decorate a public function so that it accepts :data:`SYNONYMS` and reports unknown arguments with a hint."""

    @functools.wraps(function)
    def call(*args: Any, **given: Any) -> Any:
        return function(*args, **check_known(given, function))

    return cast(_Function, call)


class _InitSignature:
    """Descriptor that gives a class the signature of its ``__init__``."""

    def __get__(self, _: object, kind: type) -> inspect.Signature:
        return inspect.signature(functools.partial(kind.__init__, None))


class _Checked(ABCMeta):  # so that evaluations of a user's own may be abstract
    """Metaclass of :class:`Settings` that checks the names of arguments."""

    def __call__(cls: type[_Kind], *args: Any, **given: Any) -> _Kind:
        if args and cast(Any, cls).prefix:
            example = [f"{name}=..." for name in _arguments(cls)[0][1:2]]
            raise ConfigError(f"{cls.__name__} takes settings by name, {cls.__name__}({''.join(example)}); got {args}.")
        return type.__call__(cls, *args, **check_known(given, cls))


class Settings(metaclass=_Checked):
    """Base class of dataclasses that validate their arguments and values on construction.

    Raises:
        ConfigError: an unknown argument, or a value of the wrong type or out of range.
    """

    __signature__ = _InitSignature()
    prefix = ""

    def __init_subclass__(cls) -> None:
        if "__repr__" not in cls.__dict__:
            cls.__repr__ = Settings.__repr__  # in place of the dataclass's own, which would show all

    def __repr__(self) -> str:
        """Show only the settings that differ from the defaults."""
        shown = []
        for item in dataclasses.fields(cast(Any, self)):
            value = getattr(self, item.name)
            usual = item.default_factory() if callable(item.default_factory) else item.default
            if repr(value) != repr(usual):  # arrays have no truth value
                shown.append(f"{item.name}={value!r}")
        return f"{type(self).__name__}({', '.join(shown)})"

    @classmethod
    def of(cls, values: Mapping[str, Any], origin: object = "The stored configuration") -> Self:
        """Build settings from a stored configuration, ignoring unknown keys.

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
    """Raise ConfigError unless all values of a dataclass are valid and in range; nested dataclasses are skipped."""
    for item in dataclasses.fields(config):
        _check_value(prefix + item.name, getattr(config, item.name), item.metadata)


def _check_value(name: str, value: Any, limits: Mapping[str, Any]) -> None:
    """Raise ConfigError unless a value, or each entry of a list, is valid and in range; None is valid."""
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
    """Convert the values of a dataclass to the types of its fields, except those named in ``without``.

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
    """Resolve the types of a dataclass's fields."""
    return get_type_hints(kind)


def flat(values: Mapping[str, Any], whole: Collection[str] = (), prefix: str = "") -> dict[str, Any]:
    """Flatten nested dictionaries to dotted keys, except dictionaries under keys in ``whole``."""
    found = {}
    for name, value in values.items():
        key = prefix + name
        found |= flat(value, whole, f"{key}.") if isinstance(value, dict) and key not in whole else {key: value}
    return found


def changed(usual: Any, values: Mapping[str, Any], name: str) -> Any:
    """Replace some values of the settings ``usual``; error messages begin with ``name``."""
    for wrong in values:
        if not isinstance(wrong, str):
            raise ConfigError(f"{name} takes settings by name, got {wrong!r:.80}.")
    try:
        return dataclasses.replace(usual, **renamed(values, usual.__dataclass_fields__))
    except ConfigError as error:
        text = str(error)
        first = text.partition(" ")[0].partition(".")[0]  # in many errors the field
        joint = "." if first in usual.__dataclass_fields__ else ": "
        raise ConfigError(f"{name}{joint}{text}") from None


def converted(value: Any, kind: Any, name: str, none: str = "None") -> Any:
    """Convert ``value`` to the type of a field: numpy numbers to Python's, tuples to lists.

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
    """Convert arrays, tuples, paths and the like to lists, mappings, strings and numbers.

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
