"""The paper's Figure 2 (section A.5): speed over the number of voxels, beside the reference where there is one.

Robots of n x n voxels are simulated one at a time on flat terrain of 100 voxels (Walker-v0), ten of every size for ten
seconds under random actions. What a batch of many environments makes of the first robot of a size stands beside it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from warpvox.bench.bodies import sampled_or_full
from warpvox.bench.check import against_reference, against_scalar
from warpvox.bench.memory import per_environment
from warpvox.bench.reference import Reference
from warpvox.bench.report import Report, middle, number
from warpvox.bench.step import unit
from warpvox.bench.subject import Subject, measure
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["draw_figure2", "scale_bodies"]

STEPS_PER_SECOND = 50
"""Control steps of a simulated second (section A.2)."""
PACK, SMALL = 32, 25
"""In the batch, bodies of SMALL cells get ``num_envs`` environments, larger ones fewer, at least PACK."""
CHECK_STEPS = 20
"""Steps over which large bodies are compared with the reference: chaos sets in earlier the more contacts there are."""
QUICK_STRIDE, QUICK_BODIES, QUICK_SECONDS = 5, 3, 2.0


def scale_bodies(config: Any, report: Report, reference: Reference | None) -> list[dict[str, Any]]:
    """One row for each size: voxels and rates of its robots, one at a time, in the reference, and in a batch.

    Raises:
        SimulationError: a result is wrong.
    """
    scaling = config.scaling
    if scaling.quick:
        scaling = replace(
            scaling,
            sizes=scaling.sizes[::QUICK_STRIDE],
            bodies=min(scaling.bodies, QUICK_BODIES),
            seconds=min(scaling.seconds, QUICK_SECONDS),
        )
    rows = []
    for side in scaling.sizes:
        with report.status(f"{scaling.bodies} bodies of {side} x {side}"):
            rows.append(_one_size(config, scaling, side, reference))
    _show(config, report, scaling, rows)
    return rows


def _one_size(config: Any, scaling: Any, side: int, reference: Reference | None) -> dict[str, Any]:
    bodies, sampled = sampled_or_full(side, scaling.bodies, config.seed)
    steps = max(1, round(scaling.seconds * STEPS_PER_SECOND))
    row: dict[str, Any] = {"side": side, "sampled": sampled, "steps": steps}
    row["voxels"] = [int(np.count_nonzero(body)) for body in bodies]
    row |= _batch(config, bodies[0])
    row["one"], theirs = [], []
    for body in bodies:
        subject = Subject(config, config.task, body, 1)
        subject.settle()
        row["one"].append(subject.timed("step", steps))
        subject.check_finite()
        if reference is not None:
            reference.start(config.task, body)
            if not theirs:
                row["reference_error"] = against_reference(config, config.task, body, reference, CHECK_STEPS)
            rng, shape = np.random.default_rng(config.seed), (steps, subject.env.num_actions)
            theirs.append(reference.rate(rng.uniform(ACTION_LOW, ACTION_HIGH, shape)))
    if theirs:
        row["reference"] = theirs
        row["ratio"] = _mean(row["one"]) / _mean(theirs)
        row["batch_ratio"] = middle(row["rates"]) / theirs[0]
    return row


def _batch(config: Any, body: np.ndarray) -> dict[str, Any]:
    """The first robot in many environments, checked, as the other tables of this suite are measured."""
    count = (
        config.num_envs if config.num_envs <= PACK else max(PACK, config.num_envs * SMALL // body.size // PACK * PACK)
    )
    subject = Subject(config, config.task, body, count)
    error = against_scalar(subject.env, config.seed)
    subject.settle()
    rates = measure(subject, ["step"], config.repeats)["step"]
    return {"num_envs": count, "scalar_error": error, "rates": rates, "bytes": per_environment(subject.env)}


def _mean(values: list[float]) -> float:
    return float(np.mean(values))


def _show(config: Any, report: Report, scaling: Any, rows: list[dict[str, Any]]) -> None:
    compared = "reference" in rows[0]
    shown = []
    for row in rows:
        kind = "sampled" if row["sampled"] else "full"
        cells = [f"{row['side']} x {row['side']} {kind}", f"{np.mean(row['voxels']):,.0f}", *_rates(row, "one")]
        if compared:
            cells += [*_rates(row, "reference"), number(row["ratio"])]
        cells += [number(middle(row["rates"])), f"{row['num_envs']:,}"]
        shown.append([*cells, number(row["batch_ratio"])] if compared else cells)
    headings = ["robots", "voxels", "steps/s", "x voxels"]
    headings += ["reference", "x voxels", "ratio"] if compared else []
    headings += ["in a batch", "batch of", "ratio"] if compared else ["in a batch", "batch of"]
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


def _rates(row: dict[str, Any], name: str) -> list[str]:
    """Mean rate of the robots, and mean of the rate times the voxels."""
    return [number(_mean(row[name])), number(float(np.mean(np.multiply(row[name], row["voxels"]))))]


def draw_figure2(figure: Any, config: Any, rows: list[dict[str, Any]]) -> None:
    """Both panels of the paper's figure, a point for each robot."""
    figure.set_size_inches(11, 4.5)
    left, right = figure.subplots(1, 2)
    first = {"voxels": [row["voxels"][0] for row in rows], "rates": [middle(row["rates"]) for row in rows]}
    series = {
        "warpvox, one robot": ("o", *_points(rows, "one")),
        "warpvox, a batch": ("s", np.array(first["voxels"]), np.array(first["rates"])),
        "reference, one robot": ("x", *_points(rows, "reference")),
    }
    for label, (marker, voxels, rates) in series.items():
        if len(rates):
            left.plot(voxels, rates, marker, label=label, alpha=0.7, markersize=4)
            right.plot(voxels, rates * voxels, marker, label=label, alpha=0.7, markersize=4)
    left.set(ylabel=f"control steps per {unit(config.device)}")
    right.set(ylabel="the same times voxels")
    for axes in (left, right):
        axes.set(xlabel="voxels that are not empty", yscale="log")
        axes.grid(which="both", alpha=0.3)
        axes.legend()


def _points(rows: list[dict[str, Any]], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Voxels and rate of every robot."""
    found = [pair for row in rows for pair in zip(row["voxels"], row.get(name, []), strict=False)]
    return tuple(np.array(found, dtype=float).reshape(-1, 2).T)  # type: ignore[return-value]
