"""Commands and their dataclasses of keys: type, meaning, range.

The command line composes the dataclass of a command with the YAML files beside it, checks types, choices and ranges
against the metadata of its fields, and prints the same metadata as ``warpvox COMMAND --help``. A module with such
dataclasses is imported when one of its commands is.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from warpvox.keys import key

COMMANDS = {
    "train": "train",
    "play": "show",
    "export": "show",
    "codesign": "codesign",
    "curves": "show",
    "evaluate": "show",
    "design": "tools",
    "zoo": "tools",
    "tasks": "tools",
    "info": "tools",
}
"""Commands, each with the module of this package that has the dataclass ``<Command>Config``."""

PRESET = "preset"
"""Key that selects a preset, a file of ``configs/preset/COMMAND``."""

EXPORTS = ("usd", "gif", "mp4", "html", "png", "strip")
SHOW = ("auto", "on", "off")
CONFIG_FILE = "file to take values from, such as a run's config.yaml (or its folder); keys that are given override them"


def schema_of(command: str) -> type:
    """Return the dataclass of a command."""
    return getattr(import_module(f"warpvox.configs.{COMMANDS[command]}"), f"{command.capitalize()}Config")


def nodes_of(command: str) -> dict[str, Mapping[str, Any]]:
    """Return the groups of a command with typed choices (dataclasses or instances), by choice name.

    Where they are of different dataclasses, these have a common base, which is the type of the command's field, and a
    first field, ``name`` or ``algorithm``, by which a stored configuration says which of them it has.
    """
    fields = dataclasses.fields(schema_of(command))
    return {item.name: item.metadata["nodes"] for item in fields if "nodes" in item.metadata}


@dataclass
class PresetConfig:
    """Key of commands with presets: sets of defaults in ``configs/preset/COMMAND/NAME.yaml``."""

    preset: str | None = key(
        None, "a named set of other defaults, which the keys that are given override; null: the defaults shown here"
    )
