"""``warpvox bench suite=tasks``: every task, beside the reference if there is one."""

from __future__ import annotations

from typing import Any

from warpvox.bench.cases import one_body
from warpvox.bench.check import STEPS, against_reference
from warpvox.bench.reference import Reference, open_reference
from warpvox.bench.report import Report, middle, number
from warpvox.bench.runner import HEADINGS, Runner, measure, unit
from warpvox.envs.registry import get_task, task_ids

__all__ = ["run"]


def run(config: Any, report: Report) -> dict[str, Any]:
    """A row a task: the medians of the columns and the ratio of step only."""
    body, figures = one_body(config), {}
    tasks = [get_task(task).id for task in config.tasks] or task_ids()
    with open_reference(config, report) as reference:
        for place, task in enumerate(tasks, 1):
            with report.status(f"{task} ({place} of {len(tasks)})"):
                figures[task] = _measure(config, task, body, reference)
    rows = [[task, *row["rates"].values(), row.get("reference"), row.get("ratio")] for task, row in figures.items()]
    title = f"Control steps per {unit(config.device)}, {config.num_envs} environments, {config.dtype}, {config.device}"
    report.table(title, ["task", *(HEADINGS[column] for column in config.columns), "reference", "ratio"], rows)
    errors = [row["reference_error"] for row in figures.values() if "reference_error" in row]
    if errors:
        report.note(f"Checked: each within {max(errors):.1e} of the reference over {STEPS} steps in float64.")
    else:
        worst = max(row["scalar_error"] for row in figures.values())
        report.note(f"Checked: each within {worst:.1e} of one environment alone in float64; there was no reference.")
    ratios = [row["ratio"] for row in figures.values() if row.get("ratio")]
    summary = {"median": middle(ratios), "least": min(ratios), "most": max(ratios)} if ratios else {}
    if summary:
        report.note("Ratio: " + ", ".join(f"{name} {number(value)}" for name, value in summary.items()) + ".")
    return {"tasks": figures} | {f"ratio_{name}": value for name, value in summary.items()}


def _measure(config: Any, task: str, body: Any, reference: Reference | None) -> dict[str, Any]:
    """Rates of one task, and the ratio to the reference."""
    runner, others = Runner(config, [body], task=task), {}
    figures: dict[str, Any] = {"scalar_error": runner.error}
    if reference is not None:
        figures["reference_error"] = against_reference(config, task, body, reference)
        others["reference"] = reference.timer(config.steps, runner.env.num_actions, config.seed)
    found = measure({task: runner}, config.columns, config.repeats, others)
    figures |= {"steps": runner.steps, "rates": found[task]}
    if others:
        step, theirs = found[task].get("step"), found["reference"]["step"]
        figures |= {"reference": theirs, "ratio": middle(step) / middle(theirs) if step else None}
    return figures
