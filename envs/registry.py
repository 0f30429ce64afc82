"""Tasks by name."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType

from warpvox.envs.spec import TaskSpec
from warpvox.envs.tasks import climb, locomotion, manipulate, misc, shape, traverse
from warpvox.errors import TaskError, did_you_mean, listing

__all__ = ["get_task", "released_id", "task_ids"]

_FAMILIES = (locomotion, manipulate, climb, traverse, shape, misc)
_ALIASES = {"WingspanMazimizer-v0": "WingspanMaximizer-v0"}  # the release's spelling
_RELEASED = {ours: theirs for theirs, ours in _ALIASES.items()}
_files: dict[Path, ModuleType] = {}


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
    imported; modules are looked for in the current folder, too. The release's misspelling ``WingspanMazimizer-v0`` is
    understood.

    Raises:
        TaskError: no such task; the message names the nearest and lists all. Or a module that cannot be imported, or
            has no such specification.
    """
    if isinstance(task, TaskSpec):
        return task
    if isinstance(task, str) and ":" in task:
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
    source, _, name = text.rpartition(":")
    try:
        module = _import_file(source) if source.endswith(".py") else _import_module(source)
    except TaskError:
        raise
    except (Exception, SystemExit) as error:  # whatever a user's module may raise
        raise TaskError(f"The task {text!r} cannot be imported: {type(error).__name__}: {error}") from error
    found = getattr(module, name, None)
    if not isinstance(found, TaskSpec):
        known = [key for key, value in vars(module).items() if isinstance(value, TaskSpec)]
        what = "is no TaskSpec" if hasattr(module, name) else "does not exist"
        raise TaskError(f"{name!r} {what} in {source}.{did_you_mean(name, known)} TaskSpecs there: {listing(known)}.")
    return found


def _import_file(source: str) -> ModuleType:
    path = Path(source).expanduser().resolve()
    if path not in _files:
        if not path.is_file():
            raise TaskError(f"There is no file {source}.")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        _files[path] = module
    return _files[path]


def _import_module(source: str) -> ModuleType:
    here = os.getcwd()
    sys.path.insert(0, here)  # a program that is started by its name does not look into the current folder
    try:
        return importlib.import_module(source)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{source}.".startswith(f"{error.name}."):
            raise
        raise TaskError(f"There is no module {source!r}, neither in {here} nor installed.") from None
    finally:
        sys.path.remove(here)
