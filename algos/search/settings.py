"""Settings of the search algorithms: frozen dataclasses whose defaults are the paper's values (section D).

``configs/search/*.yaml`` holds the same values for the command line; ``search.NAME=VALUE`` changes one.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from warpvox.configs.keys import check_values, key
from warpvox.errors import ConfigError, did_you_mean, listing

__all__ = [
    "ALGORITHMS",
    "GaSettings",
    "RandomSettings",
    "SearchSettings",
    "settings_from",
]


@dataclass(frozen=True)
class SearchSettings:
    """What every search has (paper section D.1, Table 2).

    Raises:
        ConfigError: a value of the wrong type or out of range.
    """

    algorithm: ClassVar[str]

    population: int = key(25, "designs of a generation", low=2)
    max_evaluations: int = key(250, "different designs to evaluate in all; the paper has 250, 500 or 750", low=1)

    def __post_init__(self) -> None:
        _check_types(self)
        check_values(self)


@dataclass(frozen=True)
class RandomSettings(SearchSettings):
    """Random search, the baseline: designs by EvoGym's sampling rule."""

    algorithm: ClassVar[str] = "random"


@dataclass(frozen=True)
class GaSettings(SearchSettings):
    """Genetic algorithm (paper Algorithm 1, Table 3)."""

    algorithm: ClassVar[str] = "ga"

    mutation_rate: float = key(0.1, "probability that a mutation changes a voxel", above=0, high=1)
    survivor_rate: float = key(0.6, "share of the population that survives, at the start", low=0, high=1)
    final_survivor_rate: float = key(0.0, "the same at the end; linear between", low=0, high=1)
    min_survivors: int = key(2, "fewest survivors of a generation", low=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_survivors >= self.population:
            raise ConfigError(
                f"min_survivors must be less than population ({self.population}), or nothing new is ever tried;"
                f" got {self.min_survivors}."
            )


ALGORITHMS: dict[str, type[SearchSettings]] = {
    settings.algorithm: settings for settings in (GaSettings, RandomSettings)
}
"""The settings of each algorithm, by its name."""


def settings_from(values: Mapping[str, Any] | object) -> SearchSettings:
    """The settings that plain values stand for.

    Args:
        values: a mapping or a dataclass with the name of the ``algorithm`` and any of its settings; None stands
            for the default.

    Raises:
        ConfigError: an unknown algorithm, a setting that this algorithm does not have, or a value that is not valid.
    """
    if dataclasses.is_dataclass(values):
        values = {item.name: getattr(values, item.name) for item in dataclasses.fields(values)}
    given = {name: value for name, value in dict(values).items() if value is not None}  # type: ignore[call-overload]
    algorithm = given.pop("algorithm", None)
    if algorithm not in ALGORITHMS:
        hint = did_you_mean(algorithm, ALGORITHMS)
        raise ConfigError(f"algorithm must be one of {listing(ALGORITHMS)}; got {algorithm!r}.{hint}")
    known = [item.name for item in dataclasses.fields(ALGORITHMS[algorithm])]
    for name in given:
        if name not in known:
            owners = [other for other, kind in ALGORITHMS.items() if name in kind.__dataclass_fields__]
            whose = f" It is a setting of {listing(owners)}." if owners else did_you_mean(name, known)
            raise ConfigError(f"The search '{algorithm}' has no setting '{name}'.{whose} It has: {listing(known)}.")
    return ALGORITHMS[algorithm](**given)


def _check_types(settings: SearchSettings) -> None:
    """Whole numbers where whole numbers are meant: a generation of 2.5 designs must not get as far as a search."""
    hints = typing.get_type_hints(type(settings))
    for item in dataclasses.fields(settings):
        value, hint = getattr(settings, item.name), hints[item.name]
        kinds = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
        allowed = tuple(tuple if typing.get_origin(kind) is tuple else kind for kind in kinds)
        if float in allowed:
            allowed = (*allowed, int)
        if not isinstance(value, allowed) or (isinstance(value, bool) and bool not in allowed):
            words = {int: "a whole number", float: "a number", str: "text", tuple: "a list of names"}
            raise ConfigError(f"{item.name} must be {words[allowed[0]]}, got {value!r}.")
