"""``warpvox train``: from a configuration to a run folder with a trained policy."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from warpvox.algos.training.metrics import check_logger
from warpvox.cli.application import prepared, run_command
from warpvox.cli.config import load, to_yaml
from warpvox.cli.console import echo, shell_argument, shown
from warpvox.cli.help import flat_values
from warpvox.cli.pretrained import adopted
from warpvox.cli.runs import (
    STATE,
    TRAINING,
    Run,
    find_run,
    read_summary,
    run_folder,
    write_summary,
)
from warpvox.cli.trust import again, as_stored, keep_code
from warpvox.configs.schema import DesignsConfig, TrainConfig
from warpvox.devices.out_of_memory import enough_memory
from warpvox.errors import ConfigError, RunError, StorageError, listing
from warpvox.io.writing import check_writable
from warpvox.system import usable_cores

if TYPE_CHECKING:
    from warpvox.algos.training.distributed import ProcessGroup

__all__ = ["Job", "check_unchanged", "make_job", "run", "train"]

CHANGEABLE = (
    "max_iterations", "eval_interval", "eval_envs", "stop_return", "save_interval", "device", "threads",
    "torch_threads", "cuda_graph", "logger", "nan_guard", "memory_check", "resume", "output_dir",
)  # fmt: skip
"""Keys that may differ when a run is resumed: they do not change what is learned.

