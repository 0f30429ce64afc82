"""Settings of the search algorithms: dataclasses with the paper's values as defaults (section D).

They are what ``search=NAME`` stands for on the command line. One differs, because it finds more: ``acquisition``.
"""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from warpvox.errors import ConfigError, listing
from warpvox.keys import Settings, key

DESCRIPTORS = ("actuators", "empty", "rigid", "soft", "horizontal", "vertical", "height", "width", "symmetry")
"""Descriptors of bodies for MAP-Elites, from 0 to 1 (``describe`` in ``map_elites.py``)."""


Kind = TypeVar("Kind", bound="SearchSettings")

ALGORITHMS: dict[str, type[SearchSettings]] = {}
"""Settings classes of the algorithms by name."""


@dataclass
class SearchSettings(Settings):
    """Settings common to all searches (paper section D.1, Table 2)."""

    prefix = "search."
    title = "search"
    """Name of the algorithm for reports."""
    implementation = ""
    """``MODULE:NAME`` of the class or function that creates the search, imported on first use."""

    algorithm: str = key("", "which search")
    population: int = key(25, "designs of a generation", low=2)
    max_designs: int = key(
        250,
        "number of different designs to evaluate; in the paper 250, 500 or 750",
        low=1,
        high=1_000_000,
    )


def register_search(kind: type[Kind]) -> type[Kind]:
    """Register a class in :data:`ALGORITHMS` under its ``algorithm`` (decorator)."""
    ALGORITHMS[kind.algorithm] = kind
    return kind


@register_search
@dataclass
class GA(SearchSettings):
    """Settings of the genetic algorithm (paper Algorithm 1, Table 3)."""

    title = "genetic algorithm"
    implementation = "ga:GeneticSearch"

    algorithm: str = key("ga", "which search", choices=("ga",))

    mutation_rate: float = key(0.1, "probability that a mutation changes a voxel", above=0, high=1)
    survivor_rate: float = key(0.6, "fraction of the population that survives, at the start", low=0, high=1)
    final_survivor_rate: float = key(0.0, "the same at the end; linear between", low=0, high=1)
    min_survivors: int = key(2, "smallest number of survivors of a generation", low=1)

    def __post_init__(self) -> None:
        """Validate the values, and that a generation has room for new designs."""
        super().__post_init__()
        if self.min_survivors >= self.population:
            raise ConfigError(
                f"search.min_survivors must be less than search.population ({self.population}), or nothing new is ever"
                f" tried; got {self.min_survivors}."
            )


@register_search
@dataclass
class BO(SearchSettings):
    """Settings of Bayesian optimisation (paper Algorithm 2, Table 4)."""

    title = "Bayesian optimisation"
    implementation = "bo:BayesianSearch"

    algorithm: str = key("bo", "which search", choices=("bo",))

    acquisition: str = key(
        "pathwise",
        "how designs are proposed: pathwise (hill climbing on posterior samples, over valid designs); paper (expected"
        " improvement by L-BFGS, then voxel by voxel over new valid designs); lbfgs (expected improvement by L-BFGS"
        " alone)",
        choices=("pathwise", "paper", "lbfgs"),
    )
    # Limits: the fit cannot start from its own bounds (see ``_make_model`` in ``bo_acquire.py``).
    kernel_variance: float = key(1.0, "initial variance of the Matern 5/2 kernel", low=1e-3, high=1e6)
    kernel_length_scale: float = key(1.0, "initial length scale of the kernel", low=0.05, high=1e6)
    optimizer_iterations: int = key(100, "iterations of L-BFGS, for the kernel and for the acquisition", low=1)
    optimizer_restarts: int = key(5, "number of starts of the kernel's fit, of which the best is used", low=1)
    candidates: int = key(1000, "number of designs among which the starts of climbs are chosen", low=1)


@register_search
@dataclass
class CppnNeat(SearchSettings):
    """Settings of CPPN-NEAT (paper section C.3); Table 5 is the file ``cppn_neat.cfg``."""

    title = "CPPN-NEAT"
    implementation = "cppn_neat:CppnNeatSearch"

    algorithm: str = key("cppn_neat", "which search", choices=("cppn_neat",))

    neat_config: str | None = key(None, "another configuration file of neat-python; null: Table 5 of the paper")


@register_search
@dataclass
class MapElites(SearchSettings):
    """Settings of MAP-Elites, which keeps the best design of every kind of body."""

    title = "MAP-Elites"
    implementation = "map_elites:MapElitesSearch"

    algorithm: str = key("map_elites", "which search", choices=("map_elites",))

    mutation_rate: float = key(0.1, "probability that a mutation changes a voxel", above=0, high=1)
    descriptors: list[str] = key(
        ["actuators", "empty"], "descriptors that span the cells of the archive", choices=DESCRIPTORS
    )
    bins: int = key(5, "bins of each descriptor", low=1)

    def __post_init__(self) -> None:
        """Validate the values, and that the descriptor grid fits into memory."""
        super().__post_init__()
        if not self.descriptors or len(set(self.descriptors)) < len(self.descriptors):
            raise ConfigError(
                f"search.descriptors must name one or more different ones, got {listing(self.descriptors)}."
            )
        # The archive allocates all cells at once.
        if self.bins ** len(self.descriptors) > 10_000_000:
            cells = f"search.bins={self.bins} for {len(self.descriptors)} descriptors make over 10,000,000 cells"
            raise ConfigError(f"{cells}, more than memory holds: take fewer bins or descriptors.")


@register_search
@dataclass
class RandomDesigns(SearchSettings):
    """Settings of random search, the baseline: designs by EvoGym's sampling rule."""

    title = "random search"
    implementation = "base:RandomSearch"

    algorithm: str = key("random", "which search", choices=("random",))


@register_search
@dataclass
class CustomSearch(SearchSettings):
    """Settings of a search by the user's own code; see docs/own_search.md."""

    title = "custom"
    implementation = "factory:make_custom"

    algorithm: str = key("custom", "which search", choices=("custom",))

    make: str | None = key(
        None, "a search of your own: FILE.py:NAME or MODULE:NAME, called with settings, shape and seed"
    )
