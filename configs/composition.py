"""Composition of settings by Hydra, from this package's YAML files and dataclasses."""

import copy
import functools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

import yaml
from hydra import compose, initialize_config_module
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException, MissingConfigException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from warpvox.configs.schema import PRESET, nodes_of, schema_of
from warpvox.errors import ConfigError, did_you_mean, listing
from warpvox.examples import bare_id


def composed(command: str, overrides: Sequence[str] = (), config_dir: Path | None = None) -> DictConfig:
    """Compose the configuration of a command by Hydra.

    Without a folder of the user's own it is composed once in a process, because that takes a tenth of a second; each
    call gets a copy.
    """
    if config_dir is None:
        return copy.deepcopy(_from_package(command, tuple(overrides)))
    with _opened(command):
        return compose(command, [*overrides, f"hydra.searchpath=[{quoted(f'file://{config_dir}')}]"])


@functools.cache
def _from_package(command: str, overrides: tuple[str, ...]) -> DictConfig:
    """Compose a configuration from the package's files alone; cached."""
    with _opened(command):
        return compose(command, list(overrides))


@contextmanager
def _opened(command: str) -> Iterator[None]:
    """Let Hydra read our configurations within the block; then restore Hydra's global state."""
    register(command)
    shared = GlobalHydra.instance()
    outer = shared.hydra
    shared.clear()
    try:
        with initialize_config_module("warpvox.configs", version_base="1.3"):
            yield
    finally:
        shared.hydra = outer


@contextmanager
def hydras_errors(beginning: str = "") -> Iterator[None]:
    """Convert errors of Hydra and OmegaConf within the block to a ConfigError of one sentence."""
    try:
        yield
    except (HydraException, OmegaConfBaseException, OverflowError, yaml.YAMLError) as found:
        error = cast(Any, found)
        # Leave out lines about OmegaConf's classes.
        inner = ("full_key", "object_type", "reference_type")
        lines = [line.strip() for line in str(error).splitlines()]
        lines = [line for line in lines if line and not line.startswith(inner)]
        text = " ".join(lines if isinstance(found, yaml.YAMLError) else lines[:2])
        if isinstance(found, MissingConfigException) and error.options:
            group, _, name = str(error.missing_cfg_file).rpartition("/")
            key = PRESET if group.startswith(f"{PRESET}/") else group
            text = f"{key} must be one of {listing(error.options)}, got '{name}'.{did_you_mean(name, error.options)}"
        elif getattr(error, "full_key", None):
            fields = getattr(error.object_type, "__dataclass_fields__", {})
            hint = "" if error.key in fields else did_you_mean(error.key, fields)
            where = "" if beginning.startswith(error.full_key) else f"{error.full_key}: "
            text = f"{where}{lines[0]}.{hint}"
        raise ConfigError(f"{beginning}{text}") from None


def quoted(text: str) -> str:
    """Quote a text so that Hydra reads it unchanged."""
    return QuotedString(text=text, quote=Quote.single).with_quotes()


@functools.cache
def register(command: str) -> None:
    """Register a command's dataclass, group choices and ``paper_*`` resolvers with Hydra, once."""
    store = ConfigStore.instance()
    own = (files("warpvox.configs") / f"{command}.yaml").is_file()
    store.store(name=f"{command}_schema" if own else command, node=schema_of(command))
    for group, nodes in nodes_of(command).items():
        for name, node in nodes.items():
            store.store(group=group, name=name, node=node)

    # The paper's bodies are 5 x 5 (Table 2), except in one task with a larger grid, for a body designed by hand. YAML
    # files refer to shape and example body as ${paper_shape:${task}} and ${paper_design:${task}}.
    is_larger = lambda task: bare_id(task) == "Lifter-v0"  # noqa: E731
    shape = lambda task: [5, 7] if is_larger(task) else [5, 5]  # noqa: E731
    design = lambda task: "lifter" if is_larger(task) else "walker"  # noqa: E731
    OmegaConf.register_new_resolver("paper_shape", shape, replace=True)
    OmegaConf.register_new_resolver("paper_design", design, replace=True)


def settings_named(command: str, **names: str) -> dict[str, Any]:
    """Return the settings that a choice of named presets such as ``ppo="evogym"`` changes from the defaults."""
    with hydras_errors():
        words = [f"{key}={quoted(name)}" for key, name in names.items()]
        usual = vars(OmegaConf.to_object(composed(command)))
        named = vars(OmegaConf.to_object(composed(command, words)))
    return {key: value for key, value in named.items() if value != usual[key]}
