"""Tasks by name."""

from __future__ import annotations

import os
from pathlib import Path

from warpvox.envs.sources import is_code, lacks_module, load_code, split
from warpvox.envs.spec import TaskSpec
from warpvox.envs.tasks import climb, locomotion, manipulate, misc, shape, traverse
from warpvox.errors import TaskError, did_you_mean, listing
from warpvox.io.reading import Missing

__all__ = ["get_task", "released_id", "task_ids"]

_FAMILIES = (locomotion, manipulate, climb, traverse, shape, misc)
_ALIASES = {"WingspanMazimizer-v0": "WingspanMaximizer-v0"}  # the release's spelling
_RELEASED = {ours: theirs for theirs, ours in _ALIASES.items()}


def _in_order_of_the_paper(spec: TaskSpec) -> list[int]:
    return [int(number) for number in spec.section.split(".")[1:]]


_TASKS = {
    spec.id: spec
    for spec in sorted((spec for family in _FAMILIES for spec in family.TASKS), key=_in_order_of_the_paper)
}


def task_ids() -> list[str]:
    """Ids of all tasks in the order of the paper."""
    return list(_TASKS)


def get_task(task: str | TaskSpec) -> TaskSpec:
    """The task with this id; a specification (a task of the user's own) is returned as it is.

    ``module:NAME`` and ``path/to/file.py:NAME`` name a specification in a module or file of the user's, which is
    imported (see :mod:`warpvox.envs.sources`). The release's misspelling ``WingspanMazimizer-v0`` is understood.

    Raises:
        TaskError: no such task; the message names the nearest and lists all. Or a module that cannot be imported, or
            has no such specification.
    """
    if isinstance(task, TaskSpec):
        return task
    if is_code(task):
        return _task_of(task)
    task = _ALIASES.get(task, task) if isinstance(task, str) else task
    if not isinstance(task, str) or task not in _TASKS:
        raise TaskError(f"Unknown task {task!r}.{did_you_mean(task, _TASKS)} Tasks: {listing(_TASKS, 40)}.")
    return _TASKS[task]


def released_id(task_id: str) -> str:
    """How the release spells the id of a task."""
    return _RELEASED.get(task_id, task_id)


def _task_of(text: str) -> TaskSpec:
    """The specification that ``module:NAME`` or ``file.py:NAME`` names."""
    place, name = split(text)
    try:
        module = load_code(place).module
    except (Exception, SystemExit) as error:  # a user's module may raise anything
        raise TaskError(_why_not(text, place, error)) from error
    found = getattr(module, name, None)
    if not isinstance(found, TaskSpec):
        known = [key for key, value in vars(module).items() if isinstance(value, TaskSpec)]
        what = "is no TaskSpec" if hasattr(module, name) else "does not exist"
        raise TaskError(f"{name!r} {what} in {place}.{did_you_mean(name, known)} TaskSpecs there: {listing(known)}.")
    return found


def _why_not(text: str, place: str, error: BaseException) -> str:
    if place.endswith(".py") and not Path(place).expanduser().is_file():
        return f"There is no file {place}."
    if lacks_module(place, error):
        return f"There is no module {place!r}, neither in {os.getcwd()} nor installed."
    beside = " Relative names of files are looked up beside the task's own file." if _lacks_file(error) else ""
    return f"The task {text!r} cannot be imported: {type(error).__name__}: {str(error).rstrip('.')}.{beside}"


def _lacks_file(error: BaseException | None) -> bool:
    """Whether a file was missing, at the root of an error."""
    while error is not None:
        if isinstance(error, FileNotFoundError | Missing):
            return True
        error = error.__cause__ or error.__context__
    return False
