"""``warpvox bench suite=tasks``: every task, beside the reference if there is one."""

from __future__ import annotations

from typing import Any

from warpvox.bench.case import Case, one_body
from warpvox.bench.check import STEPS, against_reference
from warpvox.bench.reference import Reference, open_reference
from warpvox.bench.report import Report, middle, number
from warpvox.bench.runner import HEADINGS, Runner, measure, unit
from warpvox.envs.registry import get_task, task_ids

__all__ = ["run"]


def run(config: Any, report: Report) -> dict[str, Any]:
    """A row a task: the medians of the columns and the ratio of step only.

    Raises:
        TaskError: unknown task. SimulationError: a result is wrong.
    """
    body = one_body(config)
    cases = [
        Case(task, task, [body], config.num_envs)
        for task in ([get_task(task).id for task in config.tasks] or task_ids())
    ]
    with open_reference(config, report) as reference:
        figures = {}
        for place, case in enumerate(cases):
            with report.status(f"{case.name} ({place + 1} of {len(cases)})"):
                figures[case.name] = _measure(config, case, reference)
    ratios = [row["ratio"] for row in figures.values() if row.get("ratio")]
    summary = {"median": middle(ratios), "least": min(ratios), "most": max(ratios)} if ratios else {}
    _show(config, report, figures, summary)
    return {"tasks": figures} | {f"ratio_{name}": value for name, value in summary.items()}


def _measure(config: Any, case: Case, reference: Reference | None) -> dict[str, Any]:
    """Rates of one task, and the ratio to the reference."""
    runner = Runner(config, case)
    figures: dict[str, Any] = {"scalar_error": runner.error}
    others = {}
    if reference is not None:
        reference.start(case.task, case.bodies[0])
        figures["reference_error"] = against_reference(config, case.task, case.bodies[0], reference)
        others["reference"] = reference.timer(config.steps, runner.env.num_actions, config.seed)
    runner.fit()
    found = measure({case.name: runner}, config.columns, config.repeats, others)
    figures |= {"steps": runner.steps, "rates": found[case.name]}
    if others:
        step, theirs = found[case.name].get("step"), found["reference"]["step"]
        figures |= {"reference": theirs, "ratio": middle(step) / middle(theirs) if step else None}
    return figures


def _show(config: Any, report: Report, figures: dict[str, Any], summary: dict[str, float]) -> None:
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
    else:
        worst = max(row["scalar_error"] for row in figures.values())
        report.note(f"Checked: each within {worst:.1e} of one environment alone in float64; there was no reference.")
    if summary:
        report.note("Ratio: " + ", ".join(f"{name} {number(value)}" for name, value in summary.items()) + ".")
