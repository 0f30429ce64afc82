"""``warpvox bench suite=scaling``: the paper's Figure 2, and what many environments and several threads bring.

Figure 2 (section A.5): robots of n x n voxels are simulated one at a time on flat terrain of 100 voxels (Walker-v0),
ten of each size for ten seconds under random actions. Beside it: the reference, and a batch of the first robot.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from warpvox.bench.case import Case, one_body, sampled_or_full
from warpvox.bench.check import against_reference
from warpvox.bench.machine import available_memory
from warpvox.bench.memory import per_environment
from warpvox.bench.reference import Reference, open_reference
from warpvox.bench.report import Report, middle, number
from warpvox.bench.runner import HEADINGS, Runner, measure, unit
from warpvox.system import usable_cores

__all__ = ["run"]

MEMORY_SHARE = 0.7
"""Share of the free memory that environments may take."""
STEPS_PER_SECOND = 50
"""Control steps of a simulated second (section A.2)."""
PACK, SMALL = 32, 25
"""In the batch, bodies of SMALL cells get ``num_envs`` environments, larger ones fewer, at least PACK."""
CHECK_STEPS = 20
"""Steps over which large bodies are compared with the reference: chaos sets in earlier the more contacts there are."""
QUICK_STRIDE, QUICK_BODIES, QUICK_SECONDS = 5, 3, 2.0


def run(config: Any, report: Report) -> dict[str, Any]:
    """Three tables: by size of the body, by number of environments, by threads.

    Raises:
        SimulationError: a result is wrong.
    """
    with open_reference(config, report) as reference:
        bodies = scale_bodies(config, report, reference)
    figures = {"task": config.task, "bodies": bodies, "envs": scale_envs(config, report)}
    if config.device == "cpu":
        figures["threads"] = scale_threads(config, report)
    report.plot("figure2", lambda figure: _draw_bodies(figure, config, bodies))
    return figures


def scale_bodies(config: Any, report: Report, reference: Reference | None) -> list[dict[str, Any]]:
    """One row for each size: voxels and rates of its robots, one at a time, in the reference, and in a batch."""
    scaling = config.scaling
    if scaling.quick:
        bodies, seconds = min(scaling.bodies, QUICK_BODIES), min(scaling.seconds, QUICK_SECONDS)
        scaling = replace(scaling, sizes=scaling.sizes[::QUICK_STRIDE], bodies=bodies, seconds=seconds)
    rows = []
    for side in scaling.sizes:
        with report.status(f"{scaling.bodies} bodies of {side} x {side}"):
            rows.append(_one_size(config, scaling, side, reference))
    _show_bodies(config, report, scaling, rows)
    return rows


def _one_size(config: Any, scaling: Any, side: int, reference: Reference | None) -> dict[str, Any]:
    bodies, sampled = sampled_or_full(side, scaling.bodies, config.seed)
    steps = max(1, round(scaling.seconds * STEPS_PER_SECOND))
    count = config.num_envs
    if count > PACK:
        count = max(PACK, count * SMALL // side**2 // PACK * PACK)
    batch = Runner(config, Case("a batch", config.task, bodies[:1], count))
    batch.fit()
    row: dict[str, Any] = {
        "side": side,
        "sampled": sampled,
        "steps": steps,
        "voxels": [int(np.count_nonzero(body)) for body in bodies],
        "num_envs": count,
        "scalar_error": batch.error,
        "rates": measure({"a batch": batch}, ["step"], config.repeats)["a batch"]["step"],
        "bytes": per_environment(batch.env),
        "one": [],
    }
    theirs: list[float] = []
    for body in bodies:
        one = Runner(config, Case("one robot", config.task, [body], 1))
        one.fit()
        row["one"].append(one.rate("step", steps))
        one.check_finite()
        if reference is not None:
            reference.start(config.task, body)
            if not theirs:
                row["reference_error"] = against_reference(config, config.task, body, reference, CHECK_STEPS)
            theirs.append(reference.timer(steps, one.env.num_actions, config.seed)())
    if theirs:
        ratios = {"ratio": np.mean(row["one"]) / np.mean(theirs), "batch_ratio": middle(row["rates"]) / theirs[0]}
        row |= {"reference": theirs} | {name: float(ratio) for name, ratio in ratios.items()}
    return row


def _show_bodies(config: Any, report: Report, scaling: Any, rows: list[dict[str, Any]]) -> None:
    compared = "reference" in rows[0]
    shown = []
    for row in rows:
        size = f"{row['side']} x {row['side']} {'sampled' if row['sampled'] else 'full'}"
        cells = [size, f"{np.mean(row['voxels']):,.0f}", *_means(row, "one")]
        cells += [*_means(row, "reference"), number(row["ratio"])] if compared else []
        cells += [number(middle(row["rates"])), f"{row['num_envs']:,}"]
        shown.append([*cells, number(row["batch_ratio"])] if compared else cells)
    headings = ["robots", "voxels", "steps/s", "x voxels"]
    headings += ["reference", "x voxels", "ratio"] if compared else []
    headings += ["in a batch", "batch of"] + (["ratio"] if compared else [])
    report.table(
        f"{config.task}, means of {scaling.bodies} robots, one at a time, {scaling.seconds:g} simulated seconds each:"
        f" control steps per {unit(config.device)}",
        headings,
        shown,
    )
    worst = max(row.get("reference_error", row["scalar_error"]) for row in rows)
    what = "the reference" if compared else "one environment alone in float64"
    report.note(
        f"Checked: the first robot of each size within {worst:.1e} of {what}. Voxels: those that are not empty; x"
        " voxels: the rate times their number; in a batch: the first robot of a size in so many environments."
    )


def _means(row: dict[str, Any], name: str) -> list[str]:
    """Mean rate of the robots, and mean of the rate times the voxels."""
    return [number(float(np.mean(row[name]))), number(float(np.mean(np.multiply(row[name], row["voxels"]))))]


def _draw_bodies(figure: Any, config: Any, rows: list[dict[str, Any]]) -> None:
    """Both panels of the paper's figure, a point for each robot."""
    figure.set_size_inches(11, 4.5)
    left, right = figure.subplots(1, 2)
    for label, marker, name in (("one robot", "o", "one"), ("reference, one robot", "x", "reference")):
        points = [pair for row in rows for pair in zip(row["voxels"], row.get(name, []), strict=False)]
        _draw_points(left, right, points, label, marker)
    _draw_points(left, right, [(row["voxels"][0], middle(row["rates"])) for row in rows], "a batch", "s")
    left.set(ylabel=f"control steps per {unit(config.device)}")
    right.set(ylabel="the same times voxels")
    for axes in (left, right):
        axes.set(xlabel="voxels that are not empty", yscale="log")
        axes.grid(which="both", alpha=0.3)
        axes.legend()


