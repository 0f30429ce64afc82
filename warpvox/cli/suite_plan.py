"""The members of a suite from its keys: tasks x searches x seeds, each with the settings of its design search."""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from warpvox.algos.codesign.settings import CHANGEABLE, Codesign
from warpvox.algos.suite.members import Member
from warpvox.algos.training.pretrained import find_pretrained
from warpvox.checks import check_choice, check_integer, check_shape, is_integer
from warpvox.cli.config import load
from warpvox.cli.help import flat_values, options_of
from warpvox.cli.overrides import MOST_RUNS, key_and_value, read_overrides
from warpvox.code import Code, is_code
from warpvox.configs.codesign import SuiteConfig
from warpvox.configs.composition import quoted, shape_of
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import DIFFICULTIES, TaskSpec
from warpvox.errors import ConfigError, did_you_mean, listing
from warpvox.trust import COPIES, STORED, allowed, check_account

BENCHMARK10 = (
    "Walker-v0", "BridgeWalker-v0", "UpStepper-v0", "Traverser-v0", "Climber-v0", "Carrier-v0", "Thrower-v0",
    "Catcher-v0", "Lifter-v0", "BeamSlider-v0",
)  # fmt: skip
"""The tasks of the paper's main comparison (section B)."""
NAMED = {"all": task_ids, "benchmark10": lambda: BENCHMARK10}
DEFAULT = "default"
OF_SUITES = (
    "task", "seed", "search", "device", "threads", "executor", "address", "workers", "resume", "report", "name",
    "config", "shape", "output_dir", "preset", "export", "search.max_evaluations",
)  # fmt: skip
"""Keys of a design search that a suite has, too, or sets for each search."""


def plan(config: SuiteConfig, config_dir: Path | None = None) -> list[Member]:
    """All members, first those of the first seed, so that every task has a first result soon.

    Args:
        config_dir: the user's folder of YAML files, which may hold searches.
    """
    tasks, seeds, searches = _tasks(config.tasks), seeds_of(config.seeds), _searches(config, config_dir)
    if (count := len(tasks) * len(seeds) * len(searches)) > MOST_RUNS:
        raise ConfigError(f"A suite has {MOST_RUNS:,} members at most: tasks x searches x seeds are {count:,}.")
    members = []
    for seed, (task, spec), (search, settings) in itertools.product(seeds, tasks.items(), searches.items()):
        shape = _of_task("shape", config.shape, spec)
        shape = shape_of(spec.id) if shape is None else list(check_shape("shape", shape))
        settings = dataclasses.replace(settings, task=task, shape=shape, seed=seed)
        budget = dataclasses.replace(settings.search, max_evaluations=_evaluations(config, spec, settings))
        folder = Path("members", spec.id, search, f"seed{seed}")
        members.append(Member(spec.id, search, seed, folder, dataclasses.replace(settings, search=budget)))
    return members


def task_names(names: list[str]) -> list[str]:
    """The tasks that ``tasks`` stands for, each once."""
    chosen = list(dict.fromkeys(task for name in names for task in (NAMED[name]() if name in NAMED else [name])))
    for name in chosen:
        if hint := did_you_mean(name, NAMED):
            raise ConfigError(f"tasks must be {listing(NAMED)}, or a list of task ids; got '{name}'.{hint}")
    if not chosen:
        raise ConfigError(f"tasks must be {listing(NAMED)}, or a list of task ids; got [].")
    return chosen


def _tasks(names: list[str]) -> dict[str, TaskSpec]:
    tasks = {name: get_task(name) for name in task_names(names)}
    ids = [spec.id for spec in tasks.values()]
    twice = next((name for name in ids if ids.count(name) > 1), None)
    if twice:
        raise ConfigError(f"tasks names {twice} more than once.")
    return tasks


