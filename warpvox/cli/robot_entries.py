"""Entries of the zoo from what searches and trainings have left."""

from __future__ import annotations

import dataclasses
import functools
import glob
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.algos.candidate import FINALIST
from warpvox.algos.codesign.archive import FILE as ARCHIVE, Archive, Record
from warpvox.cli.config import load
from warpvox.cli.help import flat_values, options_of
from warpvox.cli.start import history_of
from warpvox.configs.schema import PRESET
from warpvox.design import check_design, full_connections
from warpvox.envs.registry import get_task
from warpvox.errors import RunError
from warpvox.robots.entry import Robot, read_robot, save_robot
from warpvox.robots.network import Network
from warpvox.robots.replay import policy_of_checkpoint, recorded
from warpvox.runs import Run, as_name, find_codesign, find_run, read_summary
from warpvox.trust import allowed

__all__ = ["Outcome", "add", "command_of", "find_sources", "robots_of", "trained"]

GROUPS = {"train": ("ppo",), "codesign": ("search", "training")}
"""Groups of keys whose YAML files shorten a command."""
ELSEWHERE = {"output_dir", "name", "resume", "config", "report", "export", "threads", "device", "executor", "workers"}
"""Keys that do not change what is found, or name places on a machine."""
WEIGHT_BITS = 8
"""Last bits of a weight's 23 that entries leave out, so that those of all tasks fit into a megabyte."""


@dataclass(frozen=True)
class Outcome:
    """The result for a folder: the robot found there, and the return of the entry that was there before, if any."""

    robot: Robot
    before: float | None
    written: Path | None


def find_sources(texts: Sequence[str]) -> list[Path]:
    """The folders and checkpoints that texts or patterns name.

    Raises:
        RunError: a text that names nothing.
    """
    found: list[Path] = []
    for text in texts:
        path = Path(text).expanduser()
        paths = [path] if path.exists() else sorted(map(Path, glob.glob(os.path.expanduser(text), recursive=True)))
        if not paths:
            raise RunError(f"There is no design search, run or checkpoint at {text}.")
        found += paths
    return list(dict.fromkeys(found))


def add(source: Path, folder: Path, top: int, task: str | None = None) -> Outcome:
    """Evaluate the best robot of ``source`` in exact arithmetic; write its entry if its return is the higher one.

    Args:
        source: as for :func:`robots_of`.
        folder: of the entries.
        top: designs of a search that are evaluated: fitness is in float32, and contacts magnify every difference.
        task: the code of a task of the user's own, which the source names.

    Raises:
        ConfigError: the source names code, and the user does not.
        RunError: no such search or run, or no policy that an entry can have.
    """
    robots = list(robots_of(source, top))
    if not robots:
        raise RunError(f"The design search {source} has no evaluated design yet.")
    home = source if source.is_dir() else source.parent
    robots = [dataclasses.replace(robot, task=allowed("task", robot.task, task, home)) for robot in robots]
    best = max((recorded(robot, dict(robot.about)) for robot in robots), key=lambda robot: robot.mean_return)
    best = dataclasses.replace(best, task=get_task(best.task).id)
    path = folder / f"{as_name(best.task)}.npz"
    before = read_robot(path).mean_return if path.is_file() else None
    if before is not None and best.mean_return <= before:
        return Outcome(best, before, None)
    return Outcome(best, before, save_robot(path, best))


def robots_of(source: Path, top: int) -> Iterator[Robot]:
    """The robots that a search or training has left, with what its files say of them.

    Args:
        source: folder of a design search, of a design in one (``designs/17``) or of a training, or a checkpoint in the
            latter.
        top: of a search the best designs, as many.

    Raises:
        RunError: no such search or run, or no policy that an entry can have.
    """
    if (source / ARCHIVE).is_file():
        return _of_search(source, lambda archive: trained(archive)[:top])
    search = source.absolute().parent.parent
    if source.name.isdecimal() and (search / ARCHIVE).is_file():
        return _of_search(search, lambda archive: [archive.record(int(source.name))])
    return _of_run(source)


