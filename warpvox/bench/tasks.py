"""``warpvox bench suite=tasks``: every task, beside the reference if there is one."""

from typing import Any

from warpvox.bench.cases import one_body
from warpvox.bench.check import STEPS, against_reference
from warpvox.bench.reference import open_reference
from warpvox.bench.report import Report, middle, number
from warpvox.bench.runner import HEADINGS, Runner, measure, unit
from warpvox.envs.registry import get_task, task_ids


def run(config: Any, report: Report) -> None:
    """A row a task: the medians of the columns and the ratio of step only."""
    body, rows, errors = one_body(config), [], []
    tasks = [get_task(task).id for task in config.tasks] or task_ids()
    with open_reference(config, report) as reference:
        for place, task in enumerate(tasks, 1):
            with report.console.status(f"{task} ({place} of {len(tasks)})"):
                runner, others = Runner(config, [body], task=task), {}
                errors.append(runner.error)
                if reference is not None:
                    errors[-1] = against_reference(config, task, body, reference)
                    others["reference"] = reference.timer(config.steps, runner.env.num_actions, config.seed)
                found = measure({task: runner}, config.columns, config.repeats, others)
            step, theirs = found[task].get("step"), found.get("reference", {}).get("step")
            rows.append(
                [task, *found[task].values(), theirs, middle(step) / middle(theirs) if step and theirs else None]
            )
    title = f"Control steps per {unit(config.device)}, {config.num_envs} environments, {config.dtype}, {config.device}"
    report.table(title, ["task", *(HEADINGS[column] for column in config.columns), "reference", "ratio"], rows)
    if reference is not None:
        report.note(f"Checked: each within {max(errors):.1e} of the reference over {STEPS} steps in float64.")
    else:
        said = f"Checked: each within {max(errors):.1e} of one environment alone in float64; there was no reference."
        report.note(said)
    report.figures["check_error"] = max(errors)
    ratios = [row[-1] for row in rows if row[-1] is not None]
    if ratios:
        summary = {"median": middle(ratios), "least": min(ratios), "most": max(ratios)}
        report.note("Ratio: " + ", ".join(f"{name} {number(value)}" for name, value in summary.items()) + ".")
        report.figures |= {f"ratio_{name}": value for name, value in summary.items()}
