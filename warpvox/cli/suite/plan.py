"""The members of a suite: tasks x searches x seeds, each with the configuration of its design search."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpvox.algos.search.settings import ALGORITHMS
from warpvox.checks import check_integer, check_shape, is_integer
from warpvox.cli.config import load
from warpvox.cli.costs import costs_of
from warpvox.cli.evaluations import has_common_policy
from warpvox.cli.help import options_of
from warpvox.configs.paper import shape_of
from warpvox.configs.schema import CodesignConfig, SuiteConfig
from warpvox.configs.suite_keys import OF_RECIPES
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import TaskSpec
from warpvox.errors import ConfigError, did_you_mean, listing

__all__ = ["BENCHMARK10", "Member", "plan", "seeds_of", "task_names"]

BENCHMARK10 = (
    "Walker-v0",
    "BridgeWalker-v0",
    "UpStepper-v0",
    "Traverser-v0",
    "Climber-v0",
    "Carrier-v0",
    "Thrower-v0",
    "Catcher-v0",
    "Lifter-v0",
    "BeamSlider-v0",
)
"""The tasks of the paper's main comparison (section B)."""
NAMED = {"all": task_ids, "benchmark10": lambda: BENCHMARK10}
DIFFICULTIES, DEFAULT = ("easy", "medium", "hard"), "default"
OF_SUITES = ("executor", "address", "workers", "resume", "report", "name", "config", "search", "shape")
"""Keys that a design search has, too, with another meaning or value than in a suite."""


@dataclass(frozen=True)
class Member:
    """One design search of a suite; ``task`` is the id, ``search`` the name of the search's file."""

    task: str
    search: str
    seed: int
    config: CodesignConfig

    @property
    def key(self) -> tuple[str, str, int]:
        """What no other member of the suite has."""
        return self.task, self.search, self.seed

    @property
    def folder(self) -> Path:
        """Of its run, in the folder of the suite."""
        return Path("members", self.task, self.search, f"seed{self.seed}")


def plan(config: SuiteConfig, config_dir: Path | None = None) -> list[Member]:
    """All members, first those of the first seed, so that every task has a first result soon.

    Args:
        config_dir: the user's folder of YAML files, which may hold searches.

    Raises:
        WarpvoxError: a task, search, seed or budget that does not exist or does not go with the others.
    """
    tasks, seeds = _tasks(config.tasks), seeds_of(config.seeds)
    searches, recipes = _searches(config, config_dir)
    own = {item.name for item in dataclasses.fields(SuiteConfig)} - set(OF_SUITES)
    shared = {item.name: getattr(config, item.name) for item in dataclasses.fields(CodesignConfig) if item.name in own}
    members = []
    for seed, (task, spec), (search, settings) in itertools.product(seeds, tasks.items(), searches.items()):
        shape = _of_task("shape", config.shape, spec)
        shape = shape_of(spec.id) if shape is None else list(check_shape("shape", shape))
        values = shared | {"task": task, "shape": shape, "seed": seed} | recipes[search]
        member = CodesignConfig(**values, search=settings)
        settings = dataclasses.replace(settings, max_evaluations=_evaluations(config, spec, member))
        members.append(Member(spec.id, search, seed, dataclasses.replace(member, search=settings)))
    return members


def task_names(names: list[str]) -> list[str]:
    """The tasks that ``tasks`` stands for, each once.

    Raises:
        ConfigError: none at all, or a misspelt name of several.
    """
    chosen = list(dict.fromkeys(task for name in names for task in (NAMED[name]() if name in NAMED else [name])))
    for name in chosen:
        if hint := did_you_mean(name, NAMED):
            raise ConfigError(f"tasks must be {listing(NAMED)}, or a list of task ids; got '{name}'.{hint}")
    if not chosen:
        raise ConfigError(f"tasks must be {listing(NAMED)}, or a list of task ids; got [].")
    return chosen


def _tasks(names: list[str]) -> dict[str, TaskSpec]:
    """The tasks by the names that they are given by.

    Raises:
        TaskError, ConfigError: a task that does not exist, or two with one id.
    """
    tasks = {name: get_task(name) for name in task_names(names)}
    ids = [spec.id for spec in tasks.values()]
    twice = next((name for name in ids if ids.count(name) > 1), None)
    if twice:
        raise ConfigError(f"tasks names {twice} more than once.")
    return tasks


