"""Searches of the user: found by the name of a file or module, and checked before they are used."""

from __future__ import annotations

from typing import Any

from warpvox.algos.candidate import Search
from warpvox.algos.search.settings import CustomSearch
from warpvox.code import load_code
from warpvox.errors import ConfigError, listing

__all__ = ["make_custom"]

VERBS = ("ask", "tell", "replay")


def make_custom(settings: CustomSearch, shape: tuple[int, int], seed: int) -> Search:
    """Call what ``settings.make`` names with settings, shape and seed.

    Raises:
        ConfigError: no such file, module or name, or what it makes does not ask, tell and replay.
    """
    place, _, name = (settings.make or "").rpartition(":")
    if not place or not name.isidentifier():
        raise ConfigError(
            "The search 'custom' needs make=FILE.py:NAME or make=MODULE:NAME, where NAME makes a search of settings,"
            f" shape and seed; got {settings.make!r}."
        )
    search: Any = load_code(settings.make)(settings, shape, seed)
    missing = [verb for verb in VERBS if not callable(getattr(search, verb, None))]
    if missing:
        raise ConfigError(
            f"'{settings.make}' makes a {type(search).__name__}, which cannot {listing(missing)}: a search has"
            f" {listing(VERBS)}. BaseSearch of warpvox.algos.search brings them along."
        )
    return search
