"""Keys of the commands and their ``--help``, generated from the dataclasses of settings."""

import argparse
import dataclasses
import functools
from collections.abc import Iterator, Mapping
from importlib.resources import files
from typing import Any, get_type_hints

from warpvox.configs.composition import quoted
from warpvox.configs.schema import PRESET, nodes_of, schema_of
from warpvox.keys import MISSING, flat


@dataclasses.dataclass(frozen=True)
class Key:
    """A key of a command: type, default, meaning and choices."""

    type: Any
    default: Any
    help: str
    choices: tuple[str, ...] = ()

    @property
    def is_text(self) -> bool:
        """True if the value is a string or null."""
        return self.type in (str, str | None)

    @property
    def is_list(self) -> bool:
        """True if the value is a list, or null."""
        return "list[" in str(self.type)

    @property
    def takes_text(self) -> bool:
        """True if the value, or an entry of the list, may be a string."""
        return self.type is Any or "str" in str(self.type)


@functools.cache
def keys_of(command: str) -> dict[str, Key]:
    """Return the keys of a command by dotted name, each group before its own keys.

    The parts of a group are those of all its nodes.
    """
    return dict(_keys(schema_of(command), ""))


def _keys(schema: type, prefix: str) -> Iterator[tuple[str, Key]]:
    """Yield the keys of a dataclass and its nested dataclasses; ``prefix`` begins their names."""
    types = get_type_hints(schema)
    for item in dataclasses.fields(schema):
        name = prefix + item.name
        kind = types[item.name]
        default = item.default if item.default_factory is dataclasses.MISSING else item.default_factory()
        about = item.metadata
        yield name, Key(kind, default, about["help"], about.get("choices", ()))
        for one in (default, *about.get("nodes", {}).values()):
            part = one if isinstance(one, type) else type(one)
            if dataclasses.is_dataclass(part) and issubclass(part, kind):
                yield from _keys(part, f"{name}.")


def groups_of(command: str) -> list[str]:
    """Return the keys of a command that select a dataclass or a YAML file by name, except the preset."""
    names = [item.name for item in dataclasses.fields(schema_of(command))]
    # ppo and training take the name of a YAML file in the folder of the same name, and of nothing else.
    return [name for name in names if name in nodes_of(command) or name in ("ppo", "training")]


def options_of(command: str, key: str) -> list[str]:
    """List the names that a key accepts: dataclasses, YAML files, or choices."""
    folder = files("warpvox.configs") / (f"{PRESET}/{command}" if key == PRESET else key)
    known = [file.name.removesuffix(".yaml") for file in folder.iterdir() if file.is_file()] if folder.is_dir() else []
    choices = keys_of(command)[key].choices if key in keys_of(command) else ()
    return sorted({*known, *nodes_of(command).get(key, {}), *choices})


def flat_values(command: str, values: dict[str, Any]) -> dict[str, Any]:
    """Flatten nested values to dotted keys, except mappings under a key that accepts any value."""
    return flat(values, {name for name, key in keys_of(command).items() if key.type is Any})


def help_rows(command: str, values: dict[str, Any]) -> Iterator[tuple[str, str | None, str]]:
    """Yield name, default and meaning of each key of a command; groups have no default.

    Args:
        values: the composed defaults by dotted key, for those that the schema leaves open.
    """
    for name, key in keys_of(command).items():
        if name in groups_of(command):
            yield name, None, f"{key.help}: {', '.join(options_of(command, name))}"
        elif not dataclasses.is_dataclass(key.default) and len(key.choices) != 1:  # what the name of a choice sets
            choices = options_of(command, name) if name == PRESET else key.choices
            missing = any(choice not in key.help for choice in choices)
            meaning = f"{key.help}: {', '.join(choices)}" if missing else key.help
            value = values.get(name, key.default)
            yield name, "?" if value == MISSING else as_typed(value), meaning


def add_keys(parser: argparse.ArgumentParser, command: str, values: dict[str, Any]) -> None:
    """Add the keys of a command to the help of an argparse parser."""
    part = parser.add_argument_group("keys")
    for name, value, meaning in help_rows(command, values):
        if value is None:
            part = parser.add_argument_group(f"{name}.*")
        part.add_argument(name, metavar=f"{name}={value or 'NAME'}", nargs="?", help=meaning.replace("%", "%%"))


def as_typed(value: Any) -> str:
    """Format a value as a user types it on the command line."""
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{name}:{as_typed(one)}' for name, one in value.items())}}}"
    if isinstance(value, list):
        return f"[{','.join(map(as_typed, value))}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, float) and float(short := f"{value:g}") == value:
        return short
    return quoted(value) if isinstance(value, str) and set(value) & set(" ,'\"[]{}()") else str(value)
