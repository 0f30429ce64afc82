"""From ``KEY=VALUE`` to a checked configuration: Hydra composes, the schema's metadata judges."""

import dataclasses
from pathlib import Path
from typing import Any, cast

from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf

from warpvox.algos.interrupt import uninterrupted
from warpvox.cli.help import flat_values, groups_of, keys_of
from warpvox.cli.overrides import key_and_value, read_overrides
from warpvox.code import with_passed_code
from warpvox.configs.composition import composed, hydras_errors, quoted
from warpvox.configs.schema import PRESET, nodes_of, schema_of
from warpvox.errors import ConfigError, did_you_mean
from warpvox.io.reading import LARGEST_CONFIG, Unreadable, parse_yaml, read_text
from warpvox.keys import check_value, check_values, converted
from warpvox.runs import CONFIG, without_services

ALIASES = {"env": "task", "lr": "learning_rate", "n_envs": "num_envs", "num_envs": "envs", "batch_size": "minibatches"}
ALIASES |= {"out": "file", "evaluations": "max_evaluations"} | dict.fromkeys(("gif", "mp4", "video"), "export")
ALIASES |= dict.fromkeys(("steps", "timesteps", "total_timesteps"), "max_iterations")
"""Names that other libraries have for a key, by the last part of ours: for hints."""
NOT_TAKEN = ("resume", "report", "config")
"""Keys of ``config=FILE`` that say what the run did that the file has come from, not with what."""


def load(
    command: str,
    overrides: list[str],
    config_dir: Path | None = None,
    base: dict | None = None,
    home: Path | None = None,
) -> Any:
    """Compose, check and return the dataclass of a command.

    Args:
        base: stored values, above the defaults and below what the overrides change.
        home: the folder whose ``config.yaml`` the base is; code that it names is only let through if the overrides
            name it again (:func:`warpvox.code.with_passed_code`).
    """
    parsed = read_overrides(command, overrides)
    named: dict[str, Any] = {override.key_or_group: override.value() for override in parsed}
    file = named.get("config")
    if file is not None:
        if f"{PRESET}/{command}" in named:
            raise ConfigError(f"config={file} and {PRESET} both say where to start: give one of them.")
        base, home = _read_file(Path(str(file)).expanduser())
    place = file or (home and home / CONFIG)
    origin = f"{place}: " if place else ""
    # OmegaConf's clean-up turns an interrupt into errors of its own
    with hydras_errors(f"{file}: " if file else ""), uninterrupted():
        whole = _composed(command, parsed, config_dir, base, origin)
        try:
            result: Any = OmegaConf.to_object(whole)
            check_values(result)
        except ConfigError as error:  # the overrides have been checked one by one
            raise ConfigError(f"{origin}{error}") from None
    result = dataclasses.replace(result, config=None) if file else result
    return with_passed_code(result, named, place or config_dir)


def load_start(command: str, overrides: list[str], config_dir: Path | None) -> Any:
    """The dataclass of a command; with ``resume`` only its override and those of ``report`` and ``output_dir`` count.

    What else is given may be about parts that only the run has which goes on.
    """
    keys = {word.partition("=")[0]: word for word in overrides}
    if "resume" in keys:
        config = load(command, [keys[key] for key in ("resume", "report", "output_dir") if key in keys], config_dir)
        if config.resume is not None:
            return config
    return load(command, overrides, config_dir)


def load_values(command: str, values: dict[str, Any]) -> Any:
    """The dataclass of a command from the values of a stored ``config.yaml``; unknown ones are left out.

    The code that they name cannot be imported before :func:`warpvox.code.with_passed_code`.
    """
    known = {item.name: values[item.name] for item in dataclasses.fields(schema_of(command)) if item.name in values}
    with hydras_errors("The stored configuration is not valid: "), uninterrupted():
        result = OmegaConf.to_object(OmegaConf.merge(composed(command, _nodes_of(command, known)), known))
    check_values(result)
    return result


