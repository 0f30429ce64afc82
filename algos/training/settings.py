"""Settings of the training of one policy, validated on construction."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from warpvox.algos.protocols import CHOOSING, NOMINAL
from warpvox.algos.settings import LOGGERS, PRESETS, REFRESH, PhysicsConfig, Ppo
from warpvox.examples import bare_id, design_for
from warpvox.keys import Settings, check_values, convert, key, plain
from warpvox.types import OBSERVATIONS, RULES

MOST_THREADS = 1024
"""Maximum number of threads, above the cores of any machine."""
TASK = "task id, or a task of your own: module:NAME or file.py:NAME"
RULE_SETS = "rules and constants of the benchmark as released (evogym) or as printed in the paper (paper)"
TORCH_THREADS = "PyTorch threads; more than 1 slow down small networks and change rounding"
RAY = "address of a running Ray cluster: auto or host:port; null: start Ray on this machine"
DEVICES = "auto (CUDA where there is a device, from 256 environments on), cpu, cuda, cuda:<index>"


def arithmetic_key(default: str) -> Any:
    """Declare the field of the key ``arithmetic``; ``default`` describes null in the help."""
    return key(None, f"fast, or exact (float64, bit for bit as released); null: {default}", choices=("fast", "exact"))


@dataclass
class Designs(Settings):
    """Keys ``designs.*``: many bodies for one policy; ``designs=...`` is short for ``designs.bodies=...``."""

    bodies: Any = key(
        None,
        "bodies to train one policy on, instead of design: random:64, random:64:5x7, a folder of designs or of a"
        " design search, or a list of designs",
    )
    refresh: str = key(
        "none",
        "what replaces a body after its episode: none (nothing), new (a new random body), random (any of the bodies),"
        " performance (bodies with low returns more often)",
        choices=REFRESH,
    )
    held_out: Any = key(
        None,
        "bodies for evaluation only, never trained on, given as designs; null: 32 random ones of the same size, or the"
        " bodies themselves where these are named",
    )
    grid: list[int] | None = key(
        None, "rows and columns that bodies have room for; null: those of the largest", low=1, form="[rows,columns]"
    )


@dataclass
class Training(Settings):
    """Settings of a training: the keys of ``warpvox train`` with their defaults.

    Values may be numpy's, bodies arrays, parts mappings (``ppo={"steps": 64}``).

    Raises:
        ConfigError: a value that is not valid.
    """

    task: str = key("Walker-v0", TASK)
    design: Any = key(
        "walker",
        "body: an example's name, auto (the example for the task), random, random:5x7, zoo:TASK, a file or folder with"
        " a body, or rows of cells; zoo:TASK also sets the task unless task is given; for a task with several robots"
        " {name:body}",
    )
    rules: str = key("evogym", RULE_SETS, choices=RULES)
    policy: str = key(
        "mlp",
        "network of the policy: mlp (layers: ppo.hidden), grid or transformer (both observe voxels: obs=task"
        " becomes voxel, timed becomes timed_voxel), or your own: module:Class, file.py:Class",
    )
    network: Any = key(None, "settings of a network other than mlp, {width:32} for instance; null: its defaults")
    obs: str = key(
        "task",
        "observations: as the task has (task), by cell (voxel), with the time (timed, timed_voxel)",
        choices=OBSERVATIONS,
    )
    num_envs: int = key(512, "environments stepped in parallel", low=1)
    max_iterations: int = key(400, "training iterations in total, including those before a resume", low=1)
    eval_interval: int = key(10, "iterations between deterministic evaluations", low=1)
    episodes: int | None = key(None, "evaluation episodes for each design; null: 1, with protocol=noise 8", low=1)
    protocol: str = key(
        NOMINAL,
        "episodes by which the best policy is chosen: undisturbed (nominal), or several with noise on the actions,"
        " whose mean counts (noise)",
        choices=CHOOSING,
    )
    stop_return: float | None = key(None, "stop as soon as an evaluation reaches this return; null: never")
    save_interval: int = key(50, "iterations between checkpoints", low=1)
    seed: int = key(0, "seed of all random numbers", low=0)
    device: str = key("auto", DEVICES)
    dtype: str = key("float32", "precision of the simulation", choices=("float32", "float64"))
    arithmetic: str | None = arithmetic_key("chosen by dtype")
    threads: int | None = key(None, "CPU threads of the simulation; null: all cores", low=1, high=MOST_THREADS)
    lanes: int | None = key(
        None, "environments that a thread advances at once, in SIMD lanes; null: by their number and the processor"
    )
    logger: str = key(
        "tensorboard",
        "where metrics are logged besides metrics.csv: tensorboard, wandb, neptune (by rsl-rl's writer) or none",
        choices=LOGGERS,
    )
    nan_guard: str = key(
        "on",
        "what happens when an environment diverges: its episode ends (on), and its last 64 steps are also written"
        " to the folder dumps of the run (dump)",
        choices=("on", "dump"),
    )
    torch_threads: int = key(1, TORCH_THREADS, low=1, high=MOST_THREADS)
    memory_check: bool = key(True, "refuse, before allocating, what does not fit into free memory")
    resume: str | None = key(
        None,
        "continue a run: latest, its folder, or a checkpoint file in it, whose later checkpoints are then removed",
    )
    name: str | None = key(None, "appended to the name of the run's folder")
    output_dir: str = key("outputs", "folder that runs are written to")
    physics: PhysicsConfig = key(PhysicsConfig, "preset and constants of the physics", nodes=PRESETS)
    ppo: Ppo = key(Ppo, "settings of PPO")
    designs: Designs = key(Designs, "many bodies for one policy")
    pretrained: str | None = key(
        None,
        "policy to begin with instead of a new one: latest, the folder of a training or a checkpoint in"
        " it; network and observations are its own",
    )

    def __post_init__(self) -> None:
        """Convert short forms to settings and NumPy values to plain ones, and validate all values."""
        if isinstance(self.designs, str | list | tuple):
            self.designs = Designs(self.designs)
        self.task, self.physics = bare_id(self.task), PhysicsConfig.of(self.physics)
        convert(self, without=("task",))  # or a specification of a task
        self.design = plain(self.design, "design")
        self.network = plain(self.network, "network")
        self.design = design_for(getattr(self.task, "id", self.task), self.design)
        for name in ("bodies", "held_out"):
            setattr(self.designs, name, plain(getattr(self.designs, name), f"designs.{name}"))
        check_values(self)

    @property
    def is_many(self) -> bool:
        """True if one policy is trained on many bodies."""
        return self.designs.bodies is not None
