"""``warpvox bench suite=step``: ours alone, in three columns."""

from __future__ import annotations

from typing import Any

from warpvox.bench.bodies import one_body
from warpvox.bench.check import against_scalar
from warpvox.bench.report import Report, spread
from warpvox.bench.subject import Subject, measure

__all__ = ["HEADINGS", "run", "unit"]

HEADINGS = {"step": "step only", "inference": "with inference", "training": "with training"}


def unit(device: str) -> str:
    """What rates are per."""
    return "second of CPU time" if device == "cpu" else "second"


def run(config: Any, report: Report) -> dict[str, Any]:
    """Rates of the columns asked for."""
    with report.status("checking, then measuring"):
        subject = Subject(config, config.task, one_body(config), config.num_envs)
        error = against_scalar(subject.env, config.seed)
        subject.settle()
        rates = measure(subject, config.columns, config.repeats)
    report.note(f"Checked: within {error:.1e} of one environment alone in float64.")
    row = [f"{config.num_envs} environments, {config.dtype}, {config.device}"]
    report.table(
        f"{config.task}, control steps per {unit(config.device)}",
        ["", *(HEADINGS[column] for column in config.columns)],
        [[*row, *(spread(rates[column]) for column in config.columns)]],
    )
    return {"task": config.task, "check_error": error, "steps": subject.steps, "rates": rates}
