"""A design search from its settings: everything is checked, then the loop runs with its archive in a folder."""

import dataclasses
import functools
import json
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from warpvox.algos.archive import FILE as ARCHIVE, Archive
from warpvox.algos.candidate import Candidate, DesignEvaluator, Outcome, Search
from warpvox.algos.codesign.evaluations.custom import Custom
from warpvox.algos.codesign.evaluations.workload import full_body
from warpvox.algos.codesign.finalists import Finalists
from warpvox.algos.codesign.listener import Listener, SearchRun
from warpvox.algos.codesign.loop import Executor, LocalExecutor, Loop
from warpvox.algos.codesign.results import Found, Results, evaluate_winner
from warpvox.algos.codesign.robots import keep_start, read_start
from warpvox.algos.codesign.settings import CHANGEABLE, Codesign
from warpvox.algos.codesign.stored_policies import StoredPolicies
from warpvox.algos.metrics import check_logger
from warpvox.algos.protocols import episodes_of
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
from warpvox.runs import CONFIG, END, keep_code, run_folder, search_as_now

OF_DESIGNS = (
    "task", "rules", "seed", "device", "dtype", "arithmetic", "threads", "torch_threads", "output_dir",
)  # fmt: skip
"""Settings that the training of a design has from its search."""
MAX_BATCH_STEPS = 20e6
"""Control steps of a batch by default: about ten minutes of a core."""
BEFORE = (CONFIG, "log.txt", "training", "code", "designs", f"{ARCHIVE}.lock")
"""Files and folders that a search has before its archive."""


def check(settings: Codesign, folder: Path | None = None, search: Search | None = None) -> Codesign:
    """Find mistakes before anything is made; a ``search`` that is given gets the bodies to start with.

    Returns:
        A copy with what its names stand for: settings, constants and, where it is this machine's, the device.
    """
    check_logger(settings.logger)
    task_world(get_task(settings.task), np.full(settings.shape, 3, np.int8))
    start = [robot.body for robot in read_start(settings, folder)]
    if search is None:
        search = make_search(settings.search, cast(Any, tuple(settings.shape)), settings.seed, start)
        if isinstance(search, BaseSearch):
            search.ask()  # of some shapes hardly any random body holds together
    else:
        start_with(search, start)
    sim_of(settings)  # constants out of range are found
    settings.evaluation.check(settings)
    settings = settings.resolved(folder)
    if settings.executor == "local":
        resolve_device(settings.device)
        for key in ("address", "workers"):
            if getattr(settings, key) is not None:
                raise ConfigError(f"{key} goes with executor=ray.")
        if settings.memory_check:
            _ask_for_memory(settings)
        settings = dataclasses.replace(settings, device=resolve_device(settings.device, environments(settings)))
    return settings  # designs on workers run on the devices of the workers


def environments(settings: Codesign) -> int:
    """Environments that are stepped together at most; 1: not known."""
    return max((batch.designs * batch.envs for batch in settings.evaluation.workloads(settings)), default=1)


def _ask_for_memory(settings: Codesign) -> None:
    """Raise MemoryLimitError, with what fits, where a search would take too much with bodies that fill their grid."""
    spec = get_task(settings.task).under(settings.rules)
    grid = None if settings.dtype == "float64" else tuple(settings.shape)
    sim = dataclasses.replace(sim_of(settings), grid=grid).resolved(environments(settings))
    worlds = [task_world(spec, full_body(settings.shape))]
    for batch in settings.evaluation.workloads(settings):
        designs, envs, value = batch.designs, batch.envs, batch.value
        each = environment_bytes(spec, worlds, designs * envs, sim, ppo=batch.ppo)
        if fitting(each * envs, sim.device) < 1 or designs == 1:
            what = f"({batch.key}) for each of {designs} designs"
            ask(each * designs * envs / value, value, sim.device, batch.key, what)
        ask(each * envs, designs, sim.device, "batch", f"designs of {envs:,} environments each")


