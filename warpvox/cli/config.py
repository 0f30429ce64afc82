"""From ``KEY=VALUE`` to a checked configuration: Hydra composes, the schema's metadata judges."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml
from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from warpvox.algos.interrupt import uninterrupted
from warpvox.cli.config_file import read_config_file
from warpvox.cli.help import MAPPINGS, flat_keys, options_of, presets_of
from warpvox.cli.hydra_parts import CFG, INFO, is_plugin_key, one_line
from warpvox.cli.quoting import as_list, parse, readable
from warpvox.configs.composition import composed, schema_of
from warpvox.configs.schema import COMMANDS, GROUPS, GROUPS_OF, PRESET, PRESET_OF
from warpvox.errors import ConfigError, did_you_mean, listing
from warpvox.io.plain_yaml import to_yaml
from warpvox.keys import check_values
from warpvox.trust import check_address, typed, with_code

__all__ = [
    "Arguments",
    "check_values",
    "composition",
    "expand",
    "load",
    "load_values",
    "parse_overrides",
    "read_arguments",
    "to_yaml",
]

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
FLAGS = {"-h": "help", "-m": "multirun", "-c": "cfg", "-i": "info", "-cd": "config_dir"}
FLAGS |= {f"--{name.replace('_', '-')}": name for name in FLAGS.values()}
CHOICES = {"cfg": CFG, "info": INFO}


@dataclass
class Arguments:
    """The words after a command: overrides of keys, those of Hydra's launcher and sweeper, options."""

    overrides: list[str] = field(default_factory=list)
    plugins: list[str] = field(default_factory=list)
    help: bool = False
    multirun: bool = False
    cfg: str | None = None
    info: str | None = None
    config_dir: Path | None = None


def read_arguments(words: list[str]) -> Arguments:
    """Sort options from overrides.

    Raises:
        ConfigError: an unknown option, or a folder of configurations that does not exist.
    """
    arguments, rest = Arguments(), list(words)
    while rest:
        word = rest.pop(0)
        flag, _, value = word.partition("=")
        name = FLAGS.get(flag)
        if not word.startswith("-"):
            (arguments.plugins if is_plugin_key(word) else arguments.overrides).append(word)
        elif name in CHOICES:
            if not value:
                value = rest.pop(0) if rest and rest[0] in CHOICES[name] else CHOICES[name][0]
            if value not in CHOICES[name]:
                raise ConfigError(f"{flag} takes {listing(CHOICES[name])}, got '{value}'.")
            setattr(arguments, name, value)
        elif name == "config_dir":
            folder = value or (rest.pop(0) if rest else "")
            if not folder or not Path(folder).is_dir():
                raise ConfigError(f"--config-dir needs an existing folder, got '{folder}'.")
            arguments.config_dir = Path(folder).resolve()
        elif name is not None and not value:
            setattr(arguments, name, True)
        else:
            raise ConfigError(f"Unknown option '{word}'; there are {listing(FLAGS)}.{did_you_mean(word, FLAGS)}")
    for word in arguments.plugins:
        if "_target_" in word.partition("=")[0]:
            raise ConfigError(
                f"'{word:.200}': launchers and sweepers are chosen by name, such as hydra/launcher=joblib."
            )
    if arguments.plugins and not (arguments.multirun or arguments.cfg):
        raise ConfigError(f"'{arguments.plugins[0]}' is about sweeps: add --multirun.")
    return arguments


