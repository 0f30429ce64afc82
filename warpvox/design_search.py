"""Design search from Python."""

import dataclasses
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from warpvox.algos.candidate import DesignEvaluator, Search
from warpvox.algos.codesign.fitness import Custom
from warpvox.algos.codesign.loop import Executor
from warpvox.algos.codesign.results import Found
from warpvox.algos.codesign.run import plan_codesign, run_codesign
from warpvox.algos.codesign.settings import FITNESS, Codesign, Fitness
from warpvox.algos.listener import Listener
from warpvox.algos.search.base import BaseSearch
from warpvox.algos.search.settings import ALGORITHMS, CustomSearch, SearchSettings
from warpvox.checks import check_flag, check_path, is_integer, is_list
from warpvox.code import KEYS, Code, with_passed_code
from warpvox.errors import ConfigError
from warpvox.keys import changed, check_known, in_words
from warpvox.progress.search import SearchProgress, with_tracker


@in_words
def codesign(
    task: Any = "Walker-v0",
    shape: Sequence[int] | None = None,
    *,
    search: str | SearchSettings | Search = "ga",
    fitness: str | Fitness | DesignEvaluator | None = None,
    executor: str | Executor = "local",
    folder: str | Path | None = "auto",
    progress: bool = True,
    listeners: Sequence[Listener] = (),
    **settings: Any,
) -> Found:
    """Search for a body and a policy that controls it; blocks until the search ends.

    An interrupt (Ctrl-C, a notebook's stop button) saves the state and raises KeyboardInterrupt; the same call with
    ``folder`` goes on.

    Args:
        task: id, ``FILE.py:NAME``, or a :class:`warpvox.envs.spec.TaskSpec`.
        shape: rows and columns of the bodies; None: those of ``search`` where it has them, else 5 x 5.
        search: ``GA(population=25)``, ..., a name as on the command line, ``"auto"`` for instance, or a search of your
            own, which asks and tells; of a ``BaseSearch`` shape and seed are those of the search.
        fitness: ``Specialist()``, ``Gaits(rounds=4)``, ..., a name, or an evaluator of your own with a method
            ``evaluate(candidates, parents, report)``; None: ``Specialist()``, or as named by ``search``.
        executor: ``local``, ``ray``, or one of your own.
        folder: a search that is there is gone on with; ``auto``: a new one in ``outputs/codesign``, ``None``: a
            temporary one, which goes with the process.
        progress: show how the search goes.
        listeners: objects with the callbacks of :class:`warpvox.algos.listener.Listener`.
        settings: the others of :class:`Codesign`: ``training``, ``seed``, ``device``, ``start``, ...

    Raises:
        ConfigError: an unknown setting, or a value that it does not take. WarpvoxError: something cannot be made.
        KeyboardInterrupt: interrupted; the state has been saved.
    """
    own = None if isinstance(search, str | Mapping | SearchSettings) else search
    if own is not None:
        if isinstance(own, type) or not callable(getattr(own, "ask", None)):
            raise ConfigError(f"search must be GA(), ..., a name, or an object that asks and tells; got {own!r:.80}.")
        has = getattr(own, "settings", own)  # which a BaseSearch has
        names = "population", "max_designs"
        sizes: dict[str, Any] = {name: getattr(has, name) for name in names if is_integer(getattr(has, name, None))}
        search = CustomSearch(make=_name(own), **sizes)
    evaluator = None
    if not isinstance(fitness, str | Mapping | Fitness | None):
        evaluator = fitness
        if not callable(getattr(evaluator, "evaluate", None)):
            raise ConfigError(
                f"fitness must be Specialist(), Gaits(), ..., their name, or an object with a method evaluate; got"
                f" {evaluator!r:.80}."
            )
        fitness = Custom(make=_name(evaluator))
    check_flag("progress", progress)
    if not isinstance(executor, str) and not callable(getattr(executor, "run", None)):
        raise ConfigError(f"executor must be local, ray, or an object that runs batches; got {executor!r:.80}.")
    if not is_list(listeners) or not all(callable(getattr(one, "begun", None)) for one in listeners):
        raise ConfigError(f"listeners must be a list of objects with the callbacks of Listener; got {listeners!r:.80}.")
    named = None if folder is None else check_path("folder", folder)
    where: dict[str, Any] = {"executor": executor} if isinstance(executor, str) else {}
    settings = check_known(settings, codesign, Codesign)
    how = {"task": task, "shape": shape, "search": search, "fitness": fitness} | where | settings
    how = {key: value for key, value in how.items() if value is not None}
    if isinstance(own, BaseSearch):
        how = {"shape": own.shape, "seed": own.seed} | how
    job = Codesign(**_without_names(how))
    if isinstance(own, BaseSearch) and (tuple(job.shape), job.seed) != (own.shape, own.seed):
        raise ConfigError(
            f"The search was made with shape={list(own.shape)} and seed={own.seed}, asked for {job.shape} and"
            f" {job.seed}: leave them away, or make the search with them."
        )
    job = with_passed_code(job, KEYS, folder)
    kept = tempfile.TemporaryDirectory(prefix="warpvox_") if folder is None else None
    place = Path(kept.name) if kept else None if str(named) == "auto" else named
    watching = with_tracker(job, [*([SearchProgress(Console())] if progress else []), *listeners])
    made = None if isinstance(executor, str) else executor
    plan = plan_codesign(job, place, search=own, evaluator=evaluator)
    found = run_codesign(plan, watching, made)
    return dataclasses.replace(found, kept=kept)


def _without_names(given: dict[str, Any]) -> dict[str, Any]:
    """Replace named presets such as ``search="auto"`` by their settings; settings given explicitly win."""
    texts = {key: given[key] for key in ("search", "fitness", "training") if isinstance(given.get(key), str)}
    sets = {key: name for key, name in texts.items() if name not in (*ALGORITHMS, *FITNESS)}
    if not sets:
        return given
    from warpvox.configs.composition import settings_named

    named = settings_named("codesign", **sets, **({"task": given["task"]} if isinstance(given["task"], str) else {}))
    for key, value in given.items():
        if key not in sets:
            named[key] = changed(named[key], value, key) if key in named and isinstance(value, Mapping) else value
    return named


def _name(thing: object) -> Code:
    """Return the class of an object as code, ``MODULE:NAME``, for the command line."""
    return Code(f"{type(thing).__module__}:{type(thing).__name__}")
