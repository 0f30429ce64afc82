"""From ``KEY=VALUE`` to a checked configuration: Hydra composes, the schema's metadata judges."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from warpvox.algos.interrupt import uninterrupted
from warpvox.cli.config_file import read_config_file
from warpvox.cli.help import flat_keys, flat_values, groups_of, options_of
from warpvox.cli.overrides import key_and_value, read_overrides
from warpvox.cli.trust import check_address, typed, with_code
from warpvox.code import Code
from warpvox.configs.composition import composed
from warpvox.configs.schema import COMMANDS, NODES, PRESET
from warpvox.errors import ConfigError, did_you_mean, listing
from warpvox.keys import check_values

__all__ = ["load", "load_values", "hydras_errors", "to_yaml"]

# the first that occurs in the name of a type
TYPES = {
    "list[int]": "a list of integers",
    "list": "a list",
    "int": "an integer",
    "float": "a number",
    "bool": "true or false",
    "str": "text",
}
ALIASES = {
    "env": "task",
    "lr": "learning_rate",
    "steps": "max_iterations",
    "timesteps": "max_iterations",
    "total_timesteps": "max_iterations",
    "n_envs": "num_envs",
    "batch_size": "minibatches",
}
"""Names that other libraries have for a key, by the last part of ours: for hints."""


def load(
    command: str,
    overrides: list[str],
    config_dir: Path | None = None,
    base: dict | None = None,
    home: Path | None = None,
) -> Any:
    """Compose, check and return the dataclass of a command.

    Args:
        overrides: of a single run.
        base: stored values, above the defaults and below what the overrides change.
        home: the folder whose ``config.yaml`` the base is; code that it names is only let through if the overrides
            name it again (:func:`warpvox.cli.trust.with_code`).

    Raises:
        ConfigError: anything wrong with keys, values or YAML files; code that the user has not named.
    """
    parsed = read_overrides(command, overrides)
    named = {override.key_or_group: override.value() for override in parsed}
    file = named.get("config")
    if file is not None:
        if f"{PRESET}/{command}" in named:
            raise ConfigError(f"config={file} and preset both say where to start from: give one of them.")
        base, home = read_config_file(file, command), Path(file) if Path(file).is_dir() else Path(file).parent
    with hydras_errors(f"{file}: " if file else ""):
        result = _composed(command, parsed, config_dir, base)
    check_values(result)
    if base is None:
        return with_code(result, typed(result))
    result = dataclasses.replace(result, config=None) if file else result
    check_address(result, base, named)
    return with_code(result, typed(result, named), base, home or Path.cwd())


def load_values(command: str, values: dict[str, Any]) -> Any:
    """The dataclass of a command from the values of a stored ``config.yaml``; unknown ones are left out.

    The code that they name cannot be imported before :func:`warpvox.cli.trust.with_code`.

    Raises:
        ConfigError: values of the wrong type or out of range.
    """
    with hydras_errors("The stored configuration is not valid: "), uninterrupted():
        config = copy.deepcopy(_schema(command))
        for group, name in _nodes_of(values).items():
            OmegaConf.update(config, group, NODES[group][name], merge=False)
        names = COMMANDS[command].__dataclass_fields__
        known = {key: value for key, value in values.items() if key in names}
        result = OmegaConf.to_object(OmegaConf.merge(config, known))
    check_values(result)
    return result


@functools.cache
def _schema(command: str) -> DictConfig:
    return OmegaConf.structured(COMMANDS[command])


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


@contextmanager
def hydras_errors(beginning: str = "") -> Iterator[None]:
    """Errors of Hydra and OmegaConf as ours: where and what; below their first two lines are inner names."""
    try:
        yield
    except (HydraException, OmegaConfBaseException, OverflowError, yaml.YAMLError) as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        raise ConfigError(beginning + " ".join(lines if isinstance(error, yaml.YAMLError) else lines[:2])) from None


# ------------------------------------------------------------------------------------------------- composition


@uninterrupted()  # OmegaConf's clean-up turns an interrupt into errors of its own
def _composed(command: str, parsed: list[Override], config_dir: Path | None, stored: dict | None) -> Any:
    """The dataclass of a command, unchecked."""
    chosen, changes = {}, []
    for override in parsed:
        if override.key_or_group in groups_of(command):
            _check_choice(override, config_dir)
            chosen[override.key_or_group] = str(override.input_line)
        else:
            changes.append(override)
    stored = stored and {key: value for key, value in stored.items() if key not in NODES or key not in chosen}
    chosen = {group: f"{group}={name}" for group, name in _nodes_of(stored or {}).items()} | chosen
    config = composed(command, list(chosen.values()), config_dir)
    missing = OmegaConf.missing_keys(config)
    nodes = [chosen[group] for group in NODES if group in chosen]
    defaults = config if stored is None and not missing else composed(command, nodes, config_dir)
    for key in missing:  # what a file of the user's own leaves open
        OmegaConf.update(config, key, OmegaConf.select(defaults, key))
    for override in changes:
        _set(config, override, command)
    if stored is not None:
        now, usual = (flat_values(OmegaConf.to_container(one)) for one in (config, defaults))
        changed = dict.fromkeys(key for key in now if now[key] != usual.get(key))
        below = OmegaConf.merge(defaults, stored)
        for key in [*changed, *(override.key_or_group for override in parsed if "/" not in override.key_or_group)]:
            OmegaConf.update(below, key, OmegaConf.select(config, key), merge=False)
        config = below
    return OmegaConf.to_object(config)


def _nodes_of(values: dict[str, Any]) -> dict[str, str]:
    """Groups whose nodes have names, and the name that stored values have of each."""
    sections = {group: values[group] for group in NODES if isinstance(values.get(group), dict)}
    names = {group: section["name"] for group, section in sections.items() if "name" in section}
    for group, name in names.items():
        if name not in NODES[group]:
            hint = did_you_mean(name, NODES[group])
            raise ConfigError(f"{group}.name must be one of {listing(NODES[group])}, got '{name}'.{hint}")
    return names


def _check_choice(override: Override, config_dir: Path | None) -> None:
    """Check the name of the choice of a group or of a preset."""
    group, name, (key, given) = override.key_or_group, override.value(), key_and_value(override)
    options = options_of(group, config_dir)
    if name not in options:
        more = "" if "/" in group else f" Single values are set by {key}.NAME=VALUE."
        hint = did_you_mean(name, options) if isinstance(name, str) else ""
        null = " or null" if key == PRESET else ""
        raise ConfigError(f"{key} must be one of {listing(options)}{null}, got '{given}'.{hint}{more}")


def _set(config: DictConfig, override: Override, command: str) -> None:
    """Set the value of a key; errors name both."""
    key, given = override.key_or_group, override.get_value_string()
    keys = dict(flat_keys(COMMANDS[command]))
    if override.package is not None or not _has(config, key):
        known = [name for name in keys if _has(config, name)]
        last = key.split(".")[-1]
        meant = [name for name in known if name.split(".")[-1] == ALIASES.get(last)]
        hint = did_you_mean(meant[0], meant) if meant else did_you_mean(key, known) or did_you_mean(last, known)
        nodes = NODES.get(key.partition(".")[0], {})
        owners = [
            name for name, node in nodes.items() if key.partition(".")[2] in getattr(node, "__dataclass_fields__")
        ]
        where = f", which is one of {key.partition('.')[0]}={' or '.join(owners)}" if owners else ""
        raise ConfigError(
            f"Unknown key '{override.get_key_element()}'{where}.{hint} `warpvox {command} --help` lists all keys."
        )
    kind = keys[key].type
    if dataclasses.is_dataclass(kind):
        hint = did_you_mean(key, [name for name in keys if "." not in name and name != key])
        raise ConfigError(f"{key} is set by {key}.NAME=VALUE, got '{given}'.{hint}")
    try:
        OmegaConf.update(config, key, override.value(), merge=False)
    except (OmegaConfBaseException, OverflowError) as error:
        expected = next((text for name, text in TYPES.items() if name in str(kind)), str(kind))
        optional = " or null" if "None" in str(kind) else ""
        if "Unsupported interpolation" in str(error):
            expected = "a plain value"
        raise ConfigError(f"{key} must be {expected}{optional}, got '{given}'.") from None


def _has(config: DictConfig, key: str) -> bool:
    """Whether a composed configuration has a key."""
    parent, _, name = key.rpartition(".")
    section = OmegaConf.select(config, parent) if parent else config
    return isinstance(section, DictConfig) and name in section.keys()
