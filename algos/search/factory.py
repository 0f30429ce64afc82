"""Creation of searches from their settings."""

from collections.abc import Sequence
from importlib import import_module
from typing import Any, cast

from warpvox.algos.candidate import Search
from warpvox.algos.search.settings import CustomSearch, SearchSettings
from warpvox.code import check_code, load_code
from warpvox.design import Design
from warpvox.errors import ConfigError, listing


def make_search(
    settings: SearchSettings, shape: tuple[int, int] = (5, 5), seed: int = 0, start: Sequence[Design] = ()
) -> Search:
    """Create the search algorithm that ``settings`` describe.

    Args:
        settings: their class says which algorithm.
        shape: ``(rows, columns)`` of the bodies.
        seed: of all random numbers; the same seed and fitness give the same proposals.
        start: different bodies, int8 ``[rows, columns]``, that the first generation begins with.
    """
    if not isinstance(settings, SearchSettings):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ConfigError(f"There is no search for the settings {settings!r:.80}: GA(), BO(), ... are known.")
    module, name = settings.implementation.split(":")
    search = getattr(import_module(f"warpvox.algos.search.{module}"), name)(settings, shape, seed)
    start_with(search, start)
    return search


def start_with(search: Any, bodies: Sequence[Design]) -> None:
    """Set the first bodies of ``search``; ConfigError: not supported, or the bodies do not fit."""
    if bodies:
        if not hasattr(search, "start_with"):
            raise ConfigError(f"{type(search).__name__} has no start_with(bodies), which start needs.")
        search.start_with(bodies)


def make_custom(settings: CustomSearch, shape: tuple[int, int], seed: int) -> Search:
    """Call the user's code named by ``settings.make``, and return the search."""
    check_code(settings.make, "search=custom needs search.make", "a search of settings, shape and seed")
    search: Any = load_code(cast(str, settings.make))(settings, shape, seed)
    verbs = ("ask", "tell", "replay")
    missing = [verb for verb in verbs if not callable(getattr(search, verb, None))]
    if missing:
        raise ConfigError(
            f"'{settings.make}' makes a {type(search).__name__}, which cannot {listing(missing)}: a search has"
            f" {listing(verbs)}. BaseSearch of warpvox.algos.search brings them along."
        )
    return search
