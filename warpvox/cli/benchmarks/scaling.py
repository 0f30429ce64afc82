"""``warpvox bench suite=scaling``: the paper's Figure 2, and what many environments and several threads bring."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from warpvox.cli.benchmarks.bodies import full_body, one_body
from warpvox.cli.benchmarks.check import against_reference, against_scalar
from warpvox.cli.benchmarks.machine import available_memory
from warpvox.cli.benchmarks.memory import per_environment
from warpvox.cli.benchmarks.reference import Reference, open_reference
from warpvox.cli.benchmarks.report import Report, middle, number
from warpvox.cli.benchmarks.step import HEADINGS, unit
from warpvox.cli.benchmarks.subject import Subject, measure
from warpvox.errors import SimulationError
from warpvox.system import usable_cores
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["run", "scale_bodies", "scale_envs", "scale_threads"]

PACK, SMALL = 32, 25
"""Bodies of SMALL voxels get ``num_envs`` environments, larger ones fewer, at least PACK."""
CHECK_STEPS = 20
"""Steps over which large bodies are compared with the reference: chaos sets in earlier the more contacts there are."""
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
    report.plot("scaling", lambda figure: _draw(figure, config, figures))
    return figures


def scale_bodies(config: Any, report: Report, reference: Reference | None) -> list[dict[str, Any]]:
    """Bodies of n x n voxels without a hole (paper section A.5 samples bodies; a full one is the most work)."""
    rows = []
    for side in config.scaling.sizes:
        with report.status(f"bodies of {side} x {side}"):
            rows.append(_one_size(config, side, reference))
    shown = [
        [
            f"{row['side']} x {row['side']}",
            f"{row['voxels']:,}",
            f"{row['num_envs']:,}",
            number(middle(row["rates"])),
            number(middle(row["rates"]) * row["voxels"]),
            number(middle(row.get("reference", []))),
            number(row.get("ratio")),
        ]
        for row in rows
    ]
    headings = ["body", "voxels", "environments", "steps/s", "voxel steps/s", "reference steps/s", "ratio"]
    report.table(f"{config.task}, full bodies, control steps per {unit(config.device)}", headings, shown)
    worst = max(row.get("reference_error", row["scalar_error"]) for row in rows)
    what = "the reference" if reference is not None else "one environment alone in float64"
    report.note(f"Checked: each within {worst:.1e} of {what}.")
    return rows


def _one_size(config: Any, side: int, reference: Reference | None) -> dict[str, Any]:
    body = full_body(side, config.seed)
    count = (
        max(PACK, config.num_envs * SMALL // (side * side) // PACK * PACK)
        if config.num_envs > PACK
        else config.num_envs
    )
    subject = Subject(config, config.task, body, count)
    row = {"side": side, "voxels": side * side, "num_envs": count}
    row["scalar_error"] = against_scalar(subject.env, config.seed)
    theirs: list[float] = []
    between = int
    subject.settle()
    if reference is not None:
        reference.start(config.task, body)
        row["reference_error"] = against_reference(config, config.task, body, reference, CHECK_STEPS)
        rng, shape = np.random.default_rng(config.seed), (subject.steps, subject.env.num_actions)

        def between() -> None:
            theirs.append(reference.rate(rng.uniform(ACTION_LOW, ACTION_HIGH, shape)))

    row |= {"steps": subject.steps, "rates": measure(subject, ["step"], config.repeats, between)["step"]}
    row["bytes"] = per_environment(subject.env)
    if theirs:
        row |= {"reference": theirs, "ratio": middle(row["rates"]) / middle(theirs)}
    return row


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
    figure.set_size_inches(11, 4.5)
    left, right = figure.subplots(1, 2)
    bodies = figures["bodies"]
    left.plot([row["voxels"] for row in bodies], [middle(row["rates"]) for row in bodies], "o-", label="warpvox")
    if any("reference" in row for row in bodies):
        left.plot(
            [row["voxels"] for row in bodies], [middle(row["reference"]) for row in bodies], "kx-", label="reference"
        )
    left.set(xlabel="voxels of a full body", title="as Figure 2 of the paper")
    for column in config.columns:
        found = [(row["num_envs"], middle(row["rates"][column])) for row in figures["envs"] if row["rates"][column]]
        right.plot(*zip(*found, strict=True), "o-", label=HEADINGS[column]) if found else None
    right.set(xlabel="environments", title=f"{config.task}, {config.design if isinstance(config.design, str) else ''}")
    for axes in (left, right):
        axes.set(xscale="log", yscale="log", ylabel=f"control steps per {unit(config.device)}")
        axes.grid(which="both", alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            axes.legend()
