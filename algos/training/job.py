"""A training from settings to result: environments, runner, folder and summary."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Any

from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.checkpoints.policy import Policy
from warpvox.algos.evaluate import EpisodeReturns, Evaluator, evaluator
from warpvox.algos.generators import Generators
from warpvox.algos.listener import Listener
from warpvox.algos.metrics import SERVICES, check_logger
from warpvox.algos.policies.registry import MLP, check_network, check_policy, voxels_of
from warpvox.algos.protocols import episodes_of
from warpvox.algos.robots.entry import zoo
from warpvox.algos.robots.episodes import known_task
from warpvox.algos.settings import physics_of, sim_of
from warpvox.algos.training.bodies import (
    Bodies,
    TrainingBodies,
    lanes_of,
    load_bodies,
    read_bodies,
    training_bodies,
)
from warpvox.algos.training.distributed import join_process_group
from warpvox.algos.training.held_out import HeldOut
from warpvox.algos.training.pretrained import OBS_OF_VOXELS, adopted
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.algos.training.settings import Designs, Training
from warpvox.devices.names import resolve_device
from warpvox.devices.out_of_memory import enough_memory
from warpvox.devices.startup import own_torch, start_warp
from warpvox.envs.dumps import DivergenceDump
from warpvox.envs.memory import ask, environment_bytes
from warpvox.envs.registry import get_task
from warpvox.envs.spec import TaskSpec
from warpvox.envs.vec_env import make_vec
from warpvox.envs.worlds import task_world
from warpvox.errors import ConfigError, ResumeError, RunError, StorageError
from warpvox.io.writing import check_writable, to_yaml
from warpvox.runs import STATE, ZOO, Run, check_unchanged, keep_code, read_summary, run_folder, write_summary
from warpvox.system import usable_cores

CHANGEABLE = (
    "max_iterations", "eval_interval", "stop_return", "save_interval", "device", "threads", "torch_threads", "logger",
    "nan_guard", "memory_check", "export", "resume", "output_dir",
)  # fmt: skip
"""Keys that may change when a run is resumed, as they do not affect learning.

