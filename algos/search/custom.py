"""Searches of the user: found by the name of a file or module, and checked before they are used."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

from warpvox.algos.candidate import Search
from warpvox.algos.search.settings import CustomSettings
from warpvox.errors import ConfigError, did_you_mean, listing

__all__ = ["make_custom"]

VERBS = ("ask", "tell", "replay")


def make_custom(settings: CustomSettings, shape: tuple[int, int], seed: int) -> Search:
    """Call what ``settings.make`` names with settings, shape and seed.

    Raises:
        ConfigError: no such file, module or name, or what it makes does not ask, tell and replay.
    """
    place, _, name = str(settings.make).rpartition(":")
    module = _load_file(Path(place)) if place.endswith(".py") else _import(place)
    maker = getattr(module, name, None)
    if not callable(maker):
        public = [word for word, value in vars(module).items() if callable(value) and not word.startswith("_")]
        raise ConfigError(f"'{place}' has no class or function '{name}'.{did_you_mean(name, public)}")
    search: Any = maker(settings, shape, seed)
    missing = [verb for verb in VERBS if not callable(getattr(search, verb, None))]
    if missing:
        raise ConfigError(
            f"'{settings.make}' makes a {type(search).__name__}, which cannot {listing(missing)}: a search has"
            f" {listing(VERBS)}. BaseSearch of warpvox.algos.search brings them along."
        )
    return search


def _load_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise ConfigError(f"There is no file '{path}' with a search.")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"'{path}' is no Python file.")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _import(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        # a module that is there but lacks one of its own imports is another mistake than a wrong name
        if error.name is None or not (name == error.name or name.startswith(f"{error.name}.")):
            raise
        raise ConfigError(f"There is no module '{name}' with a search.") from None
