"""``KEY=VALUE`` words in a form that Hydra's grammar can read.

That grammar has a meaning for quotes, brackets, commas, ``=`` and ``~``, and knows ASCII only; paths contain all of
these. The value of a key that names a path is therefore taken as it is typed, and quoted for Hydra here.
"""

from __future__ import annotations

import dataclasses
import os
import re
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException

from warpvox.cli.help import Key
from warpvox.configs.composition import quoted

__all__ = ["as_list", "is_list", "parse", "readable"]

QUOTED = re.compile(r"""'(\\.|[^'\\])*'|"(\\.|[^"\\])*\"""", re.DOTALL)
SWEEP = re.compile(r"(choice|range|glob|interval|shuffle|sort|tag|extend_list)\(")
ITEM = re.compile(rf"\s*(?:(?P<quoted>{QUOTED.pattern})|(?P<plain>[^,]*?))\s*(?:,|$)", re.DOTALL)


def readable(word: str, key: Key, multirun: bool) -> str:
    """``word`` as Hydra reads it; its key is known.

    - A path goes to the end of the word: brackets, ``=`` and letters of any script belong to it, ``~`` is the home
      folder. So does a comma if the path exists or will be written; otherwise it separates the values of a sweep.
    - A value in quotes, ``null``, and a list ``[a,b]`` where the key takes one are Hydra's.
    - Other texts are quoted if Hydra cannot read them, so that the error is about their content.
    """
    name, _, value = word.partition("=")
    if not value or value == "null" or QUOTED.fullmatch(value):
        return word
    if not key.path:
        return f"{name}={quoted(value)}" if _is_misread(word, key) else word
    listed = (is_list(key) or key.type is Any) and value[0] in "[{"
    text = _listed(word, name, value, key) if listed else _path(word, name, value, key, multirun)
    return text or word


def _is_misread(word: str, key: Key) -> bool:
    """Whether Hydra cannot read a text, or takes it for a number: a run named 007."""
    if "str" not in str(key.type) or is_list(key):
        return False
    override = parse(word)
    return override is None or not (override.is_sweep_override() or isinstance(override.value(), str | dict | list))


def _listed(word: str, name: str, value: str, key: Key) -> str | None:
    """A list or mapping of paths and other things; None: as it is."""
    if parse(word) is not None:
        return None
    inside = value[1:-1]
    nested = not is_list(key) and re.search(r"[\[{]", inside)
    if value[0] == "[" and value[-1] == "]" and not nested:
        return f"{name}=[{_items(inside)}]"
    return f"{name}={quoted(value)}" if _exists(value) else None


def _path(word: str, name: str, value: str, key: Key, multirun: bool) -> str | None:
    """A path, or several of a sweep; None: as it is."""
    override = parse(word)
    if override is not None and not override.is_sweep_override():
        read = override.value()
        if read == value and value[0] != "~":
            return None
        if key.type is Any and not isinstance(read, str):  # a number, where anything may stand
            return None
    if multirun and override is not None and SWEEP.match(value):
        return None
    if "," in value and key.path != "written" and not _exists(value):
        if multirun:
            return f"{name}={_items(value)}"
        if override is not None:  # it lists several values, which somebody else complains of
            return None
    return f"{name}={quoted(os.path.expanduser(value))}"


def _items(text: str) -> str:
    """Paths with commas between them, each quoted."""
    items = []
    for match in ITEM.finditer(text):
        if match["quoted"]:
            items.append(match["quoted"])
        elif match["plain"]:
            items.append(quoted(os.path.expanduser(match["plain"])))
    return ",".join(items)


def _exists(path: str) -> bool:
    """Whether there is such a file, or for FILE.py:NAME that file."""
    whole = os.path.expanduser(path)
    return any(os.path.exists(place) for place in (whole, whole.rpartition(":")[0]) if place)


def parse(word: str) -> Override | None:
    """A word as Hydra's grammar has it; None: it cannot be read."""
    try:
        return OverridesParser.create().parse_override(word)
    except (HydraException, ValueError, RecursionError):  # numbers of thousands of digits, brackets without end
        return None


def is_list(key: Key) -> bool:
    """Whether the values of a key are lists."""
    return "list[" in str(key.type)


def as_list(override: Override, key: Key) -> Override:
    """``export=gif`` where a list is expected becomes ``export=[gif]``."""
    if not is_list(key) or override.is_sweep_override() or isinstance(override.value(), list | dict | None):
        return override
    text = f"{override.key_or_group}=[{override.get_value_string()}]"
    return dataclasses.replace(override, input_line=text, _value=[override._value])
