"""Design searches read from their archives for comparison."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.algos.archive import FILE, Archive, Record
from warpvox.algos.statistics import Interval
from warpvox.keys import flat
from warpvox.runs import read_summary

SHOWN = 3
"""Maximum number of settings in the name of a search."""


@dataclass(frozen=True)
class SearchResult:
    """Result of one design search with its curve: ``evaluations``, ``steps`` and ``best`` return so far.

    The curve never falls, and ends at the fitness of the best design. Finalists are evaluations, too. Where the other
    designs were only compared by a common policy, it begins with the finalists, once there are some.

    Attributes:
        search: name of the search: its algorithm and the settings that differ from other searches, or its folder.
        settings: settings in its archive, which determine the results.
        records: all designs, by id.
        winner: the best of them, None before there is one.
        summary: what ``summary.json`` beside the archive says.
    """

    folder: Path
    search: str
    settings: Mapping[str, Any]
    records: Sequence[Record]
    winner: Record | None
    summary: Mapping[str, Any]

    @property
    def task(self) -> str:
        """Id of the task, or the name of the user's own task."""
        return str(self.settings.get("task", "unknown task"))

    @property
    def seed(self) -> int | None:
        return self.settings.get("seed")

    @cached_property
    def _trained(self) -> list[Record]:
        """Evaluated designs, without copies of the result of an equal body."""
        return [record for record in self.records if record.fitness is not None and record.reused is None]

    @cached_property
    def evaluations(self) -> np.ndarray:
        """Numbers of the evaluations, 1, 2, ..., int64 ``[n]``."""
        return np.arange(1, len(self._trained) + 1)

    @cached_property
    def steps(self) -> np.ndarray:
        """Control steps spent up to and including each evaluation, int64 ``[n]``."""
        return np.cumsum([record.steps or 0 for record in self._trained], dtype=np.int64)

    @cached_property
    def best(self) -> np.ndarray:
        """Best return up to and including each evaluation, float64 ``[n]``."""
        return np.maximum.accumulate(np.array([record.fitness for record in self._trained], np.float64))

    def best_at(self, steps: float) -> float:
        """Return the best return within a budget of ``steps`` control steps, at least the first design's."""
        return float(self.best[max(0, np.searchsorted(self.steps, steps, "right") - 1)])


def fresh_interval(facts: Mapping[str, Any]) -> Interval:
    """Return the mean return over unused seeds with its interval, from ``fresh_seeds`` of a summary."""
    return Interval(*(facts[name] for name in ("mean", "low", "high", "episodes")))


def read_members(archives: Sequence[Path]) -> list[SearchResult]:
    """Read the design searches in these folders, finished or running.

    In a folder ``.../<task>/<search>/seed<k>`` a search has the name of that folder. Elsewhere it has that of its
    algorithm, with the settings that other searches of the same algorithm and task have otherwise: the three that tell
    most of them apart, and a number where others differ by more.

    Raises:
        RunError: a folder without an archive, or with one that is damaged.
    """
    found = []
    for folder in archives:
        with Archive.read(folder / FILE) as archive:
            best = archive.best()
            found.append((folder, archive.settings, archive.records(), best[0] if best else None))
    names = _names([(folder, settings) for folder, settings, _, _ in found])
    results = []
    for name, (folder, settings, records, winner) in zip(names, found, strict=True):
        results.append(SearchResult(folder, name, settings, records, winner, read_summary(folder)))
    return results


def _names(found: Sequence[tuple[Path, Mapping[str, Any]]]) -> list[str]:
    """Name each search by its folder or by the settings that differ between searches."""
    settings = [flat(own) for _, own in found]
    kinds = [(own.get("task"), str(own.get("search.algorithm", "search"))) for own in settings]

    # Settings that distinguish searches with the same task and algorithm
    may_differ = ("task", "seed", "shape", "search.algorithm", "search.max_designs")
    keys = {}
    for kind in dict.fromkeys(kinds):
        alike = [own for own, other in zip(settings, kinds, strict=True) if other == kind]
        keys[kind] = telling(alike, [key for key in differing(alike) if key not in may_differ])

    # Names: the first few of these settings, and a number where these are equal but others differ
    names = []
    known: dict[str, list[dict[str, Any]]] = {}
    for (folder, _), own, kind in zip(found, settings, kinds, strict=True):
        if re.fullmatch(r"seed\d+", folder.name):
            names.append(folder.parent.name)
            continue
        shown = [f"{key}={own[key]}" for key in keys[kind][:SHOWN] if key in own]
        name = ", ".join([kind[1], *shown])
        values = {key: own.get(key) for key in keys[kind]}
        others = known.setdefault(name, [])
        if values not in others:
            others.append(values)
        number = others.index(values) + 1
        names.append(name if number == 1 else f"{name} #{number}")
    return names


def differing(groups: Sequence[Mapping[str, Any]]) -> list[str]:
    """List the keys whose values differ between groups, in the order of the configuration."""
    keys = dict.fromkeys(key for values in groups for key in values)
    return [key for key in keys if any(values.get(key) != groups[0].get(key) for values in groups)]


def telling(groups: Sequence[Mapping[str, Any]], keys: Sequence[str]) -> list[str]:
    """Sort ``keys`` by how many groups they distinguish together with the keys before; the task comes first."""

    def told_apart(names: Sequence[str]) -> int:
        """Count the groups that differ in these settings."""
        return len({str([group.get(name) for name in names]) for group in groups})

    first = [key for key in keys if key == "task"]
    while left := [key for key in keys if key not in first]:
        ranks = {key: (told_apart([*first, key]), told_apart([key])) for key in left}
        first.append(max(left, key=ranks.__getitem__))
    return first


def progress(members: Sequence[SearchResult], x: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the best return so far of each search ``members`` at shared values of ``evaluations`` or ``steps``.

    Begins where each has evaluated a design; one that ends before the others keeps its best return.

    Returns:
        Places, float64 ``[k]``, and returns, float64 ``[k, members]``.

    Raises:
        ValueError: a search without a design that was evaluated.
    """
    if not members or not all(len(one.best) for one in members):
        raise ValueError("A search has not evaluated any design yet.")
    spent = [getattr(one, x) for one in members]

    # All points where some search has a new design, or 200 evenly spaced ones
    first = max(each[0] for each in spent)
    last = max(each[-1] for each in spent)
    every = np.unique(np.concatenate(spent))
    places = every[every >= first] if len(every) <= 200 else np.linspace(first, last, 200)

    # Best return of each search at these points
    values = []
    for one, each in zip(members, spent, strict=True):
        design = np.searchsorted(each, places, "right") - 1
        values.append(one.best[design])
    return places.astype(np.float64), np.stack(values, axis=1)
