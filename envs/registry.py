"""Tasks by id, and published returns."""

# Users may give anything for a text.
# pyright: reportUnnecessaryIsInstance=false

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from warpvox.code import is_code, load_code
from warpvox.envs.spec import TaskSpec
from warpvox.envs.tasks import climb, locomotion, manipulate, misc, shape, traverse
from warpvox.errors import TaskError, did_you_mean, listing
from warpvox.examples import bare_id

_ALIASES = {"WingspanMazimizer-v0": "WingspanMaximizer-v0"}  # the release's spelling
_TASKS = {
    spec.id: spec
    for family in (locomotion, manipulate, climb, traverse, shape, misc)  # in the order of the paper
    for spec in family.TASKS
}


def task_ids() -> list[str]:
    """List the ids of all tasks in the order of the paper."""
    return list(_TASKS)


def get_task(task: str | TaskSpec) -> TaskSpec:
    """Look up a task by id; a specification is returned unchanged.

    A :class:`warpvox.code.Code` (``module:NAME`` or ``path/to/file.py:NAME``, typed by the user) names a specification
    in a module or file, which is imported. A plain string is the id of a task and nothing else, as it may come from a
    file. The release's misspelling ``WingspanMazimizer-v0`` is understood.

    Raises:
        TaskError: no such task; the message names the nearest, or lists all. ConfigError: a string that names code, or
            code that cannot be imported or is no specification.
    """
    if isinstance(task, TaskSpec):
        return task
    if is_code(task):
        return load_code(task, lambda value: isinstance(value, TaskSpec), "TaskSpec")
    task = bare_id(task)
    task = _ALIASES.get(task, task) if isinstance(task, str) else task
    if not isinstance(task, str) or task not in _TASKS:
        hint = did_you_mean(task, _TASKS) or f" Tasks: {listing(_TASKS, 40)}."
        if str(task).endswith(".py"):
            hint = f" Of a file name the task in it, too: {task}:NAME."
        raise TaskError(f"Unknown task {task!r}.{hint}")
    return _TASKS[task]


def released_id(task_id: str) -> str:
    """Return a task's id as the released benchmark spells it."""
    return next((theirs for theirs, ours in _ALIASES.items() if ours == task_id), task_id)


@dataclass(frozen=True)
class KnownReturn:
    """Published and measured returns of a task.

    Attributes:
        task: its id.
        random: mean return of random bodies under random actions, measured by ``python -m lab.zoo.results random``.
        best: the best published return, None if there is none.
        method: who found it.
        source: where the number is found.
        protocol: how it was found, as far as the source says.
        note: what else to know about it.
    """

    task: str
    random: float
    best: float | None
    method: str
    source: str
    protocol: str
    note: str

    def score(self, value: float) -> float:
        """Normalise a return: ``(value - random) / (best - random)``, 0 is chance, 1 the best published return.

        Raises:
            ValueError: no return is published.
        """
        if self.best is None:
            raise ValueError(f"No return of {self.task} is published.")
        return (value - self.random) / (self.best - self.random)


@cache
def known_returns() -> dict[str, KnownReturn]:
    """Load the known returns of the benchmark's tasks, by id."""
    text = files("warpvox.envs").joinpath("known_returns.csv").read_text(encoding="utf-8")
    rows: list[dict[str, Any]] = list(csv.DictReader(text.splitlines()))
    for row in rows:
        row |= {"random": float(row["random"]), "best": float(row["best"]) if row["best"] else None}
    return {row["task"]: KnownReturn(**row) for row in rows}
