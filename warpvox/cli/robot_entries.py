"""Entries of the zoo from what searches and trainings have left."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from warpvox.algos.codesign.robots import robots_of
from warpvox.algos.disturbance import CHOOSING
from warpvox.algos.settings import physics_of
from warpvox.algos.training.settings import Training
from warpvox.cli.config import load
from warpvox.cli.help import as_typed, flat_values, options_of
from warpvox.code import is_code
from warpvox.configs.schema import PRESET
from warpvox.envs.registry import get_task
from warpvox.errors import RunError
from warpvox.io.writing import claimed, writing
from warpvox.robots.entry import Robot, read_robot, save_robot
from warpvox.robots.returns import CANDIDATE, is_better, judge_robust, recorded
from warpvox.runs import as_name, matches
from warpvox.trust import allowed

GROUPS = {
    "train": {"ppo": None},
    "codesign": {"search": "search.algorithm", "evaluation": "evaluation.name", "training": None},
}
"""Groups of keys whose choices shorten a command, and the key that says which choice a configuration has."""
ELSEWHERE = {"output_dir", "name", "resume", "config", "report", "export", "threads", "device", "executor", "workers"}
"""Keys that do not change what is found, or name places on a machine."""


def find_sources(texts: Sequence[str]) -> list[Path]:
    """The folders and checkpoints that texts or patterns name."""
    found: list[Path] = []
    for text in texts:
        path = Path(text).expanduser()
        paths = matches(text) or ([path] if path.exists() else [])
        if not paths:
            raise RunError(f"There is no design search, run or checkpoint at {text}.")
        found += paths
    return list(dict.fromkeys(found))


def add(source: Path, folder: Path, top: int, task: str | None = None) -> tuple[Robot, Robot | None, Path | None]:
    """Evaluate the best robot of ``source`` in exact arithmetic; write its entry if it is better than that there is.

    Returns the robot, the entry that was there before, if any, and the file if written.

    Args:
        source: as for :func:`robots_of`.
        top: designs of a search that are evaluated: fitness is in float32, and contacts magnify every difference.
        task: the code of a task of the user's own, which the source names.
    """
    robots = list(robots_of(source, top))
    if not robots:
        raise RunError(f"The design search {source} has no design with a policy yet.")
    home, own = source if source.is_dir() else source.parent, robots[0].task
    if task not in (None, own) and not is_code(own):
        raise RunError(f"{source} is of {own}, got task={task}; only the code of a task of your own is named so.")
    robots = [dataclasses.replace(robot, task=allowed("task", robot.task, task, home)) for robot in robots]
    command = _command(robots[0].about)
    for before in robots[0].about.get("start", ()):
        if "config" in before:  # of a training whose policy the next one began with
            before["command"] = _command(before)
    tried = [(judge_robust(robot, "noise", CANDIDATE, CHOOSING)["noise"], robot) for robot in robots]
    returns, best = max(tried, key=lambda one: sum(one[0]))
    best = recorded(best, {**best.about, "command": command, "chosen_by": returns})
    best = dataclasses.replace(best, task=get_task(best.task).id)
    path = folder / f"{as_name(best.task)}.npz"
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with claimed(folder, wait=True):  # from the comparison on: another process may have a better one
        before = read_robot(path) if path.is_file() else None
        if before is not None and before.policy is not None and not before.about.get("chosen_by"):  # made elsewhere
            same = dataclasses.replace(before, task=robots[0].task)  # which may be code
            returns = judge_robust(same, "noise", CANDIDATE, CHOOSING)["noise"]
            before = dataclasses.replace(before, about={**before.about, "chosen_by": returns})
        return best, before, None if before is not None and not is_better(best, before) else save_robot(path, best)


def _command(about: Mapping[str, Any]) -> str:
    return command_of("codesign" if "search" in about["config"] else "train", about["config"])


def command_of(command: str, config: dict[str, Any]) -> str:
    """The shortest command line that ``config``, the content of a ``config.yaml``, comes from: what is no default."""
    own = Training.of({name: config[name] for name in ("physics", "rules") if name in config})
    usual = dataclasses.asdict(physics_of(dataclasses.replace(own, physics=own.physics.preset)))
    usual |= {"preset": own.rules}  # all constants are written, those of the preset, too
    values = {
        name: value
        for name, value in flat_values(command, config).items()
        if not name.startswith("physics.") or value not in (None, "auto", usual[name.removeprefix("physics.")])
    }
    words: list[str] = []
    for group, key in GROUPS[command].items():
        only, known = values.get(key), _values(command, tuple(words))
        names = [name for name in options_of(command, group) if key is None or name == only]
        choices = [[*words, f"{group}={name}"] for name in names]
        if key is None or only in (None, known[key]):  # else the choice has keys that the others lack
            choices.insert(0, words)
        words = min(choices, key=lambda one: (len(_differences(command, one, values)), len(one)))
    return " ".join(["warpvox", command, *words, *_differences(command, words, values)])


def _differences(command: str, words: list[str], values: dict[str, Any]) -> list[str]:
    base = _values(command, tuple(words))
    return [
        f"{name}={as_typed(value)}"
        for name, value in values.items()
        if name in base and value != base[name] and name not in {*ELSEWHERE, PRESET}
    ]


@functools.cache
def _values(command: str, words: tuple[str, ...]) -> dict[str, Any]:
    return flat_values(command, dataclasses.asdict(load(command, list(words))))
