"""The keys of ``warpvox bench``, and its suites."""

# ruff: noqa: RUF009  (key() is dataclasses.field with a meaning)

from dataclasses import dataclass
from typing import Any

from warpvox.algos.training.settings import ARITHMETICS, MOST_THREADS
from warpvox.keys import key

PPO = ("parallel", "evogym")
"""Names of configs/ppo."""

SUITES = {
    "peer": "speed beside the reference",
    "tasks": "each task by itself, beside the reference if there is one",
    "mixed": "a different body in every environment, compared with one body in all",
    "scaling": "bodies of n x n voxels, numbers of environments, threads",
    "learning": "time to a return",
    "gradients": "derivatives of control steps: their error, their time, and gaits found with them",
    "kernels": "times of the stages, memory, compilation",
    "gpu": "checks and measurements of a CUDA device in one command",
}
"""Suites of ``warpvox bench``."""
COLUMNS = ("step", "inference", "training")
"""Columns of a table of speeds: random actions, actions of a policy, whole iterations of PPO."""


@dataclass
class ScalingConfig:
    """Keys ``scaling.*``: what the suite of that name varies."""

    sizes: list[int] = key(list(range(5, 36)), "sizes n of the bodies of n x n voxels", low=2, high=60)
    bodies: int = key(10, "number of robots of each size", low=1)
    seconds: float = key(10.0, "simulated seconds for each robot, 50 control steps per second", above=0)
    envs: list[int] = key([1, 8, 64, 512, 4096, 16384, 65536], "numbers of environments", low=1)


@dataclass
class LearningConfig:
    """Keys ``learning.*``: who learns, until when."""

    ppo: list[str] = key(["parallel", "evogym"], "settings to compare: names of configs/ppo", choices=PPO)
    seeds: int = key(3, "number of runs of each", low=1)
    stop_return: float = key(10.0, "return to reach in a deterministic evaluation")


@dataclass
class BenchConfig:
    suite: str = key("peer", "; ".join(f"{name}: {text}" for name, text in SUITES.items()), choices=tuple(SUITES))
    task: str = key("Walker-v0", "task id", path="read")
    tasks: list[str] = key([], "tasks of suite=tasks and suite=gpu; []: all", path="read")
    design: Any = key("walker", "body, as for train", path="read")
    num_envs: int = key(512, "environments stepped in parallel", low=1)
    steps: int = key(40, "control steps of a timed repetition; fewer if they would take longer than limit", low=1)
    repeats: int = key(5, "number of repetitions, whose median is reported", low=1)
    limit: float = key(
        4.0, "time limit of a repetition, in seconds; what takes longer even at its shortest is left out", above=0
    )
    columns: list[str] = key(list(COLUMNS), "what is timed: step, inference, training", choices=COLUMNS)
    device: str | None = key(None, "auto, cpu, cuda, cuda:<index>; null: cuda for suite=gpu, cpu for the others")
    dtype: str = key("float32", "precision of the simulation", choices=("float32", "float64"))
    arithmetic: str | None = key(None, "arithmetic of the simulation; null: chosen by dtype", choices=ARITHMETICS)
    threads: int = key(1, "CPU threads of the simulation", low=1, high=MOST_THREADS)
    torch_threads: int = key(1, "PyTorch threads", low=1, high=MOST_THREADS)
    seed: int = key(0, "seed of the random actions", low=0)
    peer: str | None = key(
        None,
        "Python interpreter with evogym 2.0.0; make: first make one (needs Python 3.10 and a package index); null: the"
        " one that was made, if any",
        path="read",
    )
    scaling: ScalingConfig = key(ScalingConfig, "suite=scaling")
    learning: LearningConfig = key(LearningConfig, "suite=learning")
    seconds: float | None = key(
        None,
        "suite=gpu: no part begins after so many (null: 400); suite=learning: of a run at most (null: 150)",
        above=0,
    )
    document: str | None = key(
        None, "Markdown file whose tables of this suite are replaced (`<!-- bench SUITE -->`)", path="written"
    )
    name: str | None = key(None, "appended to the name of the result's folder")
    output_dir: str = key("outputs", "folder that results are written to", path="written")
