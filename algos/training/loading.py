"""Loading of trained policies and matching environments."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import torch

from warpvox.algos.checkpoints.export import read_exported
from warpvox.algos.checkpoints.policy import Policy, read_policy
from warpvox.algos.find import find_run, run_of_robot
from warpvox.algos.metrics import COLUMNS, read_metrics
from warpvox.algos.protocols import NOMINAL, parts_of
from warpvox.algos.robots.entry import Robot
from warpvox.algos.robots.episodes import SEEDS, known_task, robot_env, with_facts
from warpvox.algos.training.bodies import lanes_of, load_bodies
from warpvox.algos.training.playing import SHOWN, Playing, disturbed, load_trained
from warpvox.algos.training.settings import Training
from warpvox.checks import check_path
from warpvox.code import Code, is_code, passed_code
from warpvox.design import Design
from warpvox.devices.names import resolve_device
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import TaskSpec
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import ConfigError, DesignError
from warpvox.keys import in_words
from warpvox.runs import CONFIG, Run

if TYPE_CHECKING:
    from warpvox.algos.training.job import Job


def find_policy(
    source: Any, output_dir: str | Path = "outputs", network: str | None = None, device: str = "cpu"
) -> Run | Callable[[Any], Any]:
    """Find the run or stored robot named by ``source``; a function of observations is returned unchanged.

    Args:
        source: ``latest``, the folder of a run or of a design search (its best design), a checkpoint, an exported file,
            ``zoo:TASK``; what :func:`warpvox.zoo`, :func:`warpvox.train`, :func:`warpvox.codesign` or
            :func:`warpvox.load_policy` returns, or a design of a search; a function of observations, such as a torch
            module, or an object with such a method ``act``.
        output_dir: where ``latest`` is looked for.
        network: of a file that lies in no run's folder, where the code of its network is.
        device: of the policy of such a file.

    Raises:
        RunError: no such run or file, or it holds no policy. ConfigError: nothing of the kind.
    """
    source = getattr(source, "policy_source", source)  # of the results of a training or search
    if isinstance(source, Robot):
        return run_of_robot(source)
    if isinstance(source, str | os.PathLike):
        path = check_path("The run or file of a policy", source)
        if str(source) != "latest" and path.is_file():
            exported = read_exported(path, network)
            if exported is not None:
                return exported.to(device)
            if not (path.parent / CONFIG).is_file():
                return read_policy(path, device, network)
        return find_run(str(source), str(output_dir))
    # a torch module that has no forward can be called, but fails
    has_forward = not isinstance(source, torch.nn.Module) or type(source).forward is not torch.nn.Module.forward
    act = source if callable(source) and has_forward else getattr(source, "act", None)
    if not callable(act) or isinstance(source, type):
        raise ConfigError(
            "A policy must be a run (its folder, a checkpoint, latest, zoo:TASK, or what train, codesign, zoo and"
            f" load_policy return) or a function of observations; got {source!r:.80}."
        )
    return act


@in_words
def load_policy(
    source: Any = "latest",
    *,
    checkpoint: str = "best",
    output_dir: str | Path = "outputs",
    device: str = "cpu",
    policy: str | None = None,
) -> Policy:
    """Load a trained policy without exploration as a torch module from observations to actions.

    The module can be scripted, traced and exported (see :class:`warpvox.algos.checkpoints.policy.Policy`). No file is
    unpickled and none brings code: a run's task is not imported.

    Args:
        source: ``latest``, the folder of a run or of a design search (its best design), a checkpoint file, a file
            that ``warpvox export format=[onnx,jit]`` has written, or a robot of the zoo, ``zoo:Walker-v0``; also what
            :func:`warpvox.zoo`, :func:`warpvox.train` or :func:`warpvox.codesign` returns, or one of its designs. A
            policy or another function of observations is returned as it is.
        checkpoint: of a run: ``best``, ``last`` or an iteration.
        output_dir: where ``latest`` is looked for.
        device: where the module shall be; of a function, it is of no effect.
        policy: of a run or file with a network of your own, where its code is: ``FILE.py:Class`` or ``module:Class``,
            which is imported only if it is named here.

    Raises:
        RunError: there is no such run, checkpoint or file, or it holds no policy. DeviceError: no such device.
    """
    if not isinstance(policy, str | None):
        raise ConfigError(f"policy must name code, FILE.py:Class, got {policy!r:.80}.")
    network = None if policy is None else Code(policy)
    device = resolve_device(device)
    run = find_policy(source, output_dir, network, device)
    if not isinstance(run, Run):
        return cast(Any, run)
    if run.robot is not None:
        return with_facts(run.robot).to(device)
    names = ("task", "rules", "obs", "design", "physics", "dtype", "arithmetic")
    known = {name: run.config.get(name) for name in names} | ({"design": None} if run.is_many else {})
    trained = Training.of(run.config, run.folder / CONFIG)
    known["lanes"] = lanes_of(trained, len(load_bodies(trained.design, trained.seed)))
    file = run.find_checkpoint(str(checkpoint))
    network = passed_code("policy", run.config.get("policy"), network, run.folder)
    return read_policy(file, device, network, known | {"source": str(file)})


@dataclasses.dataclass(frozen=True)
class TrainedRun:
    """Result of a finished training.

    Attributes:
        folder: of the run, as ``warpvox play run=FOLDER`` takes it; None: nothing was written.
        summary: what ``summary.json`` says: ``status``, ``iterations``, ``steps``, ``best_iteration``, ...
        rows: of ``metrics.csv``.
        policy: the one with the best return, on the CPU.
    """

    folder: Path | None
    summary: Mapping[str, Any]
    rows: Sequence[Mapping[str, float]] = dataclasses.field(repr=False)
    policy: Policy = dataclasses.field(repr=False)

    @property
    def design(self) -> Design | dict[str, Design]:
        """Body of the run, or bodies by robot name.

        Raises:
            DesignError: the policy is for many bodies.
        """
        body = self.policy.design
        if body is None:
            raise DesignError("This run does not say which body it is for: give the body itself.")
        return body

    @property
    def policy_source(self) -> Path | Policy:
        """Folder of the run, or the policy itself if no files were written."""
        return self.folder or self.policy

    @classmethod
    def of(cls, job: Job) -> TrainedRun:
        """Create the result from a finished ``job``."""
        if job.folder is None:
            return cls(None, job.summary, job.rows, job.policy)
        policy = load_policy(job.folder, policy=job.settings.policy)
        return cls(job.folder, job.summary, read_metrics(job.folder), policy)

    def __repr__(self) -> str:
        best = "no evaluation" if self.best_return is None else f"best return {self.best_return:.3f}"
        where = "nothing written" if self.folder is None else repr(str(self.folder))
        return f"TrainedRun({self.summary['status']}, {self.summary['steps']:,} steps, {best}, {where})"

    def _repr_html_(self) -> str:
        """Show the result and the learning curve as HTML, for notebooks."""
        from warpvox.algos.report.charts import picture

        points = [(row["steps"], row.get("eval_return", np.nan)) for row in self.rows]
        return f"{escape(repr(self))}<br>{picture(points, 'control steps', 'return')}"

    @property
    def best_return(self) -> float | None:
        """Best mean return of all deterministic evaluations, or None."""
        return self.summary["best_return"]

    @property
    def metrics(self) -> dict[str, np.ndarray]:
        """Columns of ``metrics.csv`` as float64 arrays ``[iterations]``; NaN for missing values."""
        return {name: np.array([row.get(name, np.nan) for row in self.rows], float) for name in COLUMNS}


def load_run(run: Run, config: Any, designs: Any = None, every: bool = False) -> tuple[VoxelVecEnv, Any]:
    """Load environments and policy of a run (see :func:`load_trained`) or of a stored robot."""
    if run.robot is not None:
        if designs is not None:
            raise ConfigError("Other bodies go with a run over many of them; a stored robot has its own.")
        return _load_robot(run.robot, config, run.folder)
    return load_trained(run, config, designs, every)


def _load_robot(robot: Robot, config: Playing, file: Path) -> tuple[VoxelVecEnv, Any]:
    """Load environments and policy of a stored robot; exact, with recorded seeds, unless ``config`` differs.

    ``config.seed`` is that of the first episode; the others follow it, as an entry is judged.
    """
    if config.stochastic:
        raise ConfigError("stochastic=true goes with a run; a stored robot has no exploration to sample from.")
    if config.checkpoint != "best":
        raise ConfigError("checkpoint goes with a run; a stored robot has one policy.")
    policy = robot.own_policy
    task = config.task if isinstance(config.task, TaskSpec) else passed_code("task", robot.task, config.task, file)
    if isinstance(config.task, Code) and task not in task_ids():  # an entry for a task of the user's own has its id
        task = config.task
    if isinstance(task, str) and not is_code(task):
        known_task(robot)
    robot = dataclasses.replace(robot, task=task)
    parts = parts_of(getattr(config, "protocol", NOMINAL), feedback=robot.has_feedback)
    alike = parts == (NOMINAL,) and not get_task(robot.task).is_random
    count = 1 if alike else config.num_envs or SHOWN
    options = {name: value for name in ("dtype", "arithmetic") if (value := getattr(config, name)) is not None}
    if isinstance(config.arithmetic, str) and config.arithmetic == "fast":
        options.setdefault("dtype", "float32")
    options |= {"threads": config.threads, "memory_check": config.memory_check}
    options |= {"device": resolve_device(config.device, count), "num_envs": count * len(parts)}
    first = SEEDS[0] if config.seed is None else config.seed
    env = robot_env(robot, list(range(first, first + count)) * len(parts), **options)

    def act(obs: torch.Tensor) -> torch.Tensor:
        return policy(obs).double()  # noise is added in float64, as in the recorded episodes

    return env, disturbed(act, env, parts, first)