def _of_search(folder: Path, choose: Callable[[Archive], list[Record]]) -> Iterator[Robot]:
    run = find_codesign(str(folder), "")
    with Archive.read(folder / ARCHIVE) as archive:
        records = choose(archive)
        steps = sum(row["steps"] or 0 for row in archive.generations())
    about = _about(run, "codesign") | {"control_steps": steps}
    if start := history_of(folder):  # what a robot has cost includes those that it was made from
        about["start"] = start
        for name in "control_steps", "wall_s":
            about[name] = (about[name] or 0) + sum(known[name] or 0 for known in start)
    for record in records:
        if record.policy is None:
            raise RunError(f"Design {record.id} of {folder} has no policy of its own.")
        known = about | {"design": record.id, "design_steps": record.steps, "fitness": record.fitness}
        yield _robot(run.config["task"], record.candidate.body, folder / record.policy, known)


def trained(archive: Archive) -> list[Record]:
    """The designs with a policy of their own, the best first; finalists alone, where others were only compared."""
    records = [record for record in archive.best(max(1, archive.count())) if record.policy is not None]
    return [record for record in records if record.candidate.origin == FINALIST] or records


def _of_run(path: Path) -> Iterator[Robot]:
    run = find_run(str(path), "")
    if (run.config.get("designs") or {}).get("bodies") is not None or run.config.get("obs", "task") != "task":
        raise RunError(
            f"{path}: the zoo has robots with a body of their own that observe what the task has (obs=task)."
        )
    about = _about(run, "train") | {"control_steps": read_summary(run.folder).get("steps")}
    yield _robot(run.config["task"], check_design(run.config["design"]), run.find_checkpoint("best"), about)


def _robot(task: str, body: np.ndarray, checkpoint: Path, about: dict[str, Any]) -> Robot:
    policy = policy_of_checkpoint(checkpoint)
    if isinstance(policy, Network):
        arrays = {name: tuple(map(_shorter, getattr(policy, name))) for name in ("weights", "biases")}
        policy = dataclasses.replace(policy, **arrays)
    return Robot(task, body, full_connections(body).T, policy, about)


def _shorter(values: np.ndarray) -> np.ndarray:
    """float32 numbers whose last bits are zero."""
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32).astype(np.uint64) + (1 << (WEIGHT_BITS - 1))
    return (bits & ~np.uint64((1 << WEIGHT_BITS) - 1)).astype(np.uint32).view(np.float32)


def _about(run: Run, command: str) -> dict[str, Any]:
    """What the files of a search or training say of it."""
    summary = read_summary(run.folder)
    return {
        "command": command_of(command, run.config),
        "wall_s": summary.get("elapsed_seconds"),
        "version": summary.get("version"),
        "commit": summary.get("commit"),
        "processor": summary.get("processor"),
        "config": {name: value for name, value in run.config.items() if name not in ("output_dir", "name")},
    }


def command_of(command: str, config: dict[str, Any]) -> str:
    """The shortest command line that ``config``, the content of a ``config.yaml``, comes from: what is no default."""
    values = {name: value for name, value in flat_values(config).items() if not name.startswith("physics.")}
    words: list[str] = []
    for group in GROUPS[command]:
        only = values.get("search.algorithm") if group == "search" else None
        names = [name for name in options_of(group) if only in (None, name)]
        choices = [[*words, f"{group}={name}"] for name in names]
        words = min([words, *choices], key=lambda one: (len(_differences(command, one, values)), len(one)))
    return " ".join(["warpvox", command, *words, *_differences(command, words, values)])


def _differences(command: str, words: list[str], values: dict[str, Any]) -> list[str]:
    base = _values(command, tuple(words))
    return [
        f"{name}={_text(value)}"
        for name, value in values.items()
        if name in base and value != base[name] and name not in {*ELSEWHERE, PRESET}
    ]


@functools.cache
def _values(command: str, words: tuple[str, ...]) -> dict[str, Any]:
    return flat_values(dataclasses.asdict(load(command, list(words))))


def _text(value: Any) -> str:
    words = {None: "null", True: "true", False: "false"}
    return words[value] if value is None or isinstance(value, bool) else str(value).replace(" ", "").replace("'", "")
