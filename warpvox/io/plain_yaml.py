"""The ``config.yaml`` of a run, plain data in both directions."""

from __future__ import annotations

import dataclasses
from typing import Any

import yaml

from warpvox.code import Code
from warpvox.io.reading import Unreadable

__all__ = ["LARGEST_CONFIG", "parse_yaml", "to_yaml"]

LARGEST_CONFIG = 1_000_000
"""Bytes that a ``config.yaml`` may have."""
DEEPEST = 32
"""Levels of lists and mappings in it."""


def parse_yaml(text: str) -> Any:
    """The value of a YAML text that consists of mappings, lists, texts, numbers, true, false and null.

    No tag makes an object, and what :func:`to_yaml` never writes is refused: aliases (ten of them
    can stand for a billion entries once a configuration is copied) and ``${...}``, which would be looked up elsewhere.

    Raises:
        Unreadable: anything else; the text is the reason.
    """
    try:
        return yaml.load(text, Loader=_PlainLoader)
    except yaml.YAMLError as error:
        raise Unreadable(" ".join(str(error).split())[:200]) from None
    except (ValueError, TypeError, LookupError, AttributeError) as error:  # odd dates and numbers
        raise Unreadable(str(error)[:200] or type(error).__name__) from None


class _PlainLoader(yaml.SafeLoader):
    """Plain values only, each of them written where it belongs."""

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            raise yaml.MarkedYAMLError("there is an alias", problem_mark=event.start_mark)
        if isinstance(event, yaml.ScalarEvent) and "${" in event.value:
            raise yaml.MarkedYAMLError("there is a reference ${...}", problem_mark=event.start_mark)
        if self.depth >= DEEPEST:
            raise yaml.MarkedYAMLError("it is nested too deeply", problem_mark=event.start_mark)
        self.depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self.depth -= 1


def to_yaml(config: Any) -> str:
    """A configuration as YAML; lists of plain values take one line."""
    return yaml.dump(dataclasses.asdict(config), Dumper=_Dumper, sort_keys=False, width=110)


class _Dumper(yaml.SafeDumper):
    """Rows of a body on one line each."""


def _represent_list(dumper: _Dumper, values: list) -> yaml.Node:
    flat = not any(isinstance(value, list | dict) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flat)


_Dumper.add_representer(list, _represent_list)
_Dumper.add_representer(Code, lambda dumper, code: dumper.represent_str(str(code)))
