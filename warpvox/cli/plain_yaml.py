"""The ``config.yaml`` of a run, read as plain data."""

from __future__ import annotations

from typing import Any

import yaml

from warpvox.io.reading import Unreadable

__all__ = ["LARGEST_CONFIG", "parse_yaml"]

LARGEST_CONFIG = 1_000_000
"""Bytes that a ``config.yaml`` may have."""
DEEPEST = 32
"""Levels of lists and mappings in it."""


def parse_yaml(text: str) -> Any:
    """The value of a YAML text that consists of mappings, lists, texts, numbers, true, false and null.

    No tag makes an object, and what :func:`warpvox.cli.config.to_yaml` never writes is refused: aliases (ten of them
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
