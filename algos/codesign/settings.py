"""Settings of a design search: task, algorithm, fitness and executor."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from warpvox.algos.protocols import CHOOSING, NOMINAL
from warpvox.algos.robots.entry import Robot, zoo
from warpvox.algos.search.settings import ALGORITHMS, GA, SearchSettings
from warpvox.algos.settings import PRESETS, DesignTraining, PhysicsConfig, Ppo, physics_of, sim_of
from warpvox.algos.training.settings import DEVICES, MOST_THREADS, RAY, RULE_SETS, TASK, TORCH_THREADS, arithmetic_key
from warpvox.checks import check_choice
from warpvox.errors import ConfigError, RunError
from warpvox.examples import bare_id
from warpvox.keys import Settings, key, plain
from warpvox.types import RULES

if TYPE_CHECKING:
    from warpvox.algos.candidate import Candidate, DesignEvaluator, Outcome
    from warpvox.algos.env_factory import EnvFactory
    from warpvox.envs.spec import TaskSpec

CHANGEABLE = (
    "executor", "address", "workers", "device", "threads", "torch_threads", "top", "name", "memory_check", "logger",
    "export", "resume", "output_dir",
)  # fmt: skip
"""Settings that may change when a search is resumed, as they do not affect its results.

But for rounding on another device.
"""


Kind = TypeVar("Kind", bound="Fitness")

FITNESS: dict[str, type[Fitness]] = {}
"""Kinds of fitness by name."""


@dataclass(frozen=True)
class Workload:
    """Size of a batch of designs, for memory estimates.

    ``envs`` environments for each of ``designs`` designs; setting ``key`` to ``value`` gives ``envs``. ``ppo``: of the
    policy that learns; None: nothing learns.
    """

    designs: int
    envs: int
    key: str
    value: int
    ppo: Ppo | None = None


@dataclass
class Fitness(Settings):
    """Base class of kinds of fitness; ``build`` creates the evaluator, all other methods have defaults.

    Settings are fields made by :func:`warpvox.keys.key`. The argument ``search`` is always the settings of the search.

    Raises:
        ConfigError: a setting out of range.
    """

    name: str = key("", "how the fitness of a design is found")

    prefix = "fitness."
    finalists = 0
    """Number of best designs evaluated once more at the end of a search (origin ``finalist``)."""

    def build(self, search: Codesign, known: Any) -> DesignEvaluator:
        """Create the evaluator, in the process that evaluates, from the data of :meth:`begins_with`."""
        raise NotImplementedError

    def check(self, search: Codesign) -> None:
        """Raise an error if settings contradict each other; by default, check nothing.

        Raises:
            ConfigError: which, and what would.
        """

    def resolved(self, search: Codesign, folder: Path | None) -> Fitness:
        """Return a copy with names replaced by values; ``folder``: of a resumed search.

        Raises:
            WarpvoxError: what is named does not exist, or does not fit the task and the bodies.
        """
        return self

    def begins_with(self, search: Codesign, start: Sequence[Robot], folder: Path | None) -> Any:
        """Collect picklable data that :meth:`build` needs, such as the gaits of the starting robots."""
        return None

    def inherits(self, search: Codesign) -> bool:
        """Return whether the evaluator needs the policies of the candidates' parents."""
        return False

    def cost(self, search: Codesign, task: TaskSpec) -> tuple[float, float] | None:
        """Estimate the control steps of one design and of all finalists together; None: unknown."""
        return None

    def workloads(self, search: Codesign) -> list[Workload]:
        """Return the sizes of the largest simulated batches, for memory estimates; empty: unknown."""
        return []

    def run_of(self, search: Codesign, candidate: Candidate, outcome: Outcome) -> dict[str, Any]:
        """Return the settings for playing a design's policy that differ from the search's."""
        return {}


def register_fitness(kind: type[Kind]) -> type[Kind]:
    """Register a class in :data:`FITNESS` under its ``name`` (decorator)."""
    FITNESS[kind.name] = kind
    return kind


