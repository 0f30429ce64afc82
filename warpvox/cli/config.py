"""Settings from a command line: words are parsed and composed by Hydra, then validated."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, ConfigTypeError

from warpvox.algos.find import find_codesign, find_run
from warpvox.algos.interrupt import uninterrupted
from warpvox.cli.help import groups_of, keys_of
from warpvox.code import with_passed_code
from warpvox.configs.composition import composed, hydras_errors, quoted
from warpvox.configs.schema import PRESET, nodes_of, schema_of
from warpvox.design import zoo_tasks
from warpvox.errors import ConfigError, did_you_mean
from warpvox.examples import bare_id
from warpvox.io.reading import LARGEST_CONFIG, Unreadable, parse_yaml, read_text
from warpvox.keys import ELSEWHERE, SYNONYMS, flat
from warpvox.runs import CODESIGN, CONFIG, TRAINING, ZOO, as_now, without_services


def load(command: str, words: Sequence[str], config_dir: Path | None = None) -> Any:
    """Parse, compose and validate the words of a command line; return the settings."""
    return settings_of(command, read_words(command, words), config_dir)


def settings_of(command: str, overrides: Mapping[str, Override], config_dir: Path | None = None) -> Any:
    """Compose the settings of a command: defaults, then a stored configuration, then ``overrides``.

    A group that is given takes the place of its section in the stored configuration.

    Args:
        overrides: what is given, by key; ``config=FILE`` and ``resume=RUN`` name a stored configuration.
        config_dir: folder with YAML files of the user's own.

    Raises:
        ConfigError: an unknown key, a value that it does not take, or a file that is or has none. RunError: there is no
            run to resume.
    """
    # Values given on the command line
    keys = keys_of(command)
    given = {}
    for key, override in overrides.items():
        if override.is_sweep_override():
            raise ConfigError(
                f"'{override.input_line}' lists several values: add --multirun to run them one after another (a value"
                f" that is itself a list is written {key}=[a,b], one that has commas {key}=\"'a,b'\")."
            )
        value: Any = override.value()
        if key in keys and keys[key].is_list and not isinstance(value, list | None):
            value = [value]  # export=gif
        given[key] = value

    # Stored values, except those of groups that are given
    stored, place = _read_stored(command, given)
    origin = "" if place is None else f"{place}: "
    choosing = [*groups_of(command), *[PRESET] * (PRESET in keys_of(command))]
    groups = {key: str(value) for key, value in given.items() if key in choosing and value is not None}
    stored = {key: value for key, value in stored.items() if key not in groups}
    if place is not None and PRESET in groups:
        raise ConfigError(f"{place} and {PRESET}={groups[PRESET]} both say where to start: give one of them.")

    # Choice of each group: the one given, else the one stored
    choices = dict(groups)
    for group in nodes_of(command):
        section = stored.get(group)
        name = isinstance(section, Mapping) and section.get("name", section.get("algorithm"))
        if name:
            choices[group] = str(name)

    with uninterrupted():  # an interrupt would become an error of OmegaConf's clean-up
        names = {PRESET: f"{PRESET}/{command}@_global_"}
        with hydras_errors(origin):
            chosen = [f"{names.get(key, key)}={quoted(choice)}" for key, choice in choices.items()]
            config = cast(DictConfig, OmegaConf.merge(composed(command, chosen, config_dir), stored))
        for key, value in given.items():
            if key not in groups:
                _set(command, config, key, value)
        with hydras_errors(origin):
            values = OmegaConf.to_container(config, resolve=True)
    try:
        settings = schema_of(command)(**cast(Any, values))
    except ConfigError as error:
        key = str(error).partition(" ")[0]
        raise ConfigError(f"{'' if key in given else origin}{error}") from None
    return with_passed_code(settings, given, place or config_dir)


def read_words(command: str, words: Sequence[str]) -> dict[str, Override]:
    """Parse KEY=VALUE words by Hydra's grammar into overrides by key; keys may still be unknown.

    Texts that the grammar cannot read, or would read as numbers, and existing paths are quoted first.

    Raises:
        ConfigError: a word that is not ``KEY=VALUE``, or a key that is given twice.
    """
    keys = keys_of(command)
    found: dict[str, Override] = {}

    # Other names of keys by command: short, old, another command's, or those of config.yaml
    renamed = {
        "train": {"designs": "designs.bodies"},
        "play": {"format": "export"},
        "export": {"export": "format"},
        "codesign": {
            "finalists": "fitness.finalists",
            "pretrained": "fitness.pretrained",
            "search.algorithm": "search",
            "fitness.name": "fitness",
        },
    }
    for word in words:
        name, given, text = word.partition("=")
        if name not in keys:
            others: list[str] = []
            for part in name.split("."):
                others += [name.replace(part, other, 1) for other in SYNONYMS.get(part, ())]
            name = next((other for other in others if other in keys), name)
        name = renamed.get(command, {}).get(name, name)
        override = _parse_word(f"{name}{given}{text}")
        if given and text and name in keys and keys[name].takes_text:
            place = os.path.expanduser(text)
            # Hydra's grammar may read a text as a number or a list.
            is_other = (
                override is not None
                and not override.is_sweep_override()
                and not isinstance(override.value(), str | None)
            )
            if override is None or os.path.exists(place) or (keys[name].is_text and is_other):
                override = _parse_word(f"{name}={quoted(place)}")
        if override is None:
            hint = ", or its value has unbalanced brackets or quotes."
            if not given and (name.startswith(ZOO) or bare_id(name).casefold() in map(str.casefold, zoo_tasks())):
                key = "zoo" if name.startswith(ZOO) else "task"
                hint = f". Write {key}={name.removeprefix(ZOO)}."
            raise ConfigError(f"'{word:.200}' is not KEY=VALUE{hint}")
        if override.type is not OverrideType.CHANGE:
            raise ConfigError(f"'{word}': keys cannot be added or removed; write {override.key_or_group}=VALUE.")
        if name in found:
            raise ConfigError(f"The key '{name}' is given more than once.")
        found[name] = override
    return found


def _parse_word(word: str) -> Override | None:
    """Parse one KEY=VALUE word by Hydra's grammar; return None if it is not valid."""
    try:
        return OverridesParser.create().parse_override(word)
    except (
        HydraException,
        ValueError,
        RecursionError,
    ):  # such as numbers of thousands of digits, deeply nested brackets
        return None