def _read_file(path: Path) -> tuple[dict[str, Any], Path]:
    """The values of ``config=FILE``, which is a YAML file or the folder of a run, and the folder that it lies in."""
    path = path / CONFIG if path.is_dir() else path
    try:
        values = parse_yaml(read_text(path, LARGEST_CONFIG))
    except Unreadable as error:
        raise ConfigError(f"config must be a YAML file or the folder of a run; {path}: {error}.") from None
    if not isinstance(values, dict) or not values:
        raise ConfigError(f"config must be a YAML file or the folder of a run; {path} holds no KEY: VALUE.")
    return without_services({name: value for name, value in values.items() if name not in NOT_TAKEN}), path.parent


def _composed(
    command: str, parsed: list[Override], config_dir: Path | None, stored: dict | None, origin: str
) -> DictConfig:
    """The configuration of a command, unchecked; errors in stored values begin with ``origin``, their file."""
    groups = [override for override in parsed if override.key_or_group in groups_of(command)]
    choices = [f"{one.get_key_element()}={quoted(key_and_value(one)[1])}".replace("${", "\\${") for one in groups]
    named, with_nodes = {override.key_or_group for override in groups}, nodes_of(command)
    stored = stored and {key: value for key, value in stored.items() if key not in with_nodes or key not in named}
    nodes = [choice for choice in choices if choice.partition("=")[0] in with_nodes] + _nodes_of(command, stored or {})
    config = composed(command, list(dict.fromkeys(choices + nodes)), config_dir)
    for override in parsed:
        if override not in groups:
            _set(config, override, command)
    if stored is None:
        return config
    defaults = composed(command, nodes, config_dir)
    for key in flat_values(command, stored):
        if not _has(defaults, key):
            raise _unknown(command, key, defaults)
    now, usual = (flat_values(command, cast(Any, OmegaConf.to_container(one))) for one in (config, defaults))
    with hydras_errors(origin):
        below = cast(DictConfig, OmegaConf.merge(defaults, stored))
    changed = [key for key in now if now[key] != usual.get(key)]
    for key in [*changed, *(override.key_or_group for override in parsed if _has(config, override.key_or_group))]:
        OmegaConf.update(below, key, OmegaConf.select(config, key), merge=False)
    return below


def _nodes_of(command: str, values: dict[str, Any]) -> list[str]:
    """The overrides that choose the nodes of stored values, by their names."""
    sections = {group: values[group] for group in nodes_of(command) if isinstance(values.get(group), dict)}
    names = {group: one.get("name", one.get("algorithm")) for group, one in sections.items()}
    return [f"{group}={quoted(str(name))}" for group, name in names.items() if name]


def _set(config: DictConfig, override: Override, command: str) -> None:
    key, keys = override.key_or_group, keys_of(command)
    if override.package is not None or not _has(config, key) or key not in keys:
        raise _unknown(command, override.get_key_element(), config)
    if dataclasses.is_dataclass(keys[key].type):
        hint = did_you_mean(key, [name for name in keys if "." not in name and name != key])
        raise ConfigError(f"{key} is set by {key}.NAME=VALUE, got '{override.get_value_string()}'.{hint}")
    with hydras_errors(f"{key}={override.get_value_string():.40}: "):
        check_value(key, converted(override.value(), keys[key].type, key, "null"), keys[key].limits)
        OmegaConf.update(config, key, override.value(), merge=False)


def _has(config: DictConfig, key: str) -> bool:
    parent, _, name = key.rpartition(".")
    section = OmegaConf.select(config, parent) if parent else config
    return isinstance(section, DictConfig) and name in set(section)


def _unknown(command: str, key: str, config: DictConfig) -> ConfigError:
    """The error that names the nearest key of a composed configuration."""
    keys, last = keys_of(command), key.split(".")[-1]
    known = [name for name in keys if _has(config, name)]
    hint = did_you_mean(key, known) or did_you_mean(last, known)
    if key in keys:
        group, _, name = key.partition(".")
        owners = [one for one, node in nodes_of(command)[group].items() if name in node.__dataclass_fields__]
        hint = f" It is a setting of {' and '.join(f'{group}={one}' for one in owners)}."
    for name in known:
        if name.split(".")[-1] == ALIASES.get(last):
            hint = f" Did you mean '{name}'?"
            break
    return ConfigError(f"Unknown key '{key}'.{hint} `warpvox {command} --help` lists all keys.")