But for ``max_iterations`` where the rate falls to the end (``ppo.schedule=linear``), and rounding: another device, or
other ``torch_threads``, adds up the products of matrices in another order.
"""


class Job:
    """A training: validates its settings, trains in :meth:`train`, and keeps the result.

    Args:
        settings: of the training; with ``source`` only settings in :data:`CHANGEABLE` may differ from those of that
            run.
        named: keys that the user has given, which must agree with a pretrained policy.
        source: the run to continue; None: a new run.
    """

    def __init__(self, settings: Training, named: Collection[str] = (), source: Run | None = None) -> None:
        check_logger(settings.logger)
        self.folder = None if source is None else source.folder
        self.checkpoint = self.learned = self.best = None
        self.rows: list[Mapping[str, float]] = []
        self.summary: dict[str, Any] = {}
        if source is not None:
            settings, self.checkpoint = continued(settings, source)
        elif "design" in named and settings.is_many:  # the user names one body, the preset many
            if any(key.startswith("designs") for key in named):
                raise ConfigError("design is one body, designs are many for one policy: give one of the two.")
            settings = dataclasses.replace(settings, designs=Designs())
        unnamed = source is None and "task" not in named and settings.task == Training.task
        if unnamed and str(settings.design).startswith(ZOO):
            settings = dataclasses.replace(settings, task=known_task(zoo(settings.design.removeprefix(ZOO))))
        if source is None and settings.pretrained is not None:
            settings, self.learned = adopted(settings, settings.pretrained, named)
        self.settings = settings

    def check(self) -> None:
        """Raise an error if a task, body, policy or device in the settings does not exist."""
        resolved(self.settings)

    def train(
        self,
        listeners: Sequence[Listener] = (),
        callbacks: Sequence[Callable[[Mapping[str, float]], object]] = (),
        *,
        write: bool = True,
        place: Path | None = None,
        finish: Callable[[], object] = lambda: None,
    ) -> None:
        """Train the policy and write the run's folder, after validating everything.

        Args:
            listeners: called about the progress, in the first process only.
            callbacks: functions that are called with the row of each iteration, after the listeners.
            write: whether to write a folder.
            place: the folder of a new run; None: a new one in ``output_dir``, named by the time.
            finish: called by the first process when the training is done, before another one may write to the folder.

        Raises:
            WarpvoxError: something asked for does not exist or is not valid, or learning has diverged.
            KeyboardInterrupt: interrupted; the state has been saved, if there is a folder.
        """
        if not write and (self.settings.nan_guard == "dump" or self.settings.logger in SERVICES):
            raise ConfigError("nan_guard=dump and logger=wandb|neptune write files; folder=None writes none.")
        self.group = join_process_group(self.settings.device)
        if not self.group.is_main_process:
            listeners = ()
        with own_torch(self.settings.torch_threads):
            self._prepare(listeners)
        if not write and self.judge is not None:
            self.runner.evaluator = partial(self._keep_best, self.judge)
        with self._folder(place) if write else nullcontext():
            self._learn(listeners, callbacks)
            if self.group.is_main_process:
                finish()

    def _prepare(self, listeners: Sequence[Listener]) -> None:
        """Create environments, evaluator and runner, without writing files."""
        group = self.group
        settings = self.settings
        with ExitStack() as stack:
            for listener in listeners:
                stack.enter_context(listener.preparing("loading"))
            start_warp()

            # This process's share of the environments, its device and its threads
            if group.size > 1:
                if settings.num_envs % group.size:
                    raise ConfigError(
                        f"num_envs={settings.num_envs} cannot be shared out evenly to {group.size} processes."
                    )
                settings = dataclasses.replace(
                    settings,
                    num_envs=settings.num_envs // group.size,
                    device=group.device,
                    threads=settings.threads or max(1, usable_cores() // group.local_size),
                )
            settings = resolved(settings)
            count = settings.num_envs
            seed = group.seed(settings.seed)

            # Bodies
            bodies = training_bodies(settings)
            exchanged = None
            designs = bodies.trained
            if settings.is_many:
                exchanged = Bodies.of(bodies, settings, seed)
                designs = exchanged.first(count)
            sim = dataclasses.replace(sim_of(settings), grid=bodies.grid)

            # Memory. With a grid for many bodies the number of environments need not be a multiple of the bodies.
            if settings.memory_check:
                spec = get_task(settings.task).under(settings.rules)
                worlds = [task_world(spec, design) for design in (designs if sim.grid is None else designs[:1])]
                options = sim.resolved(count)
                each = environment_bytes(spec, worlds, count, options, obs=settings.obs, ppo=settings.ppo)
                ask(each, count, settings.device, step=len(worlds))

        advice = f"Train with fewer environments: num_envs={max(1, count // 2)} instead of {count}."
        with enough_memory(advice), ExitStack() as stack:
            for listener in listeners:
                stack.enter_context(
                    listener.preparing(
                        "preparing the simulation (the first time on a machine its kernels are compiled)"
                    )
                )

            # Environments
            env = make_vec(settings.task, designs, count, seed=seed, sim=sim, rules=settings.rules, obs=settings.obs)
            env = adapt(env, settings.ppo)
            self.judge = self._make_judge(settings, bodies) if group.is_main_process else None

            # Network: build one for a check first. `voxels` stays None for mlp.
            generators = Generators(seed, str(env.device))
            voxels = None
            if settings.policy != MLP:
                with generators:
                    check_network(env.env, settings.policy, settings.network)
                    voxels = voxels_of(settings.policy, env.env, settings.network)
            elif settings.network is not None:
                raise ConfigError("network has the settings of the other policies; those of policy=mlp are ppo.hidden.")

            # Stored in checkpoints: what the policy was trained on
            trained_on: dict[str, Any] = {
                "task": str(task_name(settings.task)), "rules": settings.rules, "seed": settings.seed,
                "design": settings.design,
            }  # fmt: skip
            if settings.is_many:
                names = ("bodies", "refresh", "held_out")
                trained_on["design"] = None
                trained_on["designs"] = {name: getattr(settings.designs, name) for name in names}

            # Runner
            self.runner = Runner(
                env,
                settings.ppo,
                Schedule(settings.max_iterations, settings.save_interval, settings.eval_interval, settings.stop_return),
                voxels=voxels,
                bodies=exchanged,
                trained_on=trained_on,
                evaluator=self.judge,
                group=group,
                logger=settings.logger,
                generators=generators,
                torch_threads=settings.torch_threads,
            )
            if self.checkpoint is not None:
                go_on(self.checkpoint, self.runner)
            elif self.learned is not None:
                self.runner.begin_with(self.learned)

        if group.size > 1:  # store the settings of the whole run, not of this process's share
            device = settings.device.split(":")[0]
            settings = dataclasses.replace(settings, num_envs=self.settings.num_envs, device=device)
        self.settings = settings
        self.written = dataclasses.replace(settings, task=task_name(settings.task))

    def _make_judge(self, settings: Training, bodies: TrainingBodies) -> Evaluator:
        """Create the evaluator, which repeats the same episodes, on the CPU even if training is on a GPU.

        On a GPU the few environments of an evaluation would need as many kernel launches as ten iterations.
        """
        lanes = bodies.lanes(settings, settings.device)
        sim = dataclasses.replace(sim_of(settings), device="cpu", lanes=lanes, grid=bodies.grid)
        env = make_vec(
            settings.task,
            bodies.judged,
            episodes_of(settings.episodes, settings.protocol) * len(bodies.judged),
            seed=settings.seed,
            sim=sim,
            rules=settings.rules,
            obs=settings.obs,
            auto_reset=False,
        )
        judge = evaluator(env, settings.seed, settings.protocol)
        if not settings.is_many:
            return judge
        return HeldOut(judge, bodies.judged, "bodies" if bodies.own else "held_out", str(task_name(settings.task)))

    @contextmanager
    def _folder(self, place: Path | None) -> Iterator[None]:
        """Create the folder of a new run, or open a resumed run's folder, within the block."""
        settings = self.settings
        group = self.group
        runner = self.runner
        made = run_folder(
            self.folder,
            self.written,
            "train",
            to_yaml(self.written),
            place,
            check=lambda: self.checkpoint and go_on(self.checkpoint, runner),
        )
        with made if group.is_main_process else nullcontext() as folder:
            self.folder = runner.folder = folder = Path(str(group.broadcast(folder and str(folder))))
            if self.checkpoint is not None and not group.is_main_process:
                go_on(self.checkpoint, runner)
            if settings.nan_guard == "dump":
                env = runner.env.env
                env.dump = DivergenceDump(env, folder / ("dumps" if group.is_main_process else f"dumps_{group.rank}"))
            if isinstance(self.judge, HeldOut):
                self.judge.folder = folder
            if group.is_main_process:
                keep_code(settings, folder)
            yield

    def _learn(
        self, listeners: Sequence[Listener], callbacks: Sequence[Callable[[Mapping[str, float]], object]]
    ) -> None:
        """Run the training loop; write the summary and notify the listeners even after errors."""
        runner = self.runner
        status = "failed"
        began = time.perf_counter()
        steps_before = runner.steps

        def report(row: Mapping[str, float]) -> None:
            self.rows.append(row)
            for listener in listeners:
                listener.iterated(row)
            for callback in callbacks:
                callback(row)

        runner.report = report
        count = runner.env.num_envs
        fewer = f"(num_envs={max(1, count // 2)} instead of {count})"
        for listener in listeners:
            listener.begun(self)
        try:
            with enough_memory(f"Train with fewer environments {fewer} or a lower ppo.steps."):
                runner.run()
            status = "done"
        except KeyboardInterrupt:
            status = "interrupted"
            raise
        finally:
            seconds = time.perf_counter() - began
            if runner.current_learning_iteration and self.group.is_main_process:
                settings = self.settings
                designs = settings.designs
                about = {"command": "train", "task": runner.env.env.spec.id, "status": status, "seed": settings.seed}
                if isinstance(self.judge, HeldOut):
                    about["designs"] = {"bodies": designs.bodies, "refresh": designs.refresh}
                    about["evaluated_on"] = self.judge.about
                else:
                    about["design"] = settings.design
                self.summary = about | runner.summary()
                self.summary["steps_per_second"] = round((runner.steps - steps_before) / seconds, 1)
                # if the run failed because nothing can be written, that first error is the one to report
                with suppress(StorageError) if status == "failed" else nullcontext():
                    if self.folder is not None:
                        write_summary(self.folder, self.summary)
            for listener in listeners:
                listener.ended(self.summary)

    def _keep_best(self, judge: Evaluator, policy: Any) -> EpisodeReturns:
        """Evaluate ``policy`` with ``judge``, and copy it to ``best`` if its mean return is the highest so far."""
        found = judge(policy)
        if found.mean_return > self.runner.best_return:
            self.best = Policy(policy.spec, policy.actor.state_dict())
        return found

    @property
    def policy(self) -> Policy:
        """Best policy of a training without files, on the CPU."""
        policy = self.best or self.runner.policy
        known = {name: getattr(self.settings, name) for name in ("obs", "dtype", "arithmetic")}
        known["lanes"] = lanes_of(self.settings, len(load_bodies(self.settings.design, self.settings.seed)))
        policy.metadata |= self.runner.trained_on | known | {"physics": dataclasses.asdict(self.settings.physics)}
        return policy.to("cpu")


