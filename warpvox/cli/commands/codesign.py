"""``warpvox codesign``: from a configuration to a folder with the designs that were tried, the best of them trained."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from warpvox.algos.candidate import FINALIST, Candidate, Outcome
from warpvox.algos.codesign.archive import FILE as ARCHIVE, Archive
from warpvox.algos.codesign.archive_export import export
from warpvox.algos.search import make_search, settings_from
from warpvox.algos.settings import Ppo
from warpvox.algos.training.pretrained import observed_by
from warpvox.cli.application import run_command
from warpvox.cli.config import load, load_values, to_yaml
from warpvox.cli.costs import costs_of
from warpvox.cli.evaluations import (
    STEPS,
    check_evaluation,
    episodes_of,
    evaluator_of,
    has_common_policy,
    is_screened,
    keep_pretrained,
    read_pretrained,
    resolve_evaluation,
    screened_values,
    values_of_gait,
)
from warpvox.cli.fresh_seeds import evaluate_winner, fresh_text
from warpvox.cli.start import gaits_of, keep_start, read_start
from warpvox.code import is_code
from warpvox.configs.schema import CodesignConfig
from warpvox.errors import ConfigError, RunError, StorageError, listing
from warpvox.io.console import echo, shell_argument, shown
from warpvox.io.writing import check_writable
from warpvox.runs import (
    CONFIG,
    END,
    check_unchanged,
    find_codesign,
    find_searches,
    new_folder,
    read_summary,
    run_folder,
)
from warpvox.trust import STORED, again, as_stored, keep_code
from warpvox.types import Cell

if TYPE_CHECKING:
    from warpvox.algos.candidate import DesignEvaluator
    from warpvox.algos.codesign.executors import Executor
    from warpvox.algos.codesign.gaits import Gait

__all__ = ["Job", "check", "codesign", "environments", "make_evaluator", "run"]

CHANGEABLE = (
    "executor", "address", "workers", "device", "threads", "torch_threads", "top", "export", "name",
    "training.save_interval", "memory_check", "resume", "report", "output_dir",
)  # fmt: skip
"""Keys that do not change what is found: they may differ when a search is resumed.

