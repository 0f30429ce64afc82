"""From settings to a search; each algorithm's module, and the libraries it needs, load when it is made."""

from __future__ import annotations

from warpvox.algos.candidate import Search
from warpvox.algos.search.settings import (
    BoSettings,
    CppnNeatSettings,
    CustomSettings,
    GaSettings,
    MapElitesSettings,
    RandomSettings,
    SearchSettings,
)
from warpvox.errors import ConfigError

__all__ = ["make_search"]


def make_search(settings: SearchSettings, shape: tuple[int, int] = (5, 5), seed: int = 0) -> Search:
    """A fresh search.

    Args:
        settings: their class says which algorithm; :func:`settings_from` makes them from plain values.
        shape: ``(rows, columns)`` of the bodies.
        seed: governs everything random; same seed and same fitness, same proposals.

    Raises:
        ConfigError: settings of no known algorithm, a bad shape or seed, or a library that is not installed.
    """
    if isinstance(settings, GaSettings):
        from warpvox.algos.search.ga import GeneticSearch

        return GeneticSearch(settings, shape, seed)
    if isinstance(settings, RandomSettings):
        from warpvox.algos.search.random_search import RandomSearch

        return RandomSearch(settings, shape, seed)
    if isinstance(settings, BoSettings):
        from warpvox.algos.search.bo import BayesianSearch

        return BayesianSearch(settings, shape, seed)
    if isinstance(settings, CppnNeatSettings):
        from warpvox.algos.search.cppn_neat import CppnNeatSearch

        return CppnNeatSearch(settings, shape, seed)
    if isinstance(settings, MapElitesSettings):
        from warpvox.algos.search.map_elites import MapElitesSearch

        return MapElitesSearch(settings, shape, seed)
    if isinstance(settings, CustomSettings):
        from warpvox.algos.search.custom import make_custom

        return make_custom(settings, shape, seed)
    raise ConfigError(f"There is no search for settings of type {type(settings).__name__}.")