def run_codesign(
    settings: Codesign,
    place: Path | None = None,
    listeners: Sequence[Listener] = (),
    *,
    search: Search | None = None,
    executor: Executor | None = None,
) -> Found:
    """Make a search, or go on with one. Nothing is written before everything has been checked.

    Args:
        place: its folder; a search that is there is gone on with. None: a new one in ``output_dir``, named by the time.
        search: proposes designs; None: the one that the settings name.
        executor: evaluates them; None: the one that the settings name.

    Raises:
        WarpvoxError: something asked for is not valid, an evaluation has failed, or nothing can be written; what was
            finished is kept.
        KeyboardInterrupt: interrupted; the state has been saved.
    """
    resumed = place if place is not None and (place / ARCHIVE).is_file() else None
    with ExitStack() as opened:
        with own_torch(settings.torch_threads):
            settings = check(settings, resumed, search)
            start = read_start(settings, resumed)
            known = settings.evaluation.begins_with(settings, start, resumed)
            if executor is None:
                executor = make_executor(settings, known)
                opened.callback(executor.close)
            with Archive.read(resumed / ARCHIVE) if resumed else nullcontext() as archive:
                known_settings = search_as_now(archive.settings, resumed) if archive else {}
            settings = dataclasses.replace(settings, batch=_batch(settings, executor, known_settings))
            written = dataclasses.replace(settings, task=task_name(settings.task))
            plain = dataclasses.asdict(Codesign.of(vars(written)))  # without the keys of the command line
            kept = {name: value for name, value in plain.items() if name not in CHANGEABLE}
            kept = json.loads(json.dumps(kept))  # as an archive has it
            if resumed:
                _check_same(known_settings, kept, resumed)
            folder = opened.enter_context(run_folder(resumed, written, "codesign", to_yaml(written), place, BEFORE))
            if not resumed:
                keep_start(start, folder)
            keep_code(settings, folder)
            if search is None:
                bodies = [robot.body for robot in start]
                search = make_search(settings.search, cast(Any, tuple(settings.shape)), settings.seed, bodies)
            path = folder / ARCHIVE
            archive = opened.enter_context(Archive.open(path) if resumed else Archive.create(path, kept))
            results = Results(folder, archive, written)
        run, loop = _loop(settings, search, executor, results, listeners, resumed is not None)
        opened.enter_context(ambient(settings.torch_threads))
        torch.manual_seed(settings.seed)  # of code of the user's
        summary = _search(run, loop, results, settings, listeners)
    return Found(folder, written, summary)


def _loop(
    settings: Codesign, search: Search, executor: Executor, results: Results, heard: Sequence[Listener], resumed: bool
) -> tuple[SearchRun, Loop]:
    """The loop, and what listeners see of it."""
    how, folder = settings.evaluation, results.folder
    total, finalists = settings.search.max_evaluations, how.finalists
    cost = how.cost(settings, get_task(settings.task))
    if finalists:
        search, total = Finalists(search, finalists), total + finalists
        cost = cost and (cost[0], cost[1] / finalists)
    run_of_design = functools.partial(_run_of_design, settings, results.settings.task)
    loop = Loop(
        search,
        executor,
        results.archive,
        seed=settings.seed,
        policies=StoredPolicies(folder, settings.training.ppo, run_of_design),
        batch=settings.batch,
        reuse=settings.reuse,
        inherit=how.inherits(settings),
        listeners=[results, *heard],
    )
    workers = cast(Any, executor).size if settings.executor == "ray" else 0
    return SearchRun(folder, results.archive, results.settings, total, finalists, cost, workers, resumed), loop


def _search(
    run: SearchRun, loop: Loop, results: Results, settings: Codesign, listeners: Sequence[Listener]
) -> dict[str, Any]:
    """Run the loop, and sum up however it ends; who has heard its beginning hears its end."""
    status, summary, begun = "failed", {}, []
    try:
        for listener in listeners:
            listener.begun(run)
            begun.append(listener)
        loop.run()
        # before it is done: what goes on with a search leaves alone those that are
        results.fresh = evaluate_winner(results, settings)
        status = "done"
    except KeyboardInterrupt:
        status = "interrupted"
        raise
    finally:
        try:
            # a search that has failed may have failed because nothing can be written; that is the error to report
            with suppress(StorageError, RunError) if status == "failed" else nullcontext():
                summary = results.write(status)
        finally:
            for listener in begun:
                listener.ended(summary)
    return summary


