"""``warpvox bench suite=gpu``: checks and figures of a CUDA device, part by part, within a time.

A GPU is often lent for minutes, and a call may be cut off. So one call does everything, what matters most first:
whether it runs and is right, then figures, then what takes long. Each row is saved when it is there; a part that fails
is written down and the others go on; what the time does not suffice for is left out, and said. On the CPU
(``device=cpu``) the same parts run in a small size.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from warpvox.bench import gpu_checks as checks, gpu_rates as rates, gpu_tools as tools
from warpvox.bench.report import Report
from warpvox.envs.registry import get_task, task_ids

FIRST = ("Walker-v0", "Carrier-v0", "Climber-v2", "BeamToppler-v0", "Balancer-v1")
"""Tasks that are compared before anything is measured: plain ground, a load, walls, a loose beam, a narrow support."""
SECONDS = 400.0
ON_CUDA = "sanitizer", "graph", "stream"
"""Parts that mean nothing on the CPU."""


@dataclass(frozen=True)
class Size:
    """How much is done: environments of the parts, sides of bodies, designs of a population, environments of each."""

    envs: tuple[int, ...]
    checked: int
    tasks: int
    sides: tuple[int, ...]
    bodies: int
    training: tuple[int, ...]
    designs: int
    each: tuple[int, ...]


LARGE = Size(
    (16384, 65536, 4096, 1024, 256, 64), 4096, 16384, (5, 15, 25, 35), 1024, (1024, 4096, 16384, 65536), 25, (16, 512)
)
SMALL = Size((1, 8), 8, 8, (3,), 8, (8,), 2, (8,))


def run(config: Any, report: Report) -> None:
    """All parts; ``failed`` names those that raised, ``left_out`` what no time was left for."""
    size = SMALL if config.device == "cpu" else LARGE
    seconds = config.seconds or SECONDS
    report.end = time.perf_counter() + seconds
    for name, part in _parts(config, size, report).items():
        report.run(name, part)
    if left_out := report.figures["left_out"]:
        report.note(f"Left out, for the {seconds:g} s were over: {', '.join(left_out)}.")


def _parts(config: Any, size: Size, report: Report) -> dict[str, Callable[[], Any]]:
    """Parts in their order; the result of each is kept under its name."""
    wanted = [get_task(task).id for task in config.tasks] or task_ids()
    first = [task for task in FIRST if task in wanted] or wanted[:1]
    rest = [task for task in wanted if task not in first]
    common = config, report

    def compared(part: str, tasks: list[str], dtype: str) -> Callable[[], Any]:
        return lambda: checks.correctness(*common, part, tasks, dtype)

    parts = {
        "smoke": lambda: checks.smoke(*common),
        "sanitizer": lambda: tools.sanitizer(*common),
        "correctness": compared("correctness", first, config.dtype),
        "determinism": lambda: checks.determinism(*common, size.checked),
        "independence": lambda: checks.independence(*common, size.checked),
        "graph": lambda: checks.graph(*common, size.checked),
        "stream": lambda: checks.stream(*common, size.checked),
        "sizes": lambda: rates.sizes(*common, size.envs),
        "profile": lambda: tools.profile(*common, size.tasks),
        "training": lambda: rates.training(*common, size.training, size.designs, size.each),
        "learning": lambda: rates.learning(*common),
        "recordings": lambda: checks.recordings(*common),
        "other tasks": compared("other tasks", rest, config.dtype),
        "double": compared("double", first, "float64"),
        "bodies": lambda: rates.bodies(*common, size.bodies, size.sides),
        "tasks": lambda: rates.tasks(*common, wanted, size.tasks),
        "other tasks, double": compared("other tasks, double", rest, "float64"),
    }
    left_out = set(ON_CUDA) if config.device == "cpu" else set()
    left_out |= set() if rest else {"other tasks", "other tasks, double"}
    return {name: part for name, part in parts.items() if name not in left_out}
