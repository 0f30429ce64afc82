"""Running of a design search from its settings: validation, folder, archive and loop."""

import copy
import dataclasses
import functools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from warpvox.algos.archive import FILE as ARCHIVE, Archive
from warpvox.algos.candidate import Candidate, DesignEvaluator, Outcome, Search
from warpvox.algos.codesign.finalists import Finalists
from warpvox.algos.codesign.fitness.custom import Custom
from warpvox.algos.codesign.loop import Executor, LocalExecutor, Loop
from warpvox.algos.codesign.results import Found, Results, evaluate_winner
from warpvox.algos.codesign.robots import keep_start, read_start
from warpvox.algos.codesign.settings import CHANGEABLE, Codesign
from warpvox.algos.codesign.stored_policies import StoredPolicies
from warpvox.algos.listener import Listener
from warpvox.algos.metrics import check_logger
from warpvox.algos.protocols import episodes_of
from warpvox.algos.robots.entry import Robot
from warpvox.algos.search import BaseSearch, make_search
from warpvox.algos.search.factory import start_with
from warpvox.algos.settings import sim_of
from warpvox.algos.training.job import task_name
from warpvox.algos.training.pretrained import is_on_grid, observed_by
from warpvox.algos.training.settings import Training
from warpvox.batch.options import lanes_for
from warpvox.code import same_code
from warpvox.devices.names import resolve_device
from warpvox.devices.startup import ambient, own_torch, start_warp
from warpvox.envs.memory import ask, environment_bytes, fitting
from warpvox.envs.registry import get_task
from warpvox.envs.worlds import task_world
from warpvox.errors import ConfigError, RunError, StorageError
from warpvox.io.writing import to_yaml
from warpvox.keys import flat
from warpvox.runs import CONFIG, END, as_now, keep_code, run_folder
from warpvox.types import Cell


@dataclasses.dataclass(frozen=True)
class Plan:
    """A design search with validated settings, ready to run.

    Attributes:
        settings: with names replaced by values: settings, constants and, for ``executor=local``, the device.
        place: folder of the search; None: a new one in ``output_dir``, named by the time.
        resumed: True if ``place`` holds a search, which is continued.
        start: robots that the first generation contains.
        known: data from before the search that the evaluator needs, see :meth:`Fitness.begins_with`.
        search: proposes designs; has not been asked yet.
        evaluator: evaluates designs; None: the one that the settings name.
    """

    settings: Codesign
    place: Path | None
    resumed: bool
    start: Sequence[Robot]
    known: Any
    search: Search
    evaluator: DesignEvaluator | None


def plan_codesign(
    settings: Codesign,
    place: Path | None = None,
    *,
    search: Search | None = None,
    evaluator: DesignEvaluator | None = None,
) -> Plan:
    """Validate all settings and return the plan of the search, without writing any file.

    Args:
        place: as in :class:`Plan`.
        search: gets the bodies to start with; None: the one that the settings name.
        evaluator: None: the one that the settings name.

    Raises:
        WarpvoxError: something asked for is not valid.
    """
    resumed = place is not None and (place / ARCHIVE).is_file()
    with own_torch(settings.torch_threads):
        check_logger(settings.logger)
        task_world(get_task(settings.task), np.full(settings.shape, Cell.H_ACT, np.int8))

        # Who proposes
        start = read_start(settings, place if resumed else None)
        bodies = [robot.body for robot in start]
        if search is None:
            search = make_search(settings.search, cast(Any, tuple(settings.shape)), settings.seed, bodies)
            if isinstance(search, BaseSearch):
                # Of some shapes hardly any random body holds together.
                copy.deepcopy(search).ask()
        else:
            start_with(search, bodies)

        # Who evaluates
        sim_of(settings)  # finds constants out of range
        if evaluator is None:
            settings.fitness.check(settings)
        settings = settings.resolved(place if resumed else None)

        # Where. Designs on workers run on the devices of the workers.
        if settings.executor == "local":
            resolve_device(settings.device)
            for key in ("address", "workers"):
                if getattr(settings, key) is not None:
                    raise ConfigError(f"{key} goes with executor=ray.")
            if settings.memory_check:
                _ask_for_memory(settings)
            settings = dataclasses.replace(settings, device=resolve_device(settings.device, environments(settings)))
        known = settings.fitness.begins_with(settings, start, place if resumed else None)
    return Plan(settings, place, resumed, start, known, search, evaluator)


def environments(settings: Codesign) -> int:
    """Return the largest number of environments stepped together; 1 if unknown."""
    return max((batch.designs * batch.envs for batch in settings.fitness.workloads(settings)), default=1)