But for rounding: another device, or other ``torch_threads``, adds up the products of matrices in another order.
"""


@dataclass
class Job:
    """One run to be made: a configuration, and what it resumes, with the configuration that this has.

    ``learned``: the checkpoint of a pretrained policy that a new run begins with.
    """

    config: TrainConfig
    folder: Path | None = None
    checkpoint: Path | None = None
    stored: dict[str, Any] = field(default_factory=dict)
    learned: dict[str, Any] | None = None


def run(words: list[str]) -> None:
    """Do what ``warpvox train`` is asked for."""
    run_command("train", words, train, _prepare, _check)


def _check(job: Job) -> None:
    from warpvox.cli.build import prepare, resolve

    prepare(job.config.torch_threads, job.config.seed)
    resolve(job.config)


def make_job(overrides: list[str]) -> Job:
    """A run from its overrides; see :func:`_prepare`."""
    return prepared("train", overrides, None, _prepare)


def _prepare(config: TrainConfig, overrides: list[str], config_dir: Path | None) -> Job:
    """The job of a configuration; with ``resume`` on top of the configuration of the run that it goes on with.

    Raises:
        ConfigError, RunError: what is wrong with it.
    """
    check_logger(config.logger)
    if config.resume is None:
        named = {word.partition("=")[0] for word in overrides}
        config = _of_design(config, named)
        config, learned = (config, None) if config.pretrained is None else adopted(config, named)
        return Job(config, learned=learned)
    source = find_run(config.resume, config.output_dir, TRAINING, resume=True)
    check_writable(source.folder)
    stored = _known(source.config)
    config = load("train", overrides, config_dir, base=stored, home=source.folder)
    check_unchanged(stored, as_stored(config, stored), CHANGEABLE)
    checkpoint = source.checkpoint or source.folder / STATE
    if not checkpoint.is_file():
        raise RunError(
            f"The run {source.folder} cannot be resumed: it has no {STATE}. If it was stopped before its first"
            " iteration, start it again."
        )
    _check_readable(source, checkpoint)
    return Job(dataclasses.replace(config, resume=None), source.folder, checkpoint, stored)


def _of_design(config: TrainConfig, named: Collection[str]) -> TrainConfig:
    """Without the bodies of a preset where the user names one: ``design`` or ``designs``, not both.

    Raises:
        ConfigError: both are named.
    """
    if "design" not in named or config.designs.bodies is None:
        return config
    if any(key.startswith("designs") for key in named):
        raise ConfigError("design is one body, designs are many for one policy: give one of the two.")
    return dataclasses.replace(config, designs=DesignsConfig())


def _check_readable(source: Run, checkpoint: Path) -> None:
    """Raise RunError, with the newest checkpoint that will do instead, if one is damaged."""
    from warpvox.algos.checkpoints.files import load_checkpoint

    try:
        load_checkpoint(checkpoint)
    except RunError as error:
        for number in reversed(source.iterations):
            other = source.folder / f"model_{number}.pt"
            if other != checkpoint and _is_readable(other):
                raise RunError(
                    f"{str(error).rstrip('.')}. The newest checkpoint that can be read is that of iteration {number};"
                    f" go on from there, with new episodes: warpvox train {shell_argument('resume', other)}"
                ) from None
        raise RunError(f"{str(error).rstrip('.')}, and there is no other checkpoint: start the run again.") from None


def _is_readable(checkpoint: Path) -> bool:
    from warpvox.algos.checkpoints.files import load_checkpoint

    try:
        load_checkpoint(checkpoint)
    except RunError:
        return False
    return True


def check_unchanged(before: dict[str, Any], config: Any, changeable: Sequence[str]) -> None:
    """Raise ConfigError if a resumed run is asked for something that would make it another one."""
    old, new = flat_values(before), flat_values(dataclasses.asdict(config))
    changed = [key for key, value in new.items() if key in old and old[key] != value and key not in changeable]
    if changed:
        key = changed[0]
        raise ConfigError(
            f"{key} cannot change when a run is resumed (it has {old[key]}, asked for {new[key]});"
            f" what can: {listing(changeable[:-2])}."
        )


def _known(config: dict[str, Any]) -> dict[str, Any]:
    """Without the keys that training does not have (a demo is trained like any other run)."""
    names = {item.name for item in dataclasses.fields(TrainConfig)}
    return {name: value for name, value in config.items() if name in names}


def _ask_for_memory(config: TrainConfig, designs: Sequence[Any], grid: tuple[int, int] | None) -> None:
    """Raise MemoryLimitError, with the number of environments that fits, if a training does not.

    Args:
        config: resolved.
        designs: one for each block of environments; of many bodies one for each environment.
        grid: of many bodies, whose number does not restrict that of environments.
    """
    from warpvox.cli.build import sim_of
    from warpvox.envs.memory import ask, environment_bytes
    from warpvox.envs.registry import get_task
    from warpvox.envs.worlds import task_world

    spec = get_task(config.task).under(config.rules)
    worlds = [task_world(spec, design) for design in (designs if grid is None else designs[:1])]
    sim = dataclasses.replace(sim_of(config), grid=grid).resolved(config.num_envs)
    each = environment_bytes(spec, worlds, config.num_envs, sim, obs=config.obs, ppo=config.ppo)
    ask(each, config.num_envs, config.device, step=len(worlds))


def train(job: Job, console: Console, command: str = "train") -> Path:
    """Make a run; returns its folder. Nothing is written before everything has been checked.

    Raises:
        WarpvoxError: something asked for does not exist or is not valid, or learning has diverged.
        KeyboardInterrupt: interrupted; the state has been saved.
    """
    with console.status("loading"):
        from warpvox.algos.evaluate import evaluator
        from warpvox.algos.training.ascent import AscentRunner
        from warpvox.algos.training.distributed import join_process_group
        from warpvox.algos.training.runner import Runner, Schedule, adapt
        from warpvox.cli.build import load_bodies, make_env, prepare, resolve, training_lanes, voxels_of
        from warpvox.cli.designs import HeldOut, bodies_of, grid_of, held_out_of, is_many, judged_by_its_own, trained_on
        from warpvox.envs.dumps import DivergenceDump

        group = join_process_group(job.config.device)
        console.quiet = console.quiet or not group.is_main_process
        prepare(job.config.torch_threads, group.seed(job.config.seed))
        config = resolve(share(job.config, group))
        many = is_many(config)
        bodies = bodies_of(config, group.seed(config.seed)) if many else None
        designs = bodies.first(config.num_envs) if many else load_bodies(config.design, config.seed)
        if config.memory_check:
            _ask_for_memory(config, designs, grid_of(config) if many else None)
    advice = f"Train with fewer environments: num_envs={max(1, config.num_envs // 2)} instead of {config.num_envs}."
    preparing = console.status("preparing the simulation (the first time on a machine its kernels are compiled)")
    with preparing, enough_memory(advice):
        schedule = Schedule(config.max_iterations, config.save_interval, config.eval_interval, config.stop_return)
        room = {"designs": designs, "grid": grid_of(config)} if many else {}
        ascends = getattr(config, "method", "ppo") == "gradients"  # a demo has no such key
        options = {"auto_reset": True, "seed": group.seed(config.seed), "cuda_graph": config.cuda_graph} | room
        if ascends:
            options["layout"] = "lanes"
        env = adapt(make_env(config, config.num_envs, **options), config.ppo)
        judge = None
        if group.is_main_process:
            # on a GPU a few environments would take the launches of ten iterations, one after another
            lanes = config.lanes if many and config.device == "cpu" else training_lanes(config, config.device)
            if many:
                room["designs"] = designs = held_out_of(config)
            options = {"auto_reset": False, "device": "cpu", "lanes": lanes} | room
            made = make_env(config, config.eval_envs * len(designs), **options)
            judge = evaluator(made, config.seed)  # the same episodes every time, also after a resumption
            name = "bodies" if many and judged_by_its_own(config) else "held_out"
            judge = HeldOut(judge, designs, name, config.task) if many else judge
        parts = {"voxels": voxels_of(config, env.env), "bodies": bodies, "trained_on": trained_on(config)}
        parts |= {"evaluator": judge, "group": group, "logger": config.logger}
        runner = (AscentRunner if ascends else Runner)(env, config.ppo, schedule, **parts)
        if job.checkpoint is not None:
            runner.resume(job.checkpoint)
            _check_left(job.folder, runner)
        elif job.learned is not None:
            runner.begin_with(job.learned)
    if group.size > 1:
        config = dataclasses.replace(config, num_envs=job.config.num_envs, device=config.device.split(":")[0])
    with _folder(job, config, command, group) as folder:
        runner.folder = folder
        if many and group.is_main_process:
            judge.folder = folder
        if config.nan_guard == "dump":
            dumps = "dumps" if group.is_main_process else f"dumps_{group.rank}"
            env.env.dump = DivergenceDump(env.env, folder / dumps)
        _announce(console, as_stored(config, job.stored), runner, folder)
        if group.is_main_process:
            keep_code(config, folder, console)
        _learn(runner, console, folder, command, config)
    return folder


def _check_left(folder: Path, runner: Any) -> None:
    """Raise RunError, with what to type instead, if a resumed run has nothing left to do.

    One that was killed between its last iteration and its summary is let through: the summary is left.
    """
    done, total, goal = runner.current_learning_iteration, runner.schedule.total, runner.schedule.stop_return
    again = f"go on with: warpvox train {shell_argument('resume', folder)}"
    ended = read_summary(folder).get("status") == "done"  # a run that was killed in its last moment has no summary
    if done > total or (ended and done == total):
        raise RunError(
            f"The run has already made {done} iterations, and max_iterations={total} asks for no more;"
            f" {again} max_iterations={2 * done}"
        )
    if ended and goal is not None and runner.last_return >= goal:
        raise RunError(
            f"The run has ended because an evaluation ({runner.last_return:.3f}) has already reached"
            f" stop_return={goal:g}; {again} stop_return=null"
        )


def share(config: TrainConfig, group: ProcessGroup) -> TrainConfig:
    """What a process of a group has to do of a training: its share of the environments, its own device and threads.

    Raises:
        ConfigError: the environments cannot be shared out evenly.
    """
    if group.size == 1:
        return config
    if config.num_envs % group.size:
        raise ConfigError(f"num_envs={config.num_envs} cannot be shared out evenly to {group.size} processes.")
    threads = config.threads or max(1, usable_cores() // group.local_size)
    return dataclasses.replace(config, num_envs=config.num_envs // group.size, device=group.device, threads=threads)


@contextmanager
def _folder(job: Job, config: TrainConfig, command: str, group: ProcessGroup) -> Iterator[Path]:
    """The folder of a new run, or that of the one which is resumed; made by the first process."""
    if not group.is_main_process:
        yield Path(group.broadcast(None))
    else:
        with run_folder(job.folder, config, command, to_yaml(as_stored(config, job.stored))) as folder:
            group.broadcast(str(folder))
            yield folder


def _announce(console: Console, config: TrainConfig, runner: Any, folder: Path) -> None:
    done = runner.current_learning_iteration
    verb = f"resuming after iteration {done}" if done else "training"
    where = config.device if runner.group.size == 1 else f"{runner.group.size} processes, {config.device}"
    text = f"{verb}: {config.task}, {config.num_envs} environments on {where}, rules {config.rules}"
    if runner.bodies is not None and runner.group.is_main_process:
        text += f"\nevaluated on {runner.evaluator.about}"
    pretrained = getattr(config, "pretrained", None)  # a demo has no such key
    if pretrained is not None and not done:
        text += f"\nbeginning with the policy {shown(Path(pretrained))}"
    echo(console, f"{text}\nrun folder: {shown(folder)}")
    if done and done == runner.schedule.total:
        more = f"max_iterations={2 * done}"
        echo(
            console,
            f"all {done} iterations are made, only the summary was missing; for more of them resume with {more}",
        )


def _learn(runner: Any, console: Console, folder: Path, command: str, config: TrainConfig) -> None:
    """Learn with a live line, and sum up however it ends."""
    from warpvox.cli.progress import TrainingProgress

    began, status = time.perf_counter(), "failed"
    started_at = runner.steps
    progress = TrainingProgress(runner.schedule.total, runner.current_learning_iteration, console)
    runner.report = progress
    try:
        with progress:
            if runner.current_learning_iteration < runner.schedule.total:
                runner.run()
        status = "done"
    except KeyboardInterrupt:
        status = "interrupted"
        raise
    finally:
        seconds = time.perf_counter() - began
        if runner.current_learning_iteration and runner.group.is_main_process:
            summary = {
                "command": command,
                "task": runner.env.cfg["task"],
                "status": status,
                "seed": config.seed,
                **_bodies(config, runner),
            }
            summary |= runner.summary()
            summary["steps_per_second"] = round((runner.steps - started_at) / seconds, 1)
            # a run that has failed may have failed because nothing can be written; that is the error to report
            with suppress(StorageError) if status == "failed" else nullcontext():
                write_summary(folder, summary)
            _conclude(console, runner, summary, seconds, folder, again(config))


def _bodies(config: TrainConfig, runner: Any) -> dict[str, Any]:
    """Entries of a summary about the bodies."""
    if runner.bodies is None:
        return {"design": config.design}
    designs = {"bodies": config.designs.bodies, "refresh": config.designs.refresh}
    return {"designs": designs, "evaluated_on": runner.evaluator.about}


def _conclude(console: Console, runner: Any, summary: dict[str, Any], seconds: float, folder: Path, keys: str) -> None:
    """Say how the run has ended and what one can do next."""
    command, status, best = summary["command"], summary["status"], summary["best_return"]
    done, saved = runner.current_learning_iteration, runner.saved_iteration
    words = {"done": "done", "interrupted": "interrupted, state saved", "failed": "failed"}[status]
    if status != "done" and saved != done:
        words = f"{status}, the state of iteration {saved} is kept,"
    text = f"{words} after {runner.steps:,} control steps in {seconds:.0f} s"
    if best is not None:
        text += f"; best evaluation {best:.2f} (iteration {runner.best_iteration})"
    echo(console, text)
    if status == "done" and command == "train":
        echo(console, f"look at it: warpvox play {shell_argument('run', folder)}{keys} 'export=[gif,html]'")
    if status != "done" and (folder / STATE).is_file():
        echo(console, f"go on: warpvox train {shell_argument('resume', folder)}{keys}")
