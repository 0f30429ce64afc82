"""The help of a command, made from the schema."""

from __future__ import annotations

import dataclasses
import shutil
import textwrap
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from warpvox.configs.schema import COMMANDS, GROUPS, GROUPS_OF, PRESET, PRESET_OF
from warpvox.keys import MISSING

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

__all__ = ["MAPPINGS", "Row", "command_help", "flat_keys", "flat_values", "help_rows", "options_of", "presets_of"]

MAPPINGS = ("design", "evaluations", "control_steps", "shape", "network", "screening.network", "screening.ppo")
"""Keys whose value may be a mapping."""
OPTIONS = """\
options:
  -h, --help           this text
  -m, --multirun       run all combinations of listed values: seed=1,2,3 task=Walker-v0,Climber-v0; hydra/launcher=NAME
                       and hydra/sweeper=NAME take plugins of Hydra that are installed
  -c, --cfg [job|hydra|all]
                       print the configuration that would be used, and stop
  -i, --info [all|config|defaults|defaults-tree|plugins|searchpath]
                       print how Hydra composes it, and stop
  -cd, --config-dir FOLDER
                       folder with YAML files of your own, for instance FOLDER/ppo/mine.yaml for ppo=mine"""


@dataclasses.dataclass(frozen=True)
class Key:
    """A key of a command as the schema has it."""

    type: Any
    default: Any
    help: str
    choices: tuple[str, ...] = ()
    path: str | None = None


def flat_keys(schema: type, prefix: str = "") -> Iterator[tuple[str, Key]]:
    """All keys of a dataclass by their dotted names; those with parts come before their parts."""
    types = get_type_hints(schema)
    for item in dataclasses.fields(schema):
        name = prefix + item.name
        made = item.default_factory is not dataclasses.MISSING
        default = item.default_factory() if made else item.default
        about = item.metadata
        yield name, Key(types[item.name], default, about["help"], about.get("choices", ()), about.get("path"))
        if dataclasses.is_dataclass(default):
            yield from flat_keys(type(default), name + ".")


def options_of(group: str, config_dir: Path | None = None) -> list[str]:
    """The names of the YAML files of a group, those in a folder of the user's own among them."""
    folders = [files("warpvox.configs") / group, *([config_dir / group] if config_dir else [])]
    found = (file.name for folder in folders if folder.is_dir() for file in folder.iterdir())
    return sorted({name.removesuffix(".yaml") for name in found if name.endswith(".yaml")})


def presets_of(command: str, config_dir: Path | None = None) -> dict[str, Traversable]:
    """The YAML files of the presets that a command has, by name; those in a folder of the user's own go before ours."""
    folders = [files("warpvox.configs") / PRESET, *([config_dir / PRESET] if config_dir else [])]
    presets = [preset for folder in folders if folder.is_dir() for preset in folder.iterdir()]
    found = {preset.name: preset / f"{command}.yaml" for preset in presets}
    return {name: found[name] for name in sorted(found) if found[name].is_file()}


def flat_values(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested values by their dotted keys; what :data:`MAPPINGS` names is one value, also if it is a mapping."""
    found = {}
    for name, value in values.items():
        key = prefix + name
        nested = isinstance(value, dict) and key not in MAPPINGS
        found |= flat_values(value, f"{key}.") if nested else {key: value}
    return found


@dataclasses.dataclass(frozen=True)
class Row:
    """A key as the help shows it; ``is_group``: its value is the name of a file, which sets several keys."""

    name: str
    value: str
    meaning: str
    is_group: bool = False


def help_rows(command: str, values: dict[str, Any]) -> Iterator[Row]:
    """The keys of a command; ``values``: see :func:`command_help`."""
    groups = GROUPS_OF.get(command, GROUPS)
    for name, key in flat_keys(COMMANDS[command]):
        if name in groups:
            yield Row(name, "NAME", f"{key.help}: {', '.join(options_of(name))}", is_group=True)
        elif name == PRESET_OF.get(command, (PRESET,))[0]:
            yield Row(name, _text(key.default), f"{key.help}: {', '.join(presets_of(command))}")
        elif not dataclasses.is_dataclass(key.default):
            yield Row(name, _text(values.get(name, key.default)), _meaning(key))


def command_help(command: str, summary: str, values: dict[str, Any]) -> str:
    """The help text of a command.

    Args:
        summary: what the command does.
        values: the composed defaults by dotted key, where the schema leaves them to YAML files.
    """
    width = min(shutil.get_terminal_size().columns, 120)
    lines = [
        f"usage: warpvox {command} [KEY=VALUE ...]",
        "",
        summary[0].upper() + summary[1:] + ".",
        "",
        "keys:",
    ]
    for row in help_rows(command, values):
        lines += [""] if row.is_group else []
        lines += _entry(f"{row.name}={row.value}", row.meaning, width)
    return "\n".join([*lines, "", OPTIONS])


def _meaning(key: Key) -> str:
    missing = [choice for choice in key.choices if choice not in key.help]
    return key.help + (f": {', '.join(key.choices)}" if missing else "")


def _entry(left: str, meaning: str, width: int) -> list[str]:
    margin = 34
    body = textwrap.wrap(meaning, max(width - margin, 30))
    lines = [f"  {left:<{margin - 2}}{body[0]}" if len(left) < margin - 2 else f"  {left}\n{' ' * margin}{body[0]}"]
    return lines + [" " * margin + line for line in body[1:]]


def _text(value: Any) -> str:
    if value is None:
        return "null"
    if value == MISSING:
        return "?"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ",".join(map(str, value)) + "]"
    return f"{value:g}" if isinstance(value, float) else str(value)
