"""``warpvox bench suite=scaling``: the paper's Figure 2, and what many environments and several threads bring.

Figure 2 (section A.5): robots of n x n voxels are simulated one at a time on flat terrain of 100 voxels (Walker-v0),
ten of each size for ten seconds under random actions. Beside it: the reference, and a batch of the first robot.
"""

from __future__ import annotations

import time
from operator import mul
from statistics import fmean
from typing import Any

import numpy as np

from warpvox.bench.cases import one_body, sampled_or_full
from warpvox.bench.check import against_reference
from warpvox.bench.machine import per_environment
from warpvox.bench.reference import Reference, open_reference
from warpvox.bench.report import Report, middle
from warpvox.bench.runner import HEADINGS, Runner, measure, unit
from warpvox.errors import MemoryLimitError
from warpvox.system import usable_cores

STEPS_PER_SECOND = 50
"""Control steps of a simulated second (section A.2)."""
PACK, SMALL = 32, 25
"""In the batch, bodies of SMALL cells get ``num_envs`` environments, larger ones fewer, at least PACK."""
CHECK_STEPS = 20
"""Steps over which large bodies are compared with the reference: chaos sets in earlier the more contacts there are."""


def run(config: Any, report: Report) -> None:
    """Three tables: by size of the body, by number of environments, by threads."""
    with open_reference(config, report) as reference:
        report.figures["bodies"] = scale_bodies(config, report, reference)
    scale_envs(config, report)
    if config.device == "cpu":
        scale_threads(config, report)


def scale_bodies(config: Any, report: Report, reference: Reference | None) -> list[dict[str, Any]]:
    """One row for each size: voxels and rates of its robots, one at a time, in the reference, and in a batch."""
    scaling = config.scaling
    rows = []
    for side in scaling.sizes:
        with report.console.status(f"{scaling.bodies} bodies of {side} x {side}"):
            rows.append(_one_size(config, scaling, side, reference))
    _show_bodies(config, report, scaling, rows)
    return rows


def _one_size(config: Any, scaling: Any, side: int, reference: Reference | None) -> dict[str, Any]:
    bodies, sampled = sampled_or_full(side, scaling.bodies, config.seed)
    steps = max(1, round(scaling.seconds * STEPS_PER_SECOND))
    count = config.num_envs
    if count > PACK:
        count = max(PACK, count * SMALL // side**2 // PACK * PACK)
    batch = Runner(config, bodies[:1], count)
    row: dict[str, Any] = {
        "side": side,
        "sampled": sampled,
        "steps": steps,
        "voxels": [int(np.count_nonzero(body)) for body in bodies],
        "num_envs": count,
        "scalar_error": batch.error,
        "rates": measure({"": batch}, ["step"], config.repeats)[""]["step"],
        "bytes": per_environment(batch.env),
        "one": [],
    }
    theirs: list[float] = []
    for body in bodies:
        one = Runner(config, [body], 1)
        row["one"].append(one.rate("step", steps))
        one.check_finite()
        if reference is not None:
            reference.start(config.task, body)
            if not theirs:
                row["reference_error"] = against_reference(config, config.task, body, reference, CHECK_STEPS)
            theirs.append(reference.timer(steps, one.env.num_actions, config.seed)())
    if theirs:
        row |= {"reference": theirs, "ratio": fmean(row["one"]) / fmean(theirs)}
        row["batch_ratio"] = middle(row["rates"]) / theirs[0]
    return row


def _show_bodies(config: Any, report: Report, scaling: Any, rows: list[dict[str, Any]]) -> None:
    def means(row: dict[str, Any], name: str) -> list[float | None]:
        """Mean rate of the robots, and mean of the rate times the voxels."""
        rates = row.get(name)
        return [fmean(rates), fmean(map(mul, rates, row["voxels"]))] if rates else [None, None]

    compared = "reference" in rows[0]
    columns = range(10) if compared else (0, 1, 2, 3, 7, 8)
    headings = "robots,voxels,steps/s,x voxels,reference,x voxels,ratio,in a batch,batch of,ratio".split(",")
    shown = []
    for row in rows:
        size = f"{row['side']} x {row['side']} {'sampled' if row['sampled'] else 'full'}"
        cells = [size, round(fmean(row["voxels"])), *means(row, "one"), *means(row, "reference"), row.get("ratio")]
        shown.append([*cells, row["rates"], row["num_envs"], row.get("batch_ratio")])
    report.table(
        f"{config.task}, means of {scaling.bodies} robots, one at a time, {scaling.seconds:g} simulated seconds each:"
        f" control steps per {unit(config.device)}",
        [headings[column] for column in columns],
        [[row[column] for column in columns] for row in shown],
    )
    worst = max(row.get("reference_error", row["scalar_error"]) for row in rows)
    what = "the reference" if compared else "one environment alone in float64"
    report.note(
        f"Checked: the first robot of each size within {worst:.1e} of {what}. Voxels: those that are not empty; x"
        " voxels: the rate times their number; in a batch: the first robot of a size in so many environments."
    )


def scale_envs(config: Any, report: Report) -> None:
    """The columns for numbers of environments; what needs too much time or memory is left out, with the reason."""
    body, rows, left_out = one_body(config), [], []
    for count in sorted(config.scaling.envs):
        try:
            with report.console.status(f"{count:,} environments"):
                runner = Runner(config, [body], count)
                if not runner.fits:
                    left_out.append(f"{count:,} (over {config.limit:g} s a repetition)")
                    continue
                rates = measure({"": runner}, config.columns, config.repeats)[""]
        except (MemoryError, MemoryLimitError):
            left_out.append(f"{count:,} (memory)")
            continue
        rows.append([f"{count:,}", *rates.values(), per_environment(runner.env) / 1000])
    title = f"{config.task}, control steps per {unit(config.device)}, {config.dtype}, {config.device}"
    report.table(title, ["environments", *(HEADINGS[c] for c in config.columns), "kB an environment"], rows)
    if left_out:
        report.note(f"Left out: {', '.join(left_out)}.")


def scale_threads(config: Any, report: Report) -> None:
    """One thread and all: control steps per second of wall-clock time, alternating."""
    body, counts = one_body(config), sorted({1, usable_cores()})
    with report.console.status("threads"):
        runners = {str(n): Runner(config, [body], threads=n, now=time.perf_counter) for n in counts}
        found = measure(runners, ["step"], config.repeats)
    base = middle(found["1"]["step"])
    rows = [[name, rates["step"], middle(rates["step"]) / base] for name, rates in found.items()]
    title = f"{config.task}, {config.num_envs} environments, control steps per second"
    report.table(title, ["threads", "step only", "gain"], rows)