def _draw_points(left: Any, right: Any, points: list[tuple[int, float]], label: str, marker: str) -> None:
    if points:
        voxels, rates = np.array(points).T
        for axes, values in ((left, rates), (right, rates * voxels)):
            axes.plot(voxels, values, marker, label=label, alpha=0.7, markersize=4)


def scale_envs(config: Any, report: Report) -> list[dict[str, Any]]:
    """The columns for numbers of environments; what needs too much time or memory is left out, with the reason."""
    body, rows, left_out, needed = one_body(config), [], [], 0.0
    for count in sorted(config.scaling.envs):
        if count * needed > MEMORY_SHARE * available_memory(config.device):
            left_out.append(f"{count:,} (memory: {count * needed / 2**30:.1f} GiB)")
            continue
        case = Case(f"{count:,}", config.task, [body], count)
        try:
            with report.status(f"{case.name} environments"):
                runner = Runner(config, case)
                if not runner.fit():
                    left_out.append(f"{case.name} (over {config.limit:g} s a repetition)")
                    continue
                rates = measure({case.name: runner}, config.columns, config.repeats)[case.name]
        except MemoryError:
            left_out.append(f"{case.name} (memory)")
            continue
        needed = per_environment(runner.env)
        row = {"num_envs": count, "scalar_error": runner.error, "steps": runner.steps, "rates": rates, "bytes": needed}
        rows.append(row)
    shown = []
    for row in rows:
        medians = [number(middle(row["rates"][column])) for column in config.columns]
        shown.append([f"{row['num_envs']:,}", *medians, number(row["bytes"] / 1000)])
    title = f"{config.task}, control steps per {unit(config.device)}, {config.dtype}, {config.device}"
    report.table(title, ["environments", *(HEADINGS[c] for c in config.columns), "kB an environment"], shown)
    if left_out:
        report.note(f"Left out: {', '.join(left_out)}.")
    return rows


def scale_threads(config: Any, report: Report) -> dict[str, Any]:
    """One thread and all: control steps per second of wall-clock time, alternating."""
    body, runners = one_body(config), {}
    with report.status("threads"):
        for count in sorted({1, usable_cores()}):
            case = Case(str(count), config.task, [body], config.num_envs, {"threads": count})
            runners[case.name] = Runner(config, case, now=time.perf_counter)
            runners[case.name].fit()
        found = measure(runners, ["step"], config.repeats)
    rates = {name: values["step"] for name, values in found.items()}
    gains = {name: middle(values) / middle(rates["1"]) for name, values in rates.items()}
    shown = [[name, number(middle(values)), number(gains[name])] for name, values in rates.items()]
    title = f"{config.task}, {config.num_envs} environments, control steps per second"
    report.table(title, ["threads", "step only", "gain"], shown)
    return {"rates": rates, "gain": max(gains.values())}
