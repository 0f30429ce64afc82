"""``warpvox bench suite=gpu``: checks and figures of a CUDA device, part by part, within a time.

A GPU is often lent for minutes. So one call does everything, the checks first; a part that fails is written down and
the others go on; what the time does not suffice for is left out, and said. On the CPU (``device=cpu``) the same parts
run in a small size.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from warpvox.cli.benchmarks import gpu_checks
from warpvox.cli.benchmarks.bodies import full_body, one_body
from warpvox.cli.benchmarks.kernels import STAGES, compile_seconds, stage_times
from warpvox.cli.benchmarks.learning import learn
from warpvox.cli.benchmarks.machine import available_memory
from warpvox.cli.benchmarks.memory import per_environment
from warpvox.cli.benchmarks.report import Report, middle, number
from warpvox.cli.benchmarks.step import HEADINGS
from warpvox.cli.benchmarks.subject import Subject, measure
from warpvox.envs.registry import get_task, task_ids

__all__ = ["Size", "run"]


@dataclass(frozen=True)
class Size:
    """How much is done: environments of the tables, of the tasks and stages, sides of the bodies."""

    envs: tuple[int, ...]
    tasks: int
    bodies: tuple[int, ...]
    bodies_envs: int


LARGE = Size((1, 1024, 4096, 16384, 65536), 16384, (5, 15, 25, 35), 1024)
SMALL = Size((1, 8), 8, (3,), 8)
LEARNING_SECONDS = 60.0
"""What the last part may take of the eight minutes."""


def run(config: Any, report: Report) -> dict[str, Any]:
    """All parts; ``failed`` names those that raised, ``left_out`` those for which no time was left."""
    size = SMALL if config.device == "cpu" else LARGE
    parts: dict[str, Callable[[], Any]] = {
        "trajectories": lambda: gpu_checks.trajectories(config, report, _tasks(config)),
        "determinism": lambda: gpu_checks.determinism(config, report, size.tasks),
        "independence": lambda: gpu_checks.independence(config, report, size.tasks),
        "graph": lambda: gpu_checks.graph(config, report, size.tasks),
        "recordings": lambda: gpu_checks.recordings(config, report),
        "environments": lambda: _environments(config, report, size, False),
        "environments, graph": lambda: _environments(config, report, size, True),
        "tasks": lambda: _all_tasks(config, report, size),
        "stages": lambda: _stages(config, report, size),
        "compilation": lambda: _compilation(config, report),
        "bodies": lambda: _bodies(config, report, size),
        "learning": lambda: _learning(config, report),
    }
    began = time.perf_counter()
    figures: dict[str, Any] = {
        "task": config.task,
        "device": config.device,
        "seconds": {},
        "failed": [],
        "left_out": [],
    }
    for name, part in parts.items():
        start = time.perf_counter()
        if start - began > config.seconds:
            figures["left_out"].append(name)
            continue
        try:
            with report.status(name):
                figures[name] = part()
        except Exception as error:  # whatever it is, the other parts are worth having
            figures["failed"].append(name)
            figures[name] = {"error": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
            report.note(f"FAILED, {name}: {type(error).__name__}: {error}")
        figures["seconds"][name] = round(time.perf_counter() - start, 1)
    if figures["left_out"]:
        report.note(f"Left out, for the {config.seconds:g} s were over: {', '.join(figures['left_out'])}.")
    return figures


def _tasks(config: Any) -> list[str]:
    return [get_task(task).id for task in config.tasks] or task_ids()


def _environments(config: Any, report: Report, size: Size, graph: bool) -> list[dict[str, Any]]:
    """The three columns by number of environments, with the memory that they take from the device."""
    body, rows, needed = one_body(config), [], 0.0
    if graph and config.device == "cpu":
        return []
    for count in size.envs:
        before = available_memory(config.device)
        if count * needed > before:
            report.note(f"{count:,} environments need {count * needed / 2**30:.1f} GiB: left out.")
            continue
        subject = Subject(config, config.task, body, count, cuda_graph=graph)
        subject.settle()
        rates = measure(subject, config.columns, config.repeats)
        taken = before - available_memory(config.device)
        needed = per_environment(subject.env)
        rows.append({"num_envs": count, "rates": rates, "bytes": needed, "taken": taken, "steps": subject.steps})
    shown = [
        [
            f"{row['num_envs']:,}",
            *(number(middle(row["rates"][c])) for c in config.columns),
            number(row["bytes"] / 1000),
        ]
        for row in rows
    ]
    launched = ", one graph a step" if graph else ""
    title = f"{config.task}, control steps per second, {config.dtype}, {config.device}{launched}"
    report.table(title, ["environments", *(HEADINGS[c] for c in config.columns), "kB an environment"], shown)
    return rows


def _all_tasks(config: Any, report: Report, size: Size) -> dict[str, list[float]]:
    body, rates = one_body(config), {}
    for task in _tasks(config):
        subject = Subject(config, task, body, size.tasks)
        subject.settle()
        rates[task] = measure(subject, ["step"], config.repeats)["step"]
    rows = [[task, number(middle(values))] for task, values in rates.items()]
    report.table(f"{size.tasks:,} environments, control steps per second", ["task", HEADINGS["step"]], rows)
    return rates


def _stages(config: Any, report: Report, size: Size) -> dict[str, float]:
    subject = Subject(config, config.task, one_body(config), size.tasks)
    subject.settle()
    times = stage_times(subject, config)
    total = sum(times.values()) or 1.0
    rows = [[STAGES.get(name, name), number(value), f"{value / total:.0%}"] for name, value in times.items()]
    title = f"{size.tasks:,} environments: stages, microseconds per control step of an environment"
    report.table(title, ["stage", "time", "share"], rows)
    return times


def _compilation(config: Any, report: Report) -> dict[str, float]:
    if not config.compile:
        return {}
    seconds = compile_seconds(config)
    report.note(
        f"First run: {number(seconds['first'])} s of CPU time until the first control step,"
        f" {number(seconds['cached'])} s with the kernels in the cache."
    )
    return seconds


def _bodies(config: Any, report: Report, size: Size) -> list[dict[str, Any]]:
    rows = []
    for side in size.bodies:
        subject = Subject(config, config.task, full_body(side, config.seed), size.bodies_envs)
        subject.settle()
        rates = measure(subject, ["step"], config.repeats)["step"]
        rows.append({"side": side, "rates": rates, "bytes": per_environment(subject.env)})
    shown = [
        [
            f"{row['side']} x {row['side']}",
            number(middle(row["rates"])),
            number(middle(row["rates"]) * row["side"] ** 2),
        ]
        for row in rows
    ]
    title = f"Full bodies, {size.bodies_envs:,} environments, control steps per second"
    report.table(title, ["body", "steps/s", "voxel steps/s"], shown)
    return rows


def _learning(config: Any, report: Report) -> dict[str, Any]:
    config = replace(config, learning=replace(config.learning, seconds=min(config.learning.seconds, LEARNING_SECONDS)))
    found = learn(config, one_body(config), config.learning.ppo[0], config.seed)
    took = f"{found['seconds']:.1f} s" if found["seconds"] is not None else "not reached"
    report.note(
        f"ppo={config.learning.ppo[0]}, {found['num_envs']} environments: return {config.learning.stop_return:g}"
        f" {took}, {found['steps']:,} control steps."
    )
    return found
