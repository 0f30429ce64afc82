"""The keys of ``warpvox suite``: those of its own, and those of ``warpvox codesign`` that hold for all members."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field, make_dataclass
from typing import Any, get_type_hints

from warpvox.keys import key

__all__ = ["OF_RECIPES", "suite_config"]

THREADS = "threads of a member's simulation; null: cores / workers (executor=ray: one)"
BY_MEMBER = ("preset", "task", "seed")
"""Keys of a design search that a suite sets for each member."""
OF_RECIPES = ("evaluation", "finalists", "screening", "dtype")
"""Keys that the file of a search may set besides ``search.*``; what the suite says of them holds for all searches."""


@dataclass
class _SuiteKeys:
    """Keys of ``warpvox suite`` that a single design search does not have, or has with another meaning."""

    suite: str = key(
        "quick", "a named set of tasks, searches, seeds and budgets, which the keys that are given override"
    )
    tasks: list[str] = key(
        [], "task ids, all (the 32) or benchmark10 (the ten of the paper's main comparison)", path="read"
    )
    searches: list[str] = key([], "searches to compare, named as for search of codesign")
    seeds: Any = key(3, "seeds of each task and search: [0,1,2], or their number, counted from 0")
    evaluations: Any = key(
        250, "designs that a search may train: a number, or by task, difficulty and default: {easy:250,Lifter-v0:750}"
    )
    control_steps: Any = key(
        None, "instead of evaluations: control steps of training that a search may spend; a number, or by task"
    )
    shape: Any = key(
        None, "rows and columns of the bodies, or by task; null: the paper's, [5,5] and [5,7] for Lifter-v0"
    )
    executor: str = key(
        "local",
        "where members run: in processes of this machine (local) or in tasks of Ray (ray)",
        choices=("local", "ray"),
    )
    workers: int | None = key(
        None,
        "members that run at the same time; null: one per core as far as memory allows (device=cuda: one;"
        " executor=ray: as many as there is room for)",
        low=1,
    )
    resume: str | None = key(
        None, "continue a suite: latest or its folder; tasks, searches and seeds may be added", path="read"
    )
    retry: bool = key(False, "with resume: run failed members again")
    report: str | None = key(
        None, "only make curves.csv and the report of a suite again: latest or its folder", path="read"
    )
    name: str | None = key(None, "name of the suite's folder; null: date and time")


def suite_config(codesign: type, search: type) -> type:
    """The dataclass of a suite's keys.

    Args:
        codesign: that of a design search.
        search: that of the settings of all searches.
    """
    types, fields = get_type_hints(codesign), []
    own = {item.name for item in dataclasses.fields(_SuiteKeys)} | set(BY_MEMBER)
    for item in dataclasses.fields(codesign):
        if item.name == "search":
            settings = _optional(search)
            fields.append(("search", settings, key(settings, "settings for the searches that have them")))
        elif item.name in OF_RECIPES:
            fields.append(_open(item, types[item.name]))
        elif item.name not in own:
            meaning = {"help": THREADS} if item.name == "threads" else {}
            copied = field(
                default=item.default, default_factory=item.default_factory, metadata={**item.metadata, **meaning}
            )
            fields.append((item.name, types[item.name], copied))
    return make_dataclass("SuiteConfig", fields, bases=(_SuiteKeys,), namespace={"__module__": codesign.__module__})


def _open(item: dataclasses.Field, kind: Any) -> tuple[str, Any, Any]:
    """A field of a recipe: null leaves it to the file of each search."""
    if dataclasses.is_dataclass(kind):
        types = get_type_hints(kind)
        fields = [_open(inner, types[inner.name]) for inner in dataclasses.fields(kind)]
        settings = make_dataclass(f"Suite{kind.__name__}", fields, namespace={"__module__": kind.__module__})
        return item.name, settings, field(default_factory=settings, metadata=item.metadata)
    usual = "" if item.default is None else f" (null: that of the search's file, or {item.default})"
    meaning = f"{item.metadata['help']}{usual}"
    return item.name, kind | None, field(default=None, metadata={**item.metadata, "help": meaning})


def _optional(search: type) -> type:
    """The settings of searches, of which a suite has several: null leaves them to the file of each search."""
    types = get_type_hints(search)
    fields = [
        (item.name, types[item.name] | None, field(default=None, metadata=item.metadata))
        for item in dataclasses.fields(search)
        if item.name not in ("algorithm", "max_evaluations")
    ]
    return make_dataclass("SuiteSearchConfig", fields, namespace={"__module__": search.__module__})