def resolved(settings: Training) -> Any:
    """Replace names in ``settings`` by values (cells, constants, device), except random bodies."""
    get_task(settings.task)
    check_policy(settings.policy)
    designs = {}
    for name in ("bodies", "held_out"):
        spec = getattr(settings.designs, name)
        if spec is not None and not (isinstance(spec, str) and spec.startswith("random:")):
            designs[name] = read_bodies(spec, settings.seed, f"designs.{name}")
    bodies = load_bodies(settings.design, settings.seed)
    return dataclasses.replace(
        settings,
        design=bodies[0] if len(bodies) == 1 else bodies,
        designs=dataclasses.replace(settings.designs, **designs),
        obs=settings.obs if settings.policy == MLP else OBS_OF_VOXELS.get(settings.obs, settings.obs),
        physics=physics_of(settings),
        device=resolve_device(settings.device, settings.num_envs),
    )


def task_name(task: Any) -> str:
    """Return the id that stands for a task in files."""
    return task.id if isinstance(task, TaskSpec) else task


def continued(settings: Training, source: Run) -> tuple[Training, Path]:
    """Return the settings for continuing the run ``source``, and the checkpoint to continue from."""
    check_writable(source.folder)
    named = dataclasses.replace(resolved(settings), task=task_name(settings.task))
    check_unchanged(source.config, named, CHANGEABLE)
    checkpoint = source.checkpoint or source.folder / STATE
    if not checkpoint.is_file():
        raise RunError(
            f"The run {source.folder} cannot be resumed: it has no {STATE}. If it was stopped before its first"
            " iteration, start it again."
        )
    try:
        load_checkpoint(checkpoint)
    except RunError as error:
        reason = str(error).rstrip(".")
        for number in reversed(source.iterations):
            other = source.folder / f"model_{number}.pt"
            try:
                load_checkpoint(other)
            except RunError:
                continue
            newest = f"The newest checkpoint that can be read is that of iteration {number}, {other.name};"
            raise ResumeError(f"{reason}. {newest} from there it goes on with new episodes.", other) from None
        raise RunError(f"{reason}, and there is no other checkpoint: start the run again.") from None
    return dataclasses.replace(settings, resume=None), checkpoint


def go_on(checkpoint: Path, runner: Runner) -> None:
    """Load a checkpoint into ``runner`` to continue training; ResumeError: no iterations are left.

    A run that was killed after its last iteration, before its summary was written, may continue: only the summary is
    left to do.
    """
    with own_torch(runner.torch_threads):
        runner.resume(checkpoint)
    done = runner.current_learning_iteration
    total = runner.schedule.total
    goal = runner.schedule.stop_return
    about = read_summary(checkpoint.parent)
    ended = about.get("status") == "done" and about.get("iterations") == done  # else killed before its summary
    if done > total or (done == total and (ended or checkpoint.name != STATE)):  # a summary is about the newest state
        raise ResumeError(
            f"The run has already made {done} iterations, and max_iterations={total} asks for no more.",
            checkpoint.parent,
            max_iterations=2 * done,
        )
    if ended and goal is not None and runner.last_return >= goal:
        raise ResumeError(
            f"The run has ended because an evaluation ({runner.last_return:.3f}) has already reached"
            f" stop_return={goal:g}.",
            checkpoint.parent,
            stop_return=None,
        )