@dataclass
class Codesign(Settings):
    """Settings of a design search.

    Raises:
        ConfigError: a value that is not valid.
    """

    task: Any = key("Walker-v0", TASK)
    shape: list[int] = key(
        [5, 5], "rows and columns of the bodies; in the paper [5,5], for Lifter-v0 [5,7]", low=1, form="[rows,columns]"
    )
    rules: str = key("evogym", RULE_SETS, choices=RULES)
    search: SearchSettings = key(GA, "how designs are proposed")
    fitness: Fitness = key(lambda: FITNESS["specialist"](), "how the fitness of a design is found")
    protocol: str = key(
        NOMINAL,
        "episodes by which designs and policies are compared: undisturbed (nominal), or several with noise on the"
        " actions, whose mean counts (noise)",
        choices=CHOOSING,
    )
    training: DesignTraining = key(DesignTraining, "how a design's own policy is trained")
    start: list[str] = key(
        [],
        "robots whose bodies the first generation contains, with fitness=gaits also their gaits: zoo:TASK, zoo:FILE,"
        " the folder of a search (its best design), of one of its designs or of a run, or bodies: random:100:5x5 (drawn"
        " with seed as train's designs are), a folder of design files, or what design takes",
    )
    reuse: bool = key(True, "take the result of a body that was evaluated before instead of training it again")
    batch: int | None = key(
        None,
        "designs evaluated in one batch, whose results are stored together; null: a whole generation (executor=ray: a"
        " worker's share of it), or as many as take about 20 million control steps",
        low=1,
    )
    seed: int = key(0, "seed of all random numbers", low=0)
    device: str = key("auto", DEVICES)
    dtype: str = key("float32", "precision of the simulation", choices=("float32", "float64"))
    arithmetic: str | None = arithmetic_key("chosen by dtype")
    physics: PhysicsConfig = key(PhysicsConfig, "preset and constants of the physics", nodes=PRESETS)
    threads: int | None = key(
        None, "CPU threads of the simulation; null: all cores (executor=ray: one)", low=1, high=MOST_THREADS
    )
    torch_threads: int = key(1, TORCH_THREADS, low=1, high=MOST_THREADS)
    executor: str = key(
        "local",
        "where designs are trained: in this process (local) or on workers of Ray (ray)",
        choices=("local", "ray"),
    )
    address: str | None = key(None, RAY)
    workers: int | None = key(
        None, "number of workers of executor=ray; null: one for each GPU, or as many as the CPUs allow", low=1
    )
    logger: str = key("none", "where generations are logged besides: wandb, or none", choices=("wandb", "none"))
    top: int = key(5, "number of best designs that are shown and drawn for each generation", low=1)
    memory_check: bool = key(True, "refuse, before allocating, what does not fit into free memory")
    name: str | None = key(None, "appended to the name of the run's folder")
    output_dir: str = key("outputs", "folder that runs are written to")

    def __post_init__(self) -> None:
        """Convert short forms to settings, robots to their names, and validate all values."""
        if isinstance(self.search, str | Mapping):
            self.search = _chosen("search", "algorithm", self.search, ALGORITHMS)
        if isinstance(self.fitness, str | Mapping):
            self.fitness = _chosen("fitness", "name", self.fitness, FITNESS)
        self.task, self.physics = bare_id(self.task), PhysicsConfig.of(self.physics)
        if isinstance(self.start, list | tuple):
            self.start = [_start_name(one) for one in self.start]
        else:
            self.start = [_start_name(self.start)]
        super().__post_init__()

    def factory(self, obs: str = "task") -> EnvFactory:
        """Create an environment factory with these settings; ``device`` may still be ``auto``."""
        from warpvox.algos.env_factory import EnvFactory

        return EnvFactory(self.task, self.rules, obs, sim=sim_of(self), protocol=self.protocol)

    def resolved(self, folder: Path | None = None) -> Codesign:
        """Return a copy with names replaced by values: settings of the fitness, physics constants.

        Raises:
            WarpvoxError: see :meth:`Fitness.resolved`.
        """
        physics = PhysicsConfig.of(physics_of(self))
        return dataclasses.replace(self, fitness=self.fitness.resolved(self, folder), physics=physics)


def _start_name(robot: Any) -> str:
    """Return the text that stores ``robot`` in ``start``: ``zoo:FILE``, a path, or the cells as JSON.

    ConfigError: a robot that is in no file, or nothing of the kind.
    """
    if isinstance(robot, str | os.PathLike):
        return os.fspath(robot)
    if isinstance(robot, Robot):
        if not robot.source or zoo(robot.source.removeprefix("zoo:")).sha256 != robot.sha256:
            raise ConfigError(
                "start: this robot is in no file that the search can name. Write it,"
                " warpvox.algos.robots.save_robot(path, robot), and give start=['zoo:PATH']."
            )
        return robot.source
    with suppress(RunError):  # of a design whose policy was not kept there is the body
        place = getattr(robot, "policy_source", None)
        if isinstance(place, Path):
            return str(place)
    cells = plain(robot, "start")
    if not isinstance(cells, list):
        raise ConfigError(f"start must be a list of robots, runs, designs or bodies, got {robot!r:.80}.")
    return json.dumps(cells)


def _chosen(group: str, name: str, values: str | Mapping[str, Any], kinds: Mapping[str, type]) -> Any:
    """Create settings of the class in ``kinds`` that ``values`` selects by name."""
    given = {name: values} if isinstance(values, str) else dict(values)
    check_choice(group, given.get(name), kinds)
    return kinds[given[name]](**given)
