"""The ``config.yaml`` of a run."""

from __future__ import annotations

import dataclasses
from typing import Any

import yaml

from warpvox.code import Code

__all__ = ["to_yaml"]


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