def _searches(config: SuiteConfig, config_dir: Path | None) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Of each search by its name the settings, and how designs are evaluated (the keys :data:`OF_RECIPES`).

    Both are those of its file with what the suite says instead.
    """
    known = options_of("search", config_dir)
    if not config.searches:
        raise ConfigError(f"searches must name one search or more of {listing(known)}, got [].")
    for name in config.searches:
        if name not in known:
            raise ConfigError(f"searches must be of {listing(known)}; got '{name}'.{did_you_mean(name, known)}")
    files = {name: load("codesign", [f"search={name}"], config_dir) for name in dict.fromkeys(config.searches)}
    found = {name: file.search for name, file in files.items()}
    given = _given(config.search)
    for name in given:
        if not any(_has(settings, name) for settings in found.values()):
            raise ConfigError(f"None of the searches {listing(found)} has the setting search.{name}.")
    changed = {
        search: dataclasses.replace(settings, **{name: given[name] for name in given if _has(settings, name)})
        for search, settings in found.items()
    }
    return changed, {name: {key: _said(config, file, key) for key in OF_RECIPES} for name, file in files.items()}


def _said(config: SuiteConfig, file: CodesignConfig, key: str) -> Any:
    """The value of ``key`` for the members of one search: the suite's, or else that of its file."""
    value, usual = getattr(config, key), getattr(file, key)
    if dataclasses.is_dataclass(value):
        return dataclasses.replace(usual, **_given(value))
    return usual if value is None else value


def _given(settings: Any) -> dict[str, Any]:
    """The settings of a suite that are not left to the files of the searches."""
    return {name: value for name, value in vars(settings).items() if value is not None}


def _has(settings: Any, name: str) -> bool:
    return name in {item.name for item in dataclasses.fields(ALGORITHMS[settings.algorithm])}


def seeds_of(value: Any) -> list[int]:
    """The seeds that ``seeds`` stands for, each once: a list, or how many there are.

    Raises:
        ConfigError: neither.
    """
    if is_integer(value):
        return list(range(check_integer("seeds", value, 1)))
    if not isinstance(value, list) or not value:
        raise ConfigError(f"seeds must be how many there are, or a list such as [0,1,2]; got {value!r}.")
    return list(dict.fromkeys(check_integer("seeds", seed, 0) for seed in value))


# ------------------------------------------------------------------------------------------------------- budgets


def _of_task(key: str, value: Any, task: TaskSpec) -> Any:
    """What a value that may be given by task is for ``task``.

    Raises:
        ConfigError: it names a task that there is not, or says nothing of this one.
    """
    if not isinstance(value, Mapping):
        return value
    names = (*DIFFICULTIES, DEFAULT, *task_ids())
    for name in value:
        if name not in names and name != task.id:
            raise ConfigError(f"{key} goes by task ids, {listing(names[:4])}; got '{name}'.{did_you_mean(name, names)}")
    found = next((name for name in (task.id, task.difficulty, DEFAULT) if name in value), None)
    if found is None:
        raise ConfigError(f"{key} says nothing of {task.id}: add {task.id}, {task.difficulty} or {DEFAULT}.")
    return value[found]


def _evaluations(config: SuiteConfig, task: TaskSpec, member: CodesignConfig) -> int:
    """How many designs a member may evaluate on ``task``."""
    if config.control_steps is None:
        return check_integer("evaluations", _of_task("evaluations", config.evaluations, task), 1)
    if has_common_policy(member):
        raise ConfigError(
            "control_steps goes with evaluation=specialist or gaits, where a design takes a known number of them."
        )
    cost, last = costs_of(member, task)
    steps = check_integer("control_steps", _of_task("control_steps", config.control_steps, task), 1)
    if steps < cost + last:
        what = "which a design takes" if not last else "for a design and the finalists"
        raise ConfigError(
            f"control_steps must be at least {math.ceil(cost + last):,}, {what}; got {steps:,} for {task.id}."
        )
    return int((steps - last) // cost)
