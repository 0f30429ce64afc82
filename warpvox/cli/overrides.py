"""``KEY=VALUE`` words as Hydra's grammar has them.

That grammar has a meaning for quotes, brackets, commas and ``~``, and knows ASCII only. A text that it cannot read, or
that it takes for something else, is quoted for it here.
"""

import dataclasses
import itertools
import os
import re
from collections.abc import Iterable
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException

from warpvox.cli.help import Key, keys_of
from warpvox.configs.composition import quoted
from warpvox.configs.schema import PRESET
from warpvox.errors import ConfigError

RENAMED = {"finalists": "evaluation.finalists", "pretrained": "evaluation.pretrained"}
RENAMED |= {"search.algorithm": "search", "evaluation.name": "evaluation"}
"""Keys of design searches as config.yaml has them, or as they were before evaluations had settings of their own."""
FILES = {"export": "format", "format": "export"}
"""Names of one list: what a command writes beside its results, and what ``export`` itself writes."""
MOST_RUNS = 10_000
"""Runs of a sweep, all of which are checked before the first begins."""
QUOTED = re.compile(r"""'(\\.|[^'\\])*'|"(\\.|[^"\\])*\"""", re.DOTALL)


def read_overrides(command: str, words: list[str], sweeps: bool = False) -> list[Override]:
    """Overrides as Hydra takes them. Keys may still be unknown.

    Args:
        sweeps: several values may be listed.
    """
    keys = keys_of(command)
    no_preset = f"{PRESET}=null" if PRESET in keys else None  # which is the default, and no choice of Hydra's
    parsed = [_read(command, word, keys, sweeps) for word in words if word != no_preset]
    names = [override.key_or_group for override in parsed]
    for override in parsed:
        if names.count(override.key_or_group) > 1:
            raise ConfigError(f"The key '{key_and_value(override)[0]}' is given more than once.")
    return parsed


def expand(overrides: Iterable[Override]) -> list[list[str]]:
    """The overrides of each run: one list for each combination of the values that are listed."""
    texts, runs = [], 1
    for override in overrides:
        if override.is_interval_sweep():
            raise ConfigError(f"'{override.input_line}': an interval has no end; use range(...) or choice(...).")
        try:
            found = override.sweep_string_iterator() if override.is_sweep_override() else [override.get_value_string()]
            values = list(itertools.islice(found, MOST_RUNS + 1))
        except ValueError:  # a range of steps of 0
            values = []
        runs *= len(values)
        if not 0 < runs <= MOST_RUNS:
            many = "too many" if runs else "no"
            raise ConfigError(f"'{override.input_line:.200}' makes {many} runs: expected 1 to {MOST_RUNS:,} in all.")
        texts.append([f"{override.get_key_element()}={value}" for value in values])
    return [list(run) for run in itertools.product(*texts)]


def key_and_value(given: Override | str) -> tuple[str, str]:
    """The key and the value of an override as people type and read them."""
    override: Any = parse(given) if isinstance(given, str) else given
    key, value = override.key_or_group, override.value()
    if key.startswith(f"{PRESET}/"):
        key = PRESET
    return key, value if isinstance(value, str) else override.get_value_string()


def parse(word: str) -> Override | None:
    """A word as Hydra's grammar has it; None: it cannot be read."""
    try:
        return OverridesParser.create().parse_override(word)
    except (HydraException, ValueError, RecursionError):  # numbers of thousands of digits, brackets without end
        return None


def _read(command: str, word: str, keys: dict[str, Key], sweeps: bool) -> Override:
    name, given, value = word.partition("=")
    if name == "designs" and given:  # short for the bodies
        name = next((key for key in ("designs.bodies", name, "design") if key in keys), name)
    name = FILES.get(name, name) if given and name not in keys else name
    if command == "codesign":
        name = RENAMED.get(name, name.replace("screening.", "evaluation."))
    key = keys.get(name)
    if given and key is not None:
        value = _readable(value, key, sweeps)
    name = f"{PRESET}/{command}@_global_" if name == PRESET else name
    override = parse(f"{name}{given}{value}")
    if override is None:
        raise ConfigError(f"'{word:.200}' is not KEY=VALUE, or its value has unbalanced brackets or quotes.")
    if override.type is not OverrideType.CHANGE:
        name = override.key_or_group
        raise ConfigError(f"'{word}': keys cannot be added or removed; write {name}=VALUE.")
    if override.is_sweep_override() and not sweeps:
        raise ConfigError(
            f"'{word}' lists several values: add --multirun to run them one after another (a value that is itself a"
            f" list is written {name}=[a,b], one that has commas {name}=\"'a,b'\")."
        )
    return _as_list(override) if key is not None and _takes_list(key) else override


def _readable(value: str, key: Key, sweeps: bool) -> str:
    """A value in quotes if it is a text that Hydra cannot read, or would take for a number, list or other thing."""
    if value in ("", "null") or QUOTED.fullmatch(value) or not (key.type is Any or "str" in str(key.type)):
        return value
    if key.path and (value.startswith("~") or os.path.exists(value)):
        return quoted(os.path.expanduser(value))
    override = parse(f"key={value}")
    if override is None:
        listed = value.startswith("[") and value.endswith("]")
        if _takes_list(key) and listed:
            return f"[{_each_quoted(value[1:-1])}]"
        if key.type is Any and value[0] in "[{":
            return value
        return _each_quoted(value) if sweeps else quoted(value)
    is_other = not (override.is_sweep_override() or isinstance(override.value(), str | dict))
    return quoted(value) if is_other and key.type is not Any and not _takes_list(key) else value


def _each_quoted(value: str) -> str:
    """Texts with commas between them, each in quotes."""
    return ",".join(quoted(os.path.expanduser(item.strip(" '\""))) for item in value.split(","))


def _takes_list(key: Key) -> bool:
    return "list[" in str(key.type)


def _as_list(override: Override) -> Override:
    """``export=gif`` where a list is expected becomes ``export=[gif]``; so does each value of a sweep."""
    if override.is_sweep_override():
        values = [value if value[0] in "[{" else f"[{value}]" for value in override.sweep_string_iterator()]
        return parse(f"{override.key_or_group}={','.join(values)}") or override
    if isinstance(override.value(), list | dict | None):
        return override
    text = f"{override.key_or_group}=[{override.get_value_string()}]"
    return dataclasses.replace(override, input_line=text, _value=[override._value])
