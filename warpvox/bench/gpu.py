"""``warpvox bench suite=gpu``: checks and figures of a CUDA device, part by part, within a time.

A GPU is often lent for minutes, and a call may be cut off. So one call does everything, what matters most first:
correctness in under a minute, then figures, then what takes long. Each row is saved when it is there; a part that fails
is written down and the others go on; what the time does not suffice for is left out, and said. On the CPU
(``device=cpu``) the same parts run in a small size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from warpvox.bench import gpu_checks, gpu_rates
from warpvox.bench.kernels import compile_seconds
from warpvox.bench.machine import machine
from warpvox.bench.progress import Progress
from warpvox.bench.report import Report
from warpvox.envs.registry import get_task, task_ids

__all__ = ["Size", "run"]

FIRST = ("Walker-v0", "Carrier-v0", "Climber-v2", "BeamToppler-v0", "Balancer-v1")
"""Tasks that are compared before anything is measured: plain ground, a load, walls, a loose beam, a narrow support."""


@dataclass(frozen=True)
class Size:
    """How much is done: environments of the parts, threads of a block, sides of bodies, designs of a population."""

    envs: tuple[int, ...]
    blocks: tuple[int, ...]
    checked: int
    tasks: int
    sides: tuple[int, ...]
    bodies: int
    training: tuple[int, ...]
    designs: int


LARGE = Size((16384, 65536, 4096, 1024, 1), (64, 32, 128, 256), 4096, 16384, (5, 15, 25, 35), 1024, (4096, 16384), 25)
SMALL = Size((1, 8), (64,), 8, 8, (3,), 8, (8,), 2)


def run(config: Any, report: Report) -> dict[str, Any]:
    """All parts; ``failed`` names those that raised, ``left_out`` what no time was left for."""
    size = SMALL if config.device == "cpu" else LARGE
    about = {"suite": config.suite, "machine": machine(config.device), "task": config.task, "device": config.device}
    progress = Progress(report, about, config.seconds)
    for name, part in _parts(config, size, progress).items():
        progress.run(name, part)
    return {"task": config.task, "device": config.device} | progress.close()


def _parts(config: Any, size: Size, progress: Progress) -> dict[str, Callable[[], Any]]:
    """What is done, in this order; what an entry returns is kept under its name."""
    wanted = [get_task(task).id for task in config.tasks] or task_ids()
    first = [task for task in FIRST if task in wanted] or wanted[:1]
    rest = [task for task in wanted if task not in first]
    report, exact = progress.report, "float64"

    parts = {
        "correctness": lambda: gpu_checks.trajectories(config, progress, "correctness", first, config.dtype),
        "determinism": lambda: gpu_checks.determinism(config, report, size.checked),
        "independence": lambda: gpu_checks.independence(config, report, size.checked),
        "graph": lambda: gpu_checks.graph(config, report, size.checked),
        "sizes": lambda: gpu_rates.sizes(config, progress, size.envs, size.blocks, False),
        "stages": lambda: gpu_rates.stages(config, progress, size.tasks),
        "bodies": lambda: gpu_rates.bodies(config, progress, size.bodies, size.sides),
        "training": lambda: gpu_rates.training(config, progress, size.training, size.designs),
        "learning": lambda: gpu_rates.learning(config, progress),
        "sizes, graph": lambda: gpu_rates.sizes(config, progress, size.envs, (), True),
        "double": lambda: gpu_checks.trajectories(config, progress, "double", first, exact),
        "other tasks": lambda: gpu_checks.trajectories(config, progress, "other tasks", rest, config.dtype),
        "tasks": lambda: gpu_rates.tasks(config, progress, wanted, size.tasks),
        "recordings": lambda: gpu_checks.recordings(config, report, progress.left),
        "other tasks, double": lambda: gpu_checks.trajectories(config, progress, "other tasks, double", rest, exact),
        "compilation": lambda: compile_seconds(config, report) if config.compile else {},
    }
    left_out = {"sizes, graph"} if config.device == "cpu" else set()
    left_out |= set() if rest else {"other tasks", "other tasks, double"}
    return {name: part for name, part in parts.items() if name not in left_out}
