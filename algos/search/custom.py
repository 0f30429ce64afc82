"""Searches of the user: found by the name of a file or module, and checked before they are used."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

from warpvox.algos.candidate import Search
from warpvox.algos.search.settings import CustomSettings
from warpvox.envs.sources import lacks_module, load_code, split
from warpvox.errors import ConfigError, did_you_mean, listing

__all__ = ["make_custom"]

VERBS = ("ask", "tell", "replay")


def make_custom(settings: CustomSettings, shape: tuple[int, int], seed: int) -> Search:
    """Call what ``settings.make`` names with settings, shape and seed.

    Raises:
        ConfigError: no such file, module or name, or what it makes does not ask, tell and replay.
    """
    place, name = split(str(settings.make))
    module = _load(place)
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


def _load(place: str) -> ModuleType:
    try:
        return load_code(place).module
    except FileNotFoundError:
        if Path(place).expanduser().is_file():
            raise  # what it lacks is a file of its own
        raise ConfigError(f"There is no file '{place}' with a search.") from None
    except ModuleNotFoundError as error:
        if not lacks_module(place, error):
            raise
        raise ConfigError(f"There is no module '{place}' with a search.") from None