def _check_same(known: Mapping[str, Any], values: Mapping[str, Any], folder: Path) -> None:
    """Raise RunError unless the search in ``folder``, which has the settings ``known``, has these values."""
    before, now = flat(known), flat(values)
    for key in now | before:
        old, new = before.get(key), now.get(key)
        if old != new and key not in CHANGEABLE and not same_code(old, new):
            raise RunError(f"{folder} is a search with {key}={old}, asked for {key}={new}: give that another folder.")


def _batch(settings: Codesign, executor: Executor, known: Mapping[str, Any]) -> int | None:
    """How many designs are evaluated together, see the key ``batch``; None: a whole generation.

    Args:
        known: settings of a search that is resumed, which keeps its size; empty: it is new.
    """
    if settings.batch is not None or known:
        return settings.batch or known.get("batch")

    # A killed search repeats what its last batch has taken.
    size = settings.search.population
    cost = settings.evaluation.cost(settings, get_task(settings.task))
    if cost is not None:
        size = min(size, max(1, int(MAX_BATCH_STEPS / max(cost[0], 1))))

    # All workers have something to do.
    if settings.executor == "ray":
        size = min(size, math.ceil(settings.search.population / cast(Any, executor).size))
    return None if size == settings.search.population else size


def _run_of_design(settings: Codesign, task: str, candidate: Candidate, outcome: Outcome) -> str:
    """The text of ``config.yaml`` beside the policy of a design: that of a training which ``warpvox play`` can show."""
    training = settings.training
    values = {name: getattr(settings, name) for name in OF_DESIGNS} | {
        "task": task,
        "num_envs": training.envs,
        "max_iterations": training.iterations,
        **{name: getattr(training, name) for name in ("eval_interval", "eval_envs")},
        "fitness": settings.fitness,
        "physics": dataclasses.asdict(settings.physics),
        "ppo": dataclasses.asdict(training.ppo),
    }
    voxels = (outcome.spec or {}).get("voxels")
    if voxels is not None:  # of an evaluation of the user's own
        values |= {"policy": voxels["network"], "network": voxels["settings"], "obs": observed_by(outcome.spec)}
        if is_on_grid(voxels["layout"]):
            bodies = [candidate.body.tolist()]
            values["designs"] = {"bodies": bodies, "refresh": "none", "held_out": bodies}
    values |= settings.evaluation.run_of(settings, candidate, outcome)
    # as where the fitness was found
    values.setdefault("lanes", lanes_for(episodes_of(values["eval_envs"], settings.fitness)))
    return to_yaml(Training(design=candidate.body, **values)) + END


def make_evaluator(settings: Codesign, known: Any) -> DesignEvaluator:
    """The evaluator of resolved settings; called in the process that evaluates."""
    start_warp()
    device = resolve_device(settings.device, environments(settings))
    return settings.evaluation.build(dataclasses.replace(settings, device=device), known)


def _on_worker(settings: Codesign, known: Any) -> DesignEvaluator:
    """The evaluator of a process that does nothing else."""
    torch.set_num_threads(settings.torch_threads)
    torch.manual_seed(settings.seed)
    return make_evaluator(settings, known)


def make_executor(settings: Codesign, known: Any) -> Executor:
    """Where designs are evaluated, by the settings."""
    if settings.executor == "local":
        # code of the user's may wait for threads of its own, in which it trains
        return LocalExecutor(make_evaluator(settings, known), alone=not isinstance(settings.evaluation, Custom))
    from warpvox.algos.codesign.ray_executor import RayExecutor

    threads = settings.threads or 1
    make = functools.partial(_on_worker, dataclasses.replace(settings, threads=threads), known)
    return RayExecutor(make, settings.workers, settings.address, threads, gpus=0 if settings.device == "cpu" else None)