def _read_stored(command: str, given: dict[str, Any]) -> tuple[dict[str, Any], Path | None]:
    """Read the stored configuration named by ``config`` or ``resume``; return it with its path, or ({}, None).

    ``resume`` becomes the folder or checkpoint that it names.
    """
    if given.get("config") is not None:
        path = Path(str(given["config"])).expanduser()
        path = path / CONFIG if path.is_dir() else path
        try:
            values = parse_yaml(read_text(path, LARGEST_CONFIG))
        except Unreadable as error:
            raise ConfigError(f"config must be a YAML file or the folder of a run; {path}: {error}.") from None
        if not isinstance(values, dict) or not values:
            raise ConfigError(f"config must be a YAML file or the folder of a run; {path} holds no KEY: VALUE.")
        given["config"] = None
        values = as_now(values, path)
    elif given.get("resume") is not None:
        name = str(given["resume"])
        output_dir = str(given.get("output_dir", "outputs"))
        run = find_codesign(name, output_dir) if command == CODESIGN else find_run(name, output_dir, TRAINING, True)
        path = run.folder / CONFIG
        values = {key: value for key, value in run.config.items() if key in keys_of(command)}
        given["resume"] = str(run.checkpoint or run.folder)
    else:
        return {}, None

    # Drop keys that say what to do, which are not settings of the run.
    own = {key: value for key, value in values.items() if key not in ("resume", "report", "config")}
    return without_services(own), path


def _set(command: str, config: DictConfig, key: str, value: Any) -> None:
    """Set a key of a composed configuration; ConfigError: unknown key or invalid value."""
    with hydras_errors(f"{key}={value!s:.40}: "):
        try:
            if key not in keys_of(command):
                raise ConfigKeyError(key)
            OmegaConf.update(config, key, value, merge=False)
        except (ConfigAttributeError, ConfigKeyError, ConfigTypeError):
            raise _unknown_key_error(command, key, config) from None


def _unknown_key_error(command: str, key: str, config: DictConfig) -> ConfigError:
    """Build the error for an unknown key, with a suggestion."""
    keys = keys_of(command)
    known = [name for name in flat(cast(Any, OmegaConf.to_container(config))) if name in keys]
    last = key.split(".")[-1]

    # A similar name
    hint = did_you_mean(key, known) or did_you_mean(last, known)

    # The same key in another choice of its group
    group, _, name = key.partition(".")
    nodes = nodes_of(command).get(group, {})
    owners = [f"{group}={choice}" for choice, node in nodes.items() if name in node.__dataclass_fields__]
    if owners:
        hint = f" It is a setting of {' and '.join(owners)}."

    # Names of other libraries, with the last part of our key
    for name in known:
        if name.split(".")[-1] == ELSEWHERE.get(last):
            hint = f" Did you mean '{name}'?"
            break
    return ConfigError(f"Unknown key '{key}'.{hint} `warpvox {command} --help` lists all keys.")