def expand(arguments: Arguments, command: str) -> list[list[str]]:
    """The overrides of each run: one list, or with ``--multirun`` one per combination of listed values.

    Raises:
        ConfigError: an override that cannot be read, an unknown key, several values without ``--multirun``.
    """
    runs: list[list[str]] = [[]]
    for override in parse_overrides(arguments, command):
        text = str(override.input_line)
        if not override.is_sweep_override():
            runs = [[*run, text] for run in runs]
            continue
        key = override.key_or_group
        if not arguments.multirun:
            raise ConfigError(
                f"'{text}' lists several values: add --multirun to run them one after another"
                f" (a value that is itself a list is written {key}=[a,b])."
            )
        if override.is_interval_sweep():
            raise ConfigError(f"'{text}': an interval has no end of values; use range(...) or choice(...).")
        values = list(override.sweep_string_iterator())
        runs = [[*run, f"{key}={value}"] for run in runs for value in values]
    return runs


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
        base: values that lie below the overrides, instead of those of the YAML files.
        home: the folder whose ``config.yaml`` the base is; code that it names is only let through if the overrides
            name it again (:func:`warpvox.trust.with_code`).

    Raises:
        ConfigError: anything wrong with keys, values or YAML files; code that the user has not named.
    """
    result, stored, named = _composed(command, overrides, config_dir, base)
    file = named.get("config")
    check_values(result)
    result = dataclasses.replace(result, config=None) if file else result
    if file is not None:
        home = Path(file) if Path(file).is_dir() else Path(file).parent
    if stored is None:
        return with_code(result, typed(result))
    check_address(result, stored, named)
    return with_code(result, typed(result, named), stored, home or Path.cwd())


def composition(command: str, overrides: list[str], config_dir: Path | None) -> tuple[str, list[str]]:
    """What Hydra composes for one run: the name of a configuration (the command's or a preset's) and its overrides.

    Raises:
        ConfigError: a key or value that is not valid, or ``config``, whose values are no part of Hydra's composition.
    """
    parsed = _checked(command, overrides, config_dir)
    if any(override.key_or_group == "config" and override.value() is not None for override in parsed):
        raise ConfigError("--info and --cfg hydra|all do not show the values of config=FILE; --cfg job does.")
    name, given = _entry(command, parsed, config_dir)
    return name, [str(override.input_line) for override in given]


@uninterrupted()  # OmegaConf's clean-up turns an interrupt into errors of its own
def _composed(
    command: str, overrides: list[str], config_dir: Path | None, base: dict | None
) -> tuple[Any, dict | None, dict[str, Any]]:
    """The dataclass of a command, unchecked; the stored values that lie below it; the values of the overrides."""
    parsed = _checked(command, overrides, config_dir)
    named = {override.key_or_group: override.value() for override in parsed}
    key_of_preset, _ = PRESET_OF.get(command, (PRESET, None))
    file, stored = named.get("config"), base
    if file is not None and key_of_preset in named:
        raise ConfigError(f"config={file} and {key_of_preset} both say where to start from: give one of them.")
    # Hydra would take a mapping for changes of the one that a file has
    whole = {key: value for key, value in named.items() if isinstance(value, dict) and key in MAPPINGS}
    try:
        name, given = _entry(command, [item for item in parsed if item.key_or_group not in whole], config_dir)
        groups = GROUPS_OF.get(command, GROUPS)
        choices = [str(item.input_line) for item in given if item.key_or_group in groups]
        changes = [item for item in given if item.key_or_group not in groups]
        config = composed(name, choices, changes, config_dir)
        missing = OmegaConf.missing_keys(config)
        defaults = composed(name, config_dir=config_dir) if missing or file is not None else None
        for key, value in whole.items():
            OmegaConf.update(config, key, value, merge=False)
        for key in missing:  # what a file of the user's own leaves open
            OmegaConf.update(config, key, OmegaConf.select(defaults, key))
        if file is not None:
            stored = read_config_file(file, command)
            below = OmegaConf.merge(defaults, stored)
            config = _changed(below, config, parsed, _brought(parsed, defaults, config))
        elif base is not None:
            below = OmegaConf.merge(schema_of(command), base)
            config = _changed(below, config, parsed, [])
        result = OmegaConf.to_object(config)
    except (HydraException, OmegaConfBaseException, OverflowError, yaml.YAMLError) as error:
        raise ConfigError(f"{file}: {one_line(error)}" if file else one_line(error)) from None
    return result, stored, named


@uninterrupted()
def load_values(command: str, values: dict[str, Any]) -> Any:
    """The dataclass of a command from the values of a stored ``config.yaml``; unknown ones are left out.

    The code that they name cannot be imported before :func:`warpvox.trust.with_code`.

    Raises:
        ConfigError: values of the wrong type or out of range.
    """
    names = {item.name for item in dataclasses.fields(COMMANDS[command])}
    try:
        known = {name: value for name, value in values.items() if name in names}
        result = OmegaConf.to_object(OmegaConf.merge(schema_of(command), known))
    except (OmegaConfBaseException, OverflowError) as error:
        raise ConfigError(f"The stored configuration is not valid: {one_line(error)}") from None
    check_values(result)
    return result


def _changed(below: Any, config: Any, parsed: list[Override], brought: list[str]) -> Any:
    """``below`` with what the overrides change; a group that is named brings all its values."""
    for key in [*(override.key_or_group for override in parsed if override.key_or_group in GROUPS), *brought]:
        OmegaConf.update(below, key, OmegaConf.select(config, key), merge=True)
    for override in parsed:
        if override.key_or_group not in GROUPS:
            OmegaConf.update(below, override.key_or_group, OmegaConf.select(config, override.key_or_group), merge=False)
    return below


def _brought(parsed: list[Override], defaults: Any, config: Any) -> list[str]:
    """Keys outside of a named group that it has changed, such as num_envs by ppo=evogym."""
    if not any(override.key_or_group in GROUPS for override in parsed):
        return []
    return [
        key
        for key in config
        if key not in GROUPS and not OmegaConf.is_config(config[key]) and config[key] != defaults[key]
    ]


# ----------------------------------------------------------------------------------------------- overrides


def _checked(command: str, overrides: list[str], config_dir: Path | None) -> list[Override]:
    """The overrides of a single run, each with a known key and a value of its type."""
    parsed = parse_overrides(Arguments(overrides), command)
    scratch = schema_of(command)
    for override in parsed:
        _check_override(override, command, scratch, config_dir)
    return parsed


def _entry(command: str, parsed: list[Override], config_dir: Path | None) -> tuple[str, list[Override]]:
    """The name of the configuration that the overrides start from, and those that change it."""
    key, preset = PRESET_OF.get(command, (PRESET, None))
    preset = next((override.value() for override in parsed if override.key_or_group == key), preset)
    name = command if preset is None else _preset_config(preset, command, config_dir)
    return name, [override for override in parsed if override.key_or_group != key]


def _preset_config(preset: str, command: str, config_dir: Path | None) -> str:
    """The name of the configuration that a preset is; one without ``defaults`` has those of the command."""
    file = presets_of(command, config_dir)[preset]
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ConfigError(f"The preset {file} cannot be read: {one_line(error)}.") from None
    if not isinstance(content, dict):
        raise ConfigError(f"The preset {file} must hold keys with their values.")
    own = yaml.safe_load((files("warpvox.configs") / f"{command}.yaml").read_text(encoding="utf-8"))
    content = {"defaults": own["defaults"]} | content | {PRESET_OF.get(command, (PRESET,))[0]: preset}
    name = f"{command}_{PRESET}_{preset}"
    ConfigStore.instance().store(name=name, node=OmegaConf.create(content))
    return name


@uninterrupted()
def parse_overrides(arguments: Arguments, command: str) -> list[Override]:
    """Read overrides and check their keys."""
    keys = dict(flat_keys(COMMANDS[command]))
    known = list(keys)
    parsed = []
    for word in arguments.overrides:
        name, given, _ = word.partition("=")
        if name == "designs" and "designs.bodies" in keys:  # short for the bodies
            name, word = "designs.bodies", f"designs.bodies{word[len(name) :]}"
        elif name == "designs" and name not in keys and "design" in keys:
            name, word = "design", f"design{word[len(name) :]}"
        text = readable(word, keys[name], arguments.multirun) if given and name in keys else word
        override = parse(text)
        if override is None:
            raise ConfigError(f"'{word:.200}' is not KEY=VALUE, or its value has unbalanced brackets or quotes.")
        key = override.key_or_group
        if override.is_delete() or override.is_add() or override.is_force_add():
            raise ConfigError(f"'{text}': keys cannot be added or removed; write {key}=VALUE.")
        if override.package is not None or key not in known:
            hint = _hint(key, known)
            given = override.get_key_element()
            raise ConfigError(f"Unknown key '{given}'.{hint} `warpvox {command} --help` lists all keys.")
        parsed.append(as_list(override, keys[key]))
    named = [override.key_or_group for override in parsed]
    twice = [key for key in dict.fromkeys(named) if named.count(key) > 1]
    if twice:
        raise ConfigError(f"The key '{twice[0]}' is given more than once.")
    return parsed


def _hint(key: str, known: list[str]) -> str:
    """The key that an unknown one may mean."""
    last = key.split(".")[-1]
    meant = [name for name in known if name.split(".")[-1] == ALIASES.get(last)]
    return did_you_mean(meant[0], meant) if meant else did_you_mean(key, known) or did_you_mean(last, known)


def _check_override(override: Override, command: str, scratch: Any, config_dir: Path | None) -> None:
    """Check the name of a group's file or of a preset, or the type of a value: errors name key and value.

    ``scratch`` is a configuration of the schema that takes the value.
    """
    key, value, given = override.key_or_group, override.value(), override.get_value_string()
    is_group = key in GROUPS_OF.get(command, GROUPS)
    if is_group or (key == PRESET_OF.get(command, (PRESET,))[0] and value is not None):
        options = options_of(key, config_dir) if is_group else list(presets_of(command, config_dir))
        if value not in options:
            more = f" Single values are set by {key}.NAME=VALUE." if key in GROUPS else ""
            null = "" if is_group or command in PRESET_OF else " or null"
            hint = did_you_mean(value, options) if isinstance(value, str) else ""
            raise ConfigError(f"{key} must be one of {listing(options)}{null}, got '{value}'.{hint}{more}")
        return
    try:
        OmegaConf.update(scratch, key, value)
    except (OmegaConfBaseException, OverflowError) as error:
        kind = dict(flat_keys(COMMANDS[command]))[key].type
        if dataclasses.is_dataclass(kind):
            others = [item.name for item in dataclasses.fields(COMMANDS[command]) if item.name != key]
            hint = did_you_mean(key, others)
            raise ConfigError(f"{key} is set by {key}.NAME=VALUE, got '{given}'.{hint}") from None
        kind = str(kind)
        expected = next((text for name, text in TYPES.items() if name in kind), kind)
        optional = " or null" if "None" in kind else ""
        if "Unsupported interpolation" in str(error):
            expected = "a plain value"
        raise ConfigError(f"{key} must be {expected}{optional}, got '{given}'.") from None