But for rounding: another device, or other ``torch_threads`` with ``training.method=sequential`` (see ``train``).
"""

OF_DESIGNS = (
    "task", "rules", "seed", "device", "dtype", "arithmetic", "threads", "torch_threads", "output_dir", "policy",
    "network",
)  # fmt: skip
"""Keys that the configuration of a design has from that of its search."""


@dataclass
class Job:
    """One search to be made; of the one that it goes on with ``folder`` and configuration.

    ``place``: the folder of a new one, if it should not be named by date and time; it is there and empty.
    """

    config: CodesignConfig
    folder: Path | None = None
    stored: dict[str, Any] = field(default_factory=dict)
    place: Path | None = None


def run(words: list[str]) -> None:
    """Do what ``warpvox codesign`` is asked for; all runs of a sweep are checked before the first begins."""
    run_command("codesign", words, codesign, _prepare)


def _prepare(config: CodesignConfig, overrides: list[str], config_dir: Path | None) -> Job:
    """The job of a configuration; with ``resume`` on top of that of the search that it goes on with.

    Raises:
        ConfigError, RunError: what is wrong with it.
    """
    if config.report is not None:
        return Job(config)
    if config.resume is None:
        job = Job(config)
    else:
        source = find_codesign(config.resume, config.output_dir)
        check_writable(source.folder)
        config = load("codesign", overrides, config_dir, base=source.config, home=source.folder)
        check_unchanged(source.config, as_stored(config, source.config), CHANGEABLE)
        job = Job(dataclasses.replace(config, resume=None), source.folder, source.config)
    check(job.config, job.folder)
    return job


def check(config: CodesignConfig, folder: Path | None = None) -> None:
    """Find mistakes before anything is made; ``folder``: of the search that is resumed.

    Raises:
        WarpvoxError: a task, shape, setting, device or library that does not exist or does not go with the others.
    """
    from warpvox.algos.physics import physics_of
    from warpvox.devices.names import resolve_device
    from warpvox.envs.registry import get_task
    from warpvox.envs.worlds import task_world

    task_world(get_task(config.task), np.full(config.shape, 3, np.int8))
    start = [robot.body for robot in read_start(config, folder)]
    make_search(settings_from(config.search), tuple(config.shape), config.seed, start)
    physics_of(config)
    config.training.ppo.check(config.training.envs, "training.ppo")
    check_evaluation(config)
    config = resolve_evaluation(config, folder)
    if config.executor == "local":
        resolve_device(config.device)
        for key in ("address", "workers"):
            if getattr(config, key) is not None:
                raise ConfigError(f"{key} goes with executor=ray.")
        if config.memory_check:
            _ask_for_memory(config)


def _together(config: CodesignConfig) -> int:
    """Designs that are trained side by side, each with a policy of its own."""
    if config.training.method == "sequential":
        return 1
    most = config.finalists if is_screened(config) else config.search.population or 1
    return min(config.batch or most, most) if is_screened(config) else config.batch or most


def _batches(config: CodesignConfig) -> list[tuple[int, int, str, int, str, Ppo | None]]:
    """Batches: designs, environments of each, the key that counts these, its value, ``obs``, PPO."""
    training, how = config.training, config.screening
    obs = "task" if config.policy == "mlp" else "voxel"
    found = [(_together(config), training.envs, "training.envs", training.envs, obs, training.ppo)]
    if not is_screened(config):
        return found
    most = config.search.population or 1
    if has_common_policy(config):
        ppo = dataclasses.replace(training.ppo, **(how.ppo or {}))
        return [*found, (most, how.envs, "screening.envs", how.envs, "voxel", ppo)]
    first = [("screening.gaits", how.gaits), ("screening.beam", how.beam if how.passes else 1)]
    last = [("screening.final_gaits", how.gaits_of_finalist)]
    last += [("screening.final_beam", how.final_beam if how.final_passes else 1)]
    for designs, keys in ((most, first), (config.finalists, last)):
        key, value = max(keys, key=lambda one: one[1])
        together = min(config.batch or designs, designs)
        found.append((together, value * episodes_of(config.task), key, value, "task", None))
    return found


def environments(config: CodesignConfig) -> int:
    """Environments that are stepped together at most."""
    return max(designs * envs for designs, envs, *_ in _batches(config))


def _ask_for_memory(config: CodesignConfig) -> None:
    """Raise MemoryLimitError, with what fits, where a search would take too much with bodies that fill their grid."""
    from warpvox.algos.physics import sim_of
    from warpvox.envs.memory import ask, environment_bytes, fitting
    from warpvox.envs.registry import get_task
    from warpvox.envs.worlds import task_world

    spec = get_task(config.task).under(config.rules)
    sim = dataclasses.replace(sim_of(config), grid=None if config.dtype == "float64" else tuple(config.shape))
    sim = sim.resolved(environments(config))
    worlds = [task_world(spec, np.full(config.shape, Cell.H_ACT, np.int8))]
    for designs, envs, key, value, obs, ppo in _batches(config):
        each = environment_bytes(spec, worlds, designs * envs, sim, obs=obs, ppo=ppo)
        if fitting(each * envs, sim.device) < 1 or designs == 1:
            ask(each * designs * envs / value, value, sim.device, key, f"({key}) for each of {designs} designs")
        batch = "search.population" if key == "screening.envs" else "batch"
        ask(each * envs, designs, sim.device, batch, f"designs of {envs:,} environments each")


def resolve(config: CodesignConfig, folder: Path | None = None) -> CodesignConfig:
    """A copy with what its names stand for: settings, constants and, where it is this machine's, the device.

    Args:
        folder: of the search that is resumed.
    """
    from warpvox.algos.physics import physics_of
    from warpvox.devices.names import resolve_device

    constants = dataclasses.asdict(physics_of(config))
    preset = constants.pop("name")
    config = resolve_evaluation(config, folder)
    # designs on workers run on the devices of the workers
    device = resolve_device(config.device, environments(config)) if config.executor == "local" else config.device
    return dataclasses.replace(
        config,
        physics=type(config.physics)(preset=preset, **constants),
        search=type(config.search)(**_all_settings(dataclasses.asdict(config.search))),
        device=device,
    )


def _all_settings(search: dict[str, Any]) -> dict[str, Any]:
    """Values of ``search.*`` with the defaults of the algorithm's settings in place of null."""
    settings = dataclasses.asdict(settings_from(search))
    return search | {name: list(value) if isinstance(value, tuple) else value for name, value in settings.items()}


