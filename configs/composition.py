"""Hydra on the YAML files and schemas of this package."""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_module
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Override, Quote, QuotedString
from omegaconf import DictConfig, OmegaConf

from warpvox.configs.paper import design_of, shape_of
from warpvox.configs.schema import COMMANDS

__all__ = ["composed", "opened", "quoted", "schema_of"]


def composed(
    name: str, choices: Sequence[str] = (), changes: Sequence[Override] = (), config_dir: Path | None = None
) -> DictConfig:
    """What Hydra composes of the configuration ``name``.

    Without a folder of the user's own the files of a name and its choices are composed once in a process, because that
    takes a tenth of a second; each call gets a copy.

    Args:
        choices: overrides that choose the files of groups.
        changes: those that set single values, checked.
    """
    if config_dir is None:
        config = copy.deepcopy(_from_package(name, tuple(choices)))
    else:
        with opened(config_dir) as (_, search):
            config = compose(name, [*choices, *search])
    for change in changes:
        OmegaConf.update(config, change.key_or_group, change.value(), merge=True)
    return config


@functools.cache
def _from_package(name: str, choices: tuple[str, ...]) -> DictConfig:
    with opened():
        return compose(name, list(choices))


def schema_of(command: str) -> DictConfig:
    """The schema of a command with its default values, the caller's own; made once in a process, as that is slow."""
    return copy.deepcopy(_structured(command))


@functools.cache
def _structured(command: str) -> DictConfig:
    return OmegaConf.structured(COMMANDS[command])


@contextmanager
def opened(config_dir: Path | None = None) -> Iterator[tuple[Any, list[str]]]:
    """Hydra on our configurations, and the overrides that add a folder of the user's own."""
    _register()
    search = [f"hydra.searchpath=[{quoted(f'file://{config_dir}')}]"] if config_dir else []
    shared = GlobalHydra.instance()
    outer = shared.hydra  # a launcher that makes runs in this process has opened one
    shared.clear()
    try:
        with initialize_config_module("warpvox.configs", version_base="1.3"):
            yield shared.hydra, search
    finally:
        shared.hydra = outer


def quoted(text: str) -> str:
    """A text in quotes that Hydra reads as that text."""
    return QuotedString(text=text, quote=Quote.single).with_quotes()


@functools.cache
def _register() -> None:
    """Make the schemas known to Hydra; once, because it takes as long as a small command."""
    store = ConfigStore.instance()
    for command, schema in COMMANDS.items():
        store.store(name=f"{command}_schema", node=schema)
    for name, resolver in {"paper_shape": shape_of, "paper_design": design_of}.items():
        OmegaConf.register_new_resolver(name, resolver, replace=True)