def _ask_for_memory(settings: Codesign) -> None:
    """Raise MemoryLimitError if the largest designs need too much memory; the message says what would fit."""
    spec = get_task(settings.task).under(settings.rules)
    grid = None if settings.dtype == "float64" else tuple(settings.shape)
    sim = dataclasses.replace(sim_of(settings), grid=grid).resolved(environments(settings))
    largest_body = np.full(settings.shape, Cell.H_ACT, np.int8)
    worlds = [task_world(spec, largest_body)]

    for batch in settings.fitness.workloads(settings):
        count = batch.designs * batch.envs
        each = environment_bytes(spec, worlds, count, sim, ppo=batch.ppo)
        # Where not even one design fits, its environments are too many, else the designs are.
        if fitting(each * batch.envs, sim.device) < 1 or batch.designs == 1:
            things = f"({batch.key}) for each of {batch.designs} designs"
            ask(each * count / batch.value, batch.value, sim.device, batch.key, things)
        ask(each * batch.envs, batch.designs, sim.device, "batch", f"designs of {batch.envs:,} environments each")


@dataclasses.dataclass(frozen=True)
class SearchRun:
    """A running design search as seen by listeners.

    Attributes:
        folder: of the run.
        archive: designs and results so far.
        settings: with what their names stand for.
        total: evaluations that it may spend, those of finalists included, which come last.
        costs: about how many control steps a design takes, and a finalist; None: not known.
        workers: of Ray; 0: this process.
    """

    folder: Path
    archive: Archive
    settings: Codesign
    total: int
    finalists: int
    costs: tuple[float, float] | None
    workers: int
    resumed: bool


def run_codesign(
    plan: Plan,
    listeners: Sequence[Listener] = (),
    executor: Executor | None = None,
    finish: Callable[[Found], object] = lambda _: None,
) -> Found:
    """Run the design search of ``plan``, new or resumed, and return the result.

    Args:
        executor: where designs are evaluated; None: where the settings say.
        finish: called with the result when the search is done, before another process may write to its folder.

    Raises:
        WarpvoxError: an evaluation has failed, the search in the folder is another one, or nothing can be written; what
            was finished is kept.
        KeyboardInterrupt: interrupted; the state has been saved.
    """
    settings = plan.settings
    fitness = settings.fitness
    resumed = plan.place if plan.resumed else None
    with ExitStack() as opened:
        with own_torch(settings.torch_threads):
            # Where designs are evaluated
            if executor is None:
                executor = _make_executor(plan)
                opened.callback(executor.close)
            workers = cast(Any, executor).size if settings.executor == "ray" else 0

            # Settings that the archive stores: those of a resumed search must be equal.
            previous = {}
            if resumed is not None:
                with Archive.read(resumed / ARCHIVE) as archive:
                    previous = as_now(archive.settings, resumed)
            settings = dataclasses.replace(settings, batch=_batch_size(settings, workers, previous))
            written = dataclasses.replace(settings, task=task_name(settings.task))
            fixed = dataclasses.asdict(Codesign.of(vars(written)))  # without the keys of the command line
            for name in CHANGEABLE:
                fixed.pop(name, None)
            fixed = json.loads(json.dumps(fixed))  # as an archive has it
            if resumed is not None:
                _check_same(previous, fixed, resumed)

            # Folder: files are written from here on. `left`: an earlier attempt may have left these.
            left = (CONFIG, "log.txt", "training", "code", "designs", f"{ARCHIVE}.lock")
            folder = opened.enter_context(run_folder(resumed, written, "codesign", to_yaml(written), plan.place, left))
            if resumed is None:
                keep_start(plan.start, folder)
            keep_code(settings, folder)

            # Where results are stored
            path = folder / ARCHIVE
            archive = opened.enter_context(Archive.open(path) if resumed else Archive.create(path, fixed))
            config_of_design = functools.partial(_config_of_design, settings, written.task)
            policies = StoredPolicies(folder, settings.training.ppo, config_of_design)
            results = Results(folder, archive, written)

        # At the end the best designs are evaluated once more.
        search = plan.search
        total = settings.search.max_designs + fitness.finalists
        costs = fitness.cost(settings, get_task(settings.task))
        if fitness.finalists:
            search = Finalists(search, fitness.finalists)
            if costs is not None:
                costs = (costs[0], costs[1] / fitness.finalists)

        # Ask, evaluate, store, tell
        loop = Loop(
            search,
            executor,
            archive,
            seed=settings.seed,
            policies=policies,
            batch=settings.batch,
            reuse=settings.reuse,
            inherit=fitness.inherits(settings),
            listeners=[results, *listeners],
        )
        run = SearchRun(folder, archive, written, total, fitness.finalists, costs, workers, plan.resumed)
        opened.enter_context(ambient(settings.torch_threads))
        torch.manual_seed(settings.seed)  # of code of the user's
        summary = _run_to_end(run, loop, results, settings, listeners)
        found = Found(folder, written, summary)
        finish(found)
    return found


