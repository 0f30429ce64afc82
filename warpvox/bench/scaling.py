"""``warpvox bench suite=scaling``: the paper's Figure 2, and what many environments and several threads bring."""

from __future__ import annotations

import time
from typing import Any

from warpvox.bench.bodies import one_body
from warpvox.bench.check import against_scalar
from warpvox.bench.figure2 import draw_figure2, scale_bodies
from warpvox.bench.machine import available_memory
from warpvox.bench.memory import per_environment
from warpvox.bench.reference import open_reference
from warpvox.bench.report import Report, middle, number
from warpvox.bench.step import HEADINGS, unit
from warpvox.bench.subject import Subject, measure
from warpvox.errors import SimulationError
from warpvox.system import usable_cores

__all__ = ["run", "scale_envs", "scale_threads"]

SHARE = 0.7
"""Of the free memory that environments may take."""


def run(config: Any, report: Report) -> dict[str, Any]:
    """Three tables: by size of the body, by number of environments, by threads.

    Raises:
        SimulationError: a result is wrong.
    """
    with open_reference(config, report, needed=False) as reference:
        bodies = scale_bodies(config, report, reference)
    figures = {"task": config.task, "bodies": bodies, "envs": scale_envs(config, report)}
    if config.device == "cpu":
        figures["threads"] = scale_threads(config, report)
    report.plot("figure2", lambda figure: draw_figure2(figure, config, bodies))
    report.plot("scaling", lambda figure: _draw(figure, config, figures))
    return figures


def scale_envs(config: Any, report: Report) -> list[dict[str, Any]]:
    """The columns for numbers of environments; what needs too much time or memory is left out, with the reason."""
    body, rows, left_out = one_body(config), [], []
    needed = 0.0
    for count in sorted(config.scaling.envs):
        if count * needed > SHARE * available_memory(config.device):
            left_out.append(f"{count:,} (memory: {count * needed / 2**30:.1f} GiB)")
            continue
        try:
            with report.status(f"{count:,} environments"):
                subject = Subject(config, config.task, body, count)
                error = against_scalar(subject.env, config.seed)
                if not subject.settle():
                    left_out.append(f"{count:,} (over {config.limit:g} s a repetition)")
                    continue
                rates = measure(subject, config.columns, config.repeats)
        except MemoryError:
            left_out.append(f"{count:,} (memory)")
            continue
        needed = per_environment(subject.env)
        rows.append({"num_envs": count, "scalar_error": error, "steps": subject.steps, "rates": rates, "bytes": needed})
    title = f"{config.task}, control steps per {unit(config.device)}, {config.dtype}, {config.device}"
    shown = [
        [
            f"{row['num_envs']:,}",
            *(number(middle(row["rates"][c])) for c in config.columns),
            number(row["bytes"] / 1000),
        ]
        for row in rows
    ]
    report.table(title, ["environments", *(HEADINGS[c] for c in config.columns), "kB an environment"], shown)
    if left_out:
        report.note(f"Left out: {', '.join(left_out)}.")
    return rows


def scale_threads(config: Any, report: Report) -> dict[str, Any]:
    """One thread and all: control steps per second of the wall's clock, in turns.

    Raises:
        SimulationError: the number of threads changes a result.
    """
    counts = sorted({1, usable_cores()})
    body, rates = one_body(config), {count: [] for count in counts}
    subjects = {}
    with report.status("threads"):
        for count in counts:
            subjects[count] = Subject(config, config.task, body, config.num_envs, threads=count)
            subjects[count].settle()
        for _ in range(config.repeats):
            for count, subject in subjects.items():
                actions = [subject.actions() for _ in range(subject.steps)]
                began = time.perf_counter()
                for action in actions:
                    subject.env.step(action)
                rates[count].append(subject.steps * config.num_envs / (time.perf_counter() - began))
    _check_threads(subjects)
    gain = middle(rates[counts[-1]]) / middle(rates[1])
    shown = [
        [str(count), number(middle(values)), number(middle(values) / middle(rates[1]))]
        for count, values in rates.items()
    ]
    report.table(
        f"{config.task}, {config.num_envs} environments, control steps per second",
        ["threads", "step only", "gain"],
        shown,
    )
    return {"rates": {str(count): values for count, values in rates.items()}, "gain": gain}


def _check_threads(subjects: dict[int, Subject]) -> None:
    results = []
    for subject in subjects.values():
        subject.env.reset()
        subject._random.manual_seed(1)
        for _ in range(3):
            subject.env.step(subject.actions())
        results.append(subject.env.sim.com("robot"))
    if not all(bool((result == results[0]).all()) for result in results):
        raise SimulationError("The number of threads changes the result: no speed is worth printing.")


def _draw(figure: Any, config: Any, figures: dict[str, Any]) -> None:
    axes = figure.subplots()
    for column in config.columns:
        found = [(row["num_envs"], middle(row["rates"][column])) for row in figures["envs"] if row["rates"][column]]
        axes.plot(*zip(*found, strict=True), "o-", label=HEADINGS[column]) if found else None
    title = f"{config.task}, {config.design if isinstance(config.design, str) else ''}"
    axes.set(xlabel="environments", title=title, ylabel=f"control steps per {unit(config.device)}")
    axes.set(xscale="log", yscale="log")
    axes.grid(which="both", alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend()