# ---------------------------------------------------------------------------------------------------- a search


def codesign(job: Job, console: Console) -> Path:
    """Make a search, or go on with one; returns its folder.

    Raises:
        WarpvoxError: something asked for is not valid, or an evaluation has failed; what was finished is kept.
        KeyboardInterrupt: interrupted; the state has been saved.
    """
    if job.config.report is not None:
        return write_again(job.config, console)
    with console.status("loading"):
        from warpvox.algos.codesign.finalists import Finalists
        from warpvox.algos.codesign.loop import Loop
        from warpvox.algos.codesign.stored_policies import StoredPolicies
        from warpvox.cli.codesign_progress import Results, SearchProgress
        from warpvox.cli.process import prepare
        from warpvox.envs.registry import get_task

        config = resolve(job.config, job.folder)
        prepare(config.torch_threads, config.seed)
        pretrained, start = read_pretrained(config, job.folder), read_start(config, job.folder)
        executor = make_executor(config, pretrained, gaits_of(start))
        config = dataclasses.replace(config, batch=_batch(config, executor))
        written = as_stored(config, job.stored)
    try:
        with (
            run_folder(job.folder or job.place, written, "codesign", to_yaml(written)) as folder,
            ExitStack() as opened,
        ):
            keep_pretrained(pretrained, folder)
            keep_start(start, folder)
            archive = opened.enter_context(_archive(folder, written))
            keep_code(config, folder, console)
            settings = settings_from(config.search)
            search = make_search(settings, tuple(config.shape), config.seed, [robot.body for robot in start])
            total = settings.max_evaluations
            finalists = config.finalists if is_screened(config) else 0
            cost, last = costs_of(config, get_task(config.task))
            if finalists:
                search, total, last = Finalists(search, finalists), total + finalists, last / finalists
            results = Results(folder, archive, written, (pretrained or {}).get(STEPS))
            watch = SearchProgress(results, total, console, (cost, last), finalists)
            loop = Loop(
                search,
                executor,
                archive,
                seed=config.seed,
                policies=StoredPolicies(folder, config.training.ppo, functools.partial(design_config, written)),
                checkpoints=folder / "training",
                batch=config.batch,
                reuse=config.reuse,
                inherit=config.training.inherit or config.evaluation == "gaits",
                listener=watch,
            )
            done = f", {archive.trained()} of {total} designs done" if job.folder else ""
            echo(console, f"{results.search} on {config.task}, {_where(config, executor)}{done}")
            echo(console, f"run folder: {shown(folder)}")
            lost = [record for record in archive.records() if record.policy and not (folder / record.policy).is_file()]
            if lost:
                echo(console, f"the policies of {len(lost)} designs are gone from {shown(folder / 'designs')}")
            if job.folder and archive.trained() >= total:
                echo(
                    console,
                    f"the search has spent its {settings.max_evaluations} evaluations: nothing is left to do. What it"
                    " proposes depends on them, so that more make another search (search.max_evaluations=N)",
                )
            _search(loop, watch, config, console)
    finally:
        executor.close()
    return folder


