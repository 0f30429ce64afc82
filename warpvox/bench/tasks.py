"""``warpvox bench suite=tasks``: every task, beside the reference if there is one."""

from __future__ import annotations

from typing import Any

import numpy as np

from warpvox.bench.bodies import one_body
from warpvox.bench.check import STEPS, against_reference, against_scalar
from warpvox.bench.reference import Reference, open_reference
from warpvox.bench.report import Report, middle, number
from warpvox.bench.step import HEADINGS, unit
from warpvox.bench.subject import Subject, measure
from warpvox.envs.registry import get_task, task_ids
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["run"]


def run(config: Any, report: Report) -> dict[str, Any]:
    """A row a task: the medians of the columns and the ratio of step only.

    Raises:
        TaskError: unknown task. SimulationError: a result is wrong.
    """
    body = one_body(config)
    tasks = [get_task(task).id for task in config.tasks] or task_ids()
    figures: dict[str, Any] = {}
    with open_reference(config, report, needed=False) as reference:
        for place, task in enumerate(tasks):
            with report.status(f"{task} ({place + 1} of {len(tasks)})"):
                figures[task] = measure_task(config, task, body, reference)
    _show(config, report, figures)
    report.plot("tasks", lambda figure: _draw(figure, config, figures))
    return {"tasks": figures} | _summary(figures)


def measure_task(config: Any, task: str, body: np.ndarray, reference: Reference | None) -> dict[str, Any]:
    """Rates of one task, and the ratio to the reference."""
    subject = Subject(config, task, body, config.num_envs)
    figures: dict[str, Any] = {"scalar_error": against_scalar(subject.env, config.seed)}
    theirs: list[float] = []
    between = int
    if reference is not None:
        reference.start(task, body)
        figures["reference_error"] = against_reference(config, task, body, reference)
        rng, shape = np.random.default_rng(config.seed), (config.steps, subject.env.num_actions)

        def between() -> None:
            theirs.append(reference.rate(rng.uniform(ACTION_LOW, ACTION_HIGH, shape)))

    subject.settle()
    figures |= {"steps": subject.steps, "rates": measure(subject, config.columns, config.repeats, between)}
    if theirs:
        step = figures["rates"].get("step")
        figures |= {"reference": theirs, "ratio": middle(step) / middle(theirs) if step else None}
    return figures


def _summary(figures: dict[str, Any]) -> dict[str, float]:
    ratios = [row["ratio"] for row in figures.values() if row.get("ratio")]
    return {"ratio_median": middle(ratios), "ratio_least": min(ratios), "ratio_most": max(ratios)} if ratios else {}


def _show(config: Any, report: Report, figures: dict[str, Any]) -> None:
    rows = [
        [
            task,
            *(number(middle(row["rates"][column])) for column in config.columns),
            number(middle(row.get("reference", []))),
            number(row.get("ratio")),
        ]
        for task, row in figures.items()
    ]
    title = f"Control steps per {unit(config.device)}, {config.num_envs} environments, {config.dtype}, {config.device}"
    report.table(title, ["task", *(HEADINGS[c] for c in config.columns), "reference", "ratio"], rows)
    errors = [row["reference_error"] for row in figures.values() if "reference_error" in row]
    if errors:
        report.note(f"Checked: each within {max(errors):.1e} of the reference over {STEPS} steps in float64.")
        found = _summary(figures)
        if found:
            words = ("median", "least", "most")
            report.note("Ratio: " + ", ".join(f"{word} {number(found[f'ratio_{word}'])}" for word in words) + ".")
    else:
        worst = max(row["scalar_error"] for row in figures.values())
        report.note(f"Checked: each within {worst:.1e} of one environment alone in float64; there was no reference.")


def _draw(figure: Any, config: Any, figures: dict[str, Any]) -> None:
    figure.set_size_inches(8, 1.5 + 0.24 * len(figures))
    axes = figure.subplots()
    names = list(figures)
    for marker, column in zip("osD", config.columns, strict=False):
        rates = [middle(row["rates"][column]) for row in figures.values()]
        axes.plot(rates, names, marker, label=f"warpvox, {HEADINGS[column]}")
    if any("reference" in row for row in figures.values()):
        axes.plot([middle(row.get("reference", [])) for row in figures.values()], names, "kx", label="reference")
    axes.set(xscale="log", xlabel=f"control steps per {unit(config.device)}")
    axes.grid(axis="x", which="both", alpha=0.3)
    axes.invert_yaxis()
    axes.legend()
