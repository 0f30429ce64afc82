"""Tasks by name."""

from warpvox.code import is_code, load_code
from warpvox.envs.spec import TaskSpec
from warpvox.envs.tasks import climb, locomotion, manipulate, misc, shape, traverse
from warpvox.errors import TaskError, did_you_mean, listing

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

    A :class:`warpvox.code.Code` (``module:NAME`` or ``path/to/file.py:NAME``, typed by the user) names a specification
    in a module or file, which is imported. A plain string is the id of a task and nothing else, as it may come from a
    file. The release's misspelling ``WingspanMazimizer-v0`` is understood.

    Raises:
        TaskError: no such task; the message names the nearest and lists all. ConfigError: a string that names code, or
            code that cannot be imported or is no specification.
    """
    if isinstance(task, TaskSpec):
        return task
    if is_code(task):
        return load_code(task, lambda value: isinstance(value, TaskSpec), "TaskSpec")
    task = _ALIASES.get(task, task) if isinstance(task, str) else task
    if not isinstance(task, str) or task not in _TASKS:
        raise TaskError(f"Unknown task {task!r}.{did_you_mean(task, _TASKS)} Tasks: {listing(_TASKS, 40)}.")
    return _TASKS[task]


def released_id(task_id: str) -> str:
    """The id of a task as the release spells it."""
    return _RELEASED.get(task_id, task_id)