def _run_to_end(
    run: SearchRun, loop: Loop, results: Results, settings: Codesign, listeners: Sequence[Listener]
) -> dict[str, Any]:
    """Run the loop, evaluate the winner and write the summary; listeners are always notified of the end."""
    status = "failed"
    summary: dict[str, Any] = {}
    begun = []
    try:
        for listener in listeners:
            listener.begun(run)
            begun.append(listener)
        loop.run()
        # before the status is done: a search that is done is not resumed
        results.fresh = evaluate_winner(results, settings)
        status = "done"
    except KeyboardInterrupt:
        status = "interrupted"
        raise
    finally:
        try:
            # if the search failed because nothing can be written, that first error is the one to report
            with suppress(StorageError, RunError) if status == "failed" else nullcontext():
                summary = results.write(status)
        finally:
            for listener in begun:
                listener.ended(summary)
    return summary


def _check_same(previous: Mapping[str, Any], values: Mapping[str, Any], folder: Path) -> None:
    """Raise RunError if settings changed since the search in ``folder`` began, except for CHANGEABLE keys."""
    before = flat(previous)
    now = flat(values)
    for key in now | before:
        old = before.get(key)
        new = now.get(key)
        if old != new and key not in CHANGEABLE and not same_code(old, new):
            raise RunError(f"{folder} is a search with {key}={old}, asked for {key}={new}: give that another folder.")


def _batch_size(settings: Codesign, workers: int, previous: Mapping[str, Any]) -> int | None:
    """Return the number of designs evaluated together (key ``batch``); None: a whole generation.

    Args:
        workers: of Ray; 0: this process.
        previous: settings of a search that is resumed, which keeps its size; empty: it is new.
    """
    if settings.batch is not None or previous:
        return settings.batch or previous.get("batch")

    # A killed search repeats its last batch: at most 20 million control steps, about ten minutes of a core.
    size = settings.search.population
    cost = settings.fitness.cost(settings, get_task(settings.task))
    if cost is not None:
        size = min(size, max(1, int(20e6 / max(cost[0], 1))))

    # Small enough that every worker gets a batch
    if workers:
        size = min(size, math.ceil(settings.search.population / workers))
    return None if size == settings.search.population else size


def _config_of_design(settings: Codesign, task: str, candidate: Candidate, outcome: Outcome) -> str:
    """Return the ``config.yaml`` for a design's policy, as of a training, so that it can be played."""
    # Settings that a design's training shares with its search
    shared = (
        "rules", "seed", "device", "dtype", "arithmetic", "threads", "torch_threads", "output_dir", "protocol"
    )  # fmt: skip
    values = {name: getattr(settings, name) for name in shared}
    training = settings.training
    values |= {
        "task": task,
        "design": candidate.body,
        "num_envs": training.envs,
        "max_iterations": training.iterations,
        "eval_interval": training.eval_interval,
        "episodes": training.episodes,
        "physics": dataclasses.asdict(settings.physics),
        "ppo": dataclasses.asdict(training.ppo),
    }

    # Only evaluations of the user's own give voxel policies.
    voxels = (outcome.spec or {}).get("voxels")
    if voxels is not None:
        values |= {"policy": voxels["network"], "network": voxels["settings"], "obs": observed_by(outcome.spec)}
        if is_on_grid(voxels["layout"]):
            bodies = [candidate.body.tolist()]
            values["designs"] = {"bodies": bodies, "refresh": "none", "held_out": bodies}

    # Play it in simulations like those that gave its fitness.
    values |= settings.fitness.run_of(settings, candidate, outcome)
    values.setdefault("lanes", lanes_for(episodes_of(values["episodes"], settings.protocol)))
    return to_yaml(Training(**values)) + END


def _make_executor(plan: Plan) -> Executor:
    """Create the executor chosen in the settings: this process, or Ray workers."""
    settings = plan.settings
    if settings.executor == "local":
        # `alone` would deadlock code of the user's that waits for its own training threads.
        evaluator = _make_evaluator(settings, plan.known, plan.evaluator)
        return LocalExecutor(evaluator, alone=not isinstance(settings.fitness, Custom))
    from warpvox.algos.codesign.ray_executor import RayExecutor

    threads = settings.threads or 1
    settings = dataclasses.replace(settings, threads=threads)
    make = functools.partial(_make_evaluator_on_worker, settings, plan.known, plan.evaluator)
    return RayExecutor(make, settings.workers, settings.address, threads, gpus=0 if settings.device == "cpu" else None)


def _make_evaluator(settings: Codesign, known: Any, evaluator: DesignEvaluator | None) -> DesignEvaluator:
    """Return ``evaluator``, or create the evaluator of the settings."""
    start_warp()
    if evaluator is not None:
        return evaluator
    device = resolve_device(settings.device, environments(settings))
    return settings.fitness.build(dataclasses.replace(settings, device=device), known)


def _make_evaluator_on_worker(settings: Codesign, known: Any, evaluator: DesignEvaluator | None) -> DesignEvaluator:
    """Set torch's threads and seed in a worker process, and create the evaluator."""
    torch.set_num_threads(settings.torch_threads)
    torch.manual_seed(settings.seed)
    return _make_evaluator(settings, known, evaluator)