def _search(loop: Any, watch: Any, config: CodesignConfig, console: Console) -> None:
    """Run the loop with a live display, and sum up however it ends."""
    try:
        with watch:
            loop.run()
    except KeyboardInterrupt:
        conclude(console, watch.results.write("interrupted"), watch.results.folder, config, watch.under_way)
        raise
    except BaseException:
        # a search that has failed may have failed because nothing can be written; that is the error to report
        with suppress(StorageError, RunError):
            conclude(console, watch.results.write("failed"), watch.results.folder, config)
        raise
    summary = watch.results.write("done")
    if summary["best_design"] is not None:
        watch.results.fresh = evaluate_winner(watch.results.folder, config)
        summary = watch.results.write("done")
    write_exports(watch.archive, watch.results.folder, config.export, console)
    conclude(console, summary, watch.results.folder, config)


def _archive(folder: Path, config: CodesignConfig) -> Archive:
    """The archive in ``folder``, made if there is none.

    Raises:
        RunError: it was made with other settings.
    """
    settings = {name: value for name, value in dataclasses.asdict(config).items() if name not in CHANGEABLE}
    settings["training"].pop("save_interval")
    settings.pop("preset")  # a name for values that are here themselves
    settings = json.loads(json.dumps(settings))
    path = folder / ARCHIVE
    if not path.is_file():
        return Archive.create(path, settings)
    archive = Archive.open(path)
    known = archive.settings
    if known != settings:
        archive.close()
        other = next(name for name in {**settings, **known} if known.get(name) != settings.get(name))
        raise RunError(f"{path} was made with another value of '{other}' than {folder / CONFIG} has.")
    return archive


def design_config(config: CodesignConfig, candidate: Candidate, outcome: Outcome) -> str:
    """The text of ``config.yaml`` beside the policy of a design: that of a training which ``warpvox play`` can show."""
    from warpvox.algos.policies.registry import MLP
    from warpvox.batch.options import lanes_for

    training = config.training
    values = {name: getattr(config, name) for name in OF_DESIGNS} | {
        "design": candidate.body.tolist(),
        "num_envs": training.envs,
        "max_iterations": training.iterations,
        "eval_interval": training.eval_interval,
        "eval_envs": training.eval_envs,
        "lanes": lanes_for(training.eval_envs),  # as in the evaluation that found the fitness
        "physics": dataclasses.asdict(config.physics),
        "ppo": dataclasses.asdict(training.ppo),
    }
    if has_common_policy(config) and candidate.origin != FINALIST:
        values |= screened_values(config, candidate)
    values["obs"] = "task" if values["policy"] == MLP else observed_by(outcome.spec)
    if outcome.spec and outcome.spec.get("gait"):
        values |= values_of_gait(config, candidate)
    design = values.pop("design")
    return to_yaml(dataclasses.replace(_training_of(json.dumps(values)), design=design)) + END


@functools.lru_cache(maxsize=4)
def _training_of(values: str) -> Any:
    """The configuration of a training with these values, as JSON; to be checked once for many designs."""
    return load_values("train", json.loads(values))


# -------------------------------------------------------------------------------------------------- evaluation


def make_evaluator(
    config: CodesignConfig, pretrained: dict[str, Any] | None = None, gaits: Mapping[bytes, Gait] | None = None
) -> DesignEvaluator:
    """The evaluator of a configuration; called in the process that evaluates.

    Args:
        pretrained: of :func:`warpvox.cli.evaluations.read_pretrained`.
        gaits: of :func:`warpvox.cli.start.gaits_of`.
    """
    from warpvox.cli.process import prepare
    from warpvox.devices.names import resolve_device

    prepare(config.torch_threads, config.seed)
    device = resolve_device(config.device, environments(config))
    return evaluator_of(dataclasses.replace(config, device=device), pretrained, gaits or {})


def make_executor(
    config: CodesignConfig, pretrained: dict[str, Any] | None = None, gaits: Mapping[bytes, Gait] | None = None
) -> Executor:
    """Where designs are trained, by the configuration.

    Raises:
        ConfigError, RunError: Ray is missing or cannot be reached.
    """
    if config.executor == "local":
        from warpvox.algos.codesign.executors import LocalExecutor

        return LocalExecutor(make_evaluator(config, pretrained, gaits))
    from warpvox.algos.codesign.ray_executor import RayExecutor

    threads = config.threads or 1
    make = functools.partial(make_evaluator, dataclasses.replace(config, threads=threads), pretrained, gaits)
    return RayExecutor(make, config.workers, config.address, threads, gpus=0 if config.device == "cpu" else None)