def _searches(config: SuiteConfig, config_dir: Path | None) -> dict[str, Codesign]:
    """The settings of each search, by its name: those of its file with what the suite says instead."""
    named = options_of("codesign", "search", config_dir)
    if not config.searches:
        raise ConfigError(f"searches must name one search or more of {listing(named)}, got [].")
    for name in config.searches:
        check_choice("each of searches", name, named)
    words = by_key(config.codesign)
    for key in words:
        if key.split("/")[0] in OF_SUITES:
            hint = did_you_mean(key, SuiteConfig.__dataclass_fields__)
            raise ConfigError(f"{key} is set by the suite for each search.{hint}")
    groups = [word for key, word in words.items() if "." not in key]
    found, taken = {}, set()
    for name in dict.fromkeys(config.searches):
        base = [f"search={name}", f"device={config.device}", f"output_dir={quoted(config.output_dir)}"]
        known = flat_values("codesign", dataclasses.asdict(load("codesign", [*base, *groups], config_dir)))
        own = [key for key in words if "." in key and key in known]
        taken |= {*own}
        found[name] = Codesign.of(vars(load("codesign", [*base, *groups, *(words[key] for key in own)], config_dir)))
    for key in words:
        if "." in key and key not in taken:
            if did_you_mean(key, OF_SUITES[-1:]):
                raise ConfigError(f"Unknown key '{key}': a suite says how much each search may do, evaluations=... .")
            load("codesign", [f"search={name}", *groups, words[key]], config_dir)  # which says what is wrong
    return found


def seeds_of(value: Any) -> list[int]:
    """The seeds that ``seeds`` stands for, each once: a list, or how many there are."""
    if is_integer(value):
        return list(range(check_integer("seeds", value, 1, MOST_RUNS)))
    if not isinstance(value, list) or not value:
        raise ConfigError(f"seeds must be how many there are, or a list such as [0,1,2]; got {value!r}.")
    return list(dict.fromkeys(check_integer("seeds", seed, 0) for seed in value))


def _of_task(key: str, value: Any, task: TaskSpec) -> Any:
    """Value for ``task`` of a key that may be given by task."""
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


def _evaluations(config: SuiteConfig, task: TaskSpec, member: Codesign) -> int:
    """How many designs a member may evaluate on ``task``."""
    if config.control_steps is None:
        return check_integer("evaluations", _of_task("evaluations", config.evaluations, task), 1)
    costs = member.evaluation.cost(member, task)
    if costs is None:
        raise ConfigError(
            f"control_steps does not go with evaluation={member.evaluation.name}, where it is not known how many of"
            " them a design takes."
        )
    cost, last = costs
    steps = check_integer("control_steps", _of_task("control_steps", config.control_steps, task), 1)
    if steps < cost + last:
        what = "which a design takes" if not last else "for a design and the finalists"
        raise ConfigError(
            f"control_steps must be at least {math.ceil(cost + last):,}, {what}; got {steps:,} for {task.id}."
        )
    return int((steps - last) // cost)


PRETRAINED = "evaluation.pretrained"


def by_key(words: Sequence[str]) -> dict[str, str]:
    """The words about design searches by their keys, as Hydra takes them; of two for one key the last."""
    instead = "all searches of a suite take the same; make a suite for each"
    overrides = (one for word in words for one in read_overrides("codesign", [word], instead=instead))
    return {override.key_or_group: str(override.input_line) for override in overrides}


def merged(words: Sequence[str], typed: Sequence[str], output_dir: str) -> list[str]:
    """``words`` with those that were typed; a pretrained policy by its place, as the latest may be another later."""
    found = by_key([*words, *typed])
    if PRETRAINED in found:
        _, name = key_and_value(found[PRETRAINED])
        found[PRETRAINED] = f"{PRETRAINED}={quoted(str(find_pretrained(name, output_dir)[0].absolute()))}"
    return list(found.values())


def gone_on_with(words: Sequence[str], typed: Sequence[str], home: Path) -> tuple[list[str], list[str]]:
    """The words of a suite in ``home`` that goes on: as it has them, and with the code that was named again."""
    before, now = by_key(words), by_key(typed)
    trusted = {}
    for key, word in now.items():
        if key in CHANGEABLE:
            before[key] = word
        elif key not in COPIES and before.get(key) != word:
            has = f"it has {before[key]}" if key in before else "it is not among those of the suite"
            raise ConfigError(f"{key} cannot change when a suite is resumed ({has}, asked for {word}).")
    for key, word in before.items():
        value = key_and_value(word)[1]
        if key in COPIES and is_code(value):
            mine = key_and_value(now[key])[1] if key in now else None
            value = allowed(key, value, Code(mine) if is_code(mine) else mine, home)
            word = f"{key}={quoted(str(value))}"
        elif key == "logger" and key not in now:
            check_account(value)
        trusted[key] = word
    for key in now:
        if key in COPIES and key_and_value(now[key])[1] == STORED and key not in before:
            raise ConfigError(f"{key}={STORED} names code in the folder of a run; {home} has none for {key}.")
    return list(before.values()), list(trusted.values())