def _batch(config: CodesignConfig, executor: Executor) -> int | None:
    """How many designs are trained together; see the key ``batch``."""
    if config.batch is not None:
        return config.batch
    if config.training.method == "sequential" and not is_screened(config):
        return 1
    return -(-config.search.population // executor.size) if config.executor == "ray" else None


def _where(config: CodesignConfig, executor: Executor) -> str:
    if config.executor == "local":
        return f"rules {config.rules}, on {config.device}"
    return f"rules {config.rules}, on {executor.size} workers of Ray"


# ------------------------------------------------------------------------------------------------------- after


def write_exports(archive: Archive, folder: Path, formats: list[str], console: Console) -> None:
    """Write the archive in other formats and say where."""
    for name in dict.fromkeys(formats):
        echo(console, shown(export(archive, folder, name)))


def write_again(config: CodesignConfig, console: Console) -> Path:
    """Make report, pictures and exports of a search again, also while it is running; returns its folder.

    Raises:
        RunError: no such search.
    """
    from warpvox.cli.codesign_progress import Results

    texts = [str(text) for text in (config.report if isinstance(config.report, list) else [config.report])]
    if texts != ["latest"]:
        searches = find_searches(texts, config.output_dir)
        if len(texts) > 1 or searches not in ([], [Path(texts[0]).expanduser()]):
            return compare(config, texts, searches, console)
    source = find_codesign(texts[0], config.output_dir)
    stored = load_values("codesign", source.config)
    with Archive.read(source.folder / ARCHIVE) as archive:
        results = Results(source.folder, archive, dataclasses.replace(stored, top=config.top))
        for row in archive.generations():
            results.draw(row["generation"])
        echo(console, shown(results.report(read_summary(source.folder) or {"status": "running"})))
        write_exports(archive, source.folder, config.export, console)
    return source.folder


def compare(config: CodesignConfig, texts: list[str], searches: list[Path], console: Console) -> Path:
    """Write one report of several searches: into the folder that they lie in, if one was named, or a new one."""
    from warpvox.algos.report.benchmark import write_benchmark

    if not searches:
        raise RunError(f"There is no design search at {listing(texts)}: expected latest, folders or a pattern of some.")
    home = Path(texts[0]).expanduser()
    if len(texts) == 1 and home.is_dir():
        page = write_benchmark(home, searches)
    else:
        with new_folder(config.output_dir, "report", "several", config.name, to_yaml(config)) as folder:
            page = write_benchmark(folder, searches)
    echo(console, f"report of {len(searches)} design searches: {page.resolve().as_uri()}")
    return page.parent


def conclude(
    console: Console, summary: dict[str, Any], folder: Path, config: CodesignConfig, under_way: str = ""
) -> None:
    """Say how the search has ended and what one can do next."""
    from warpvox.algos.report import FILE as REPORT

    words = {"done": "done", "interrupted": "interrupted, state saved", "failed": "failed"}[summary["status"]]
    text = f"{words} after {summary['evaluations']} designs and {summary['steps']:,} control steps{under_way}"
    if summary["best_design"] is not None:
        text += f"; best fitness {summary['best_fitness']:.3f} (design {summary['best_design']})"
    echo(console, text)
    if summary.get("fresh_seeds"):
        echo(console, f"the best on fresh seeds: {fresh_text(summary['fresh_seeds'])}")
    if summary["best_design"] is not None:
        echo(console, f"report: {(folder / REPORT).resolve().as_uri()}")
        task = f" task={STORED}" if is_code(config.task) else ""
        echo(console, f"look at the best: warpvox play {shell_argument('run', folder)}{task}")
    if summary["status"] != "done":
        echo(console, f"go on: warpvox codesign {shell_argument('resume', folder)}{again(config)}")
