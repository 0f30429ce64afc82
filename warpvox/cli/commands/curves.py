"""``warpvox curves``: draws learning curves of runs as one picture, and writes their numbers as CSV."""

import dataclasses
from collections.abc import Collection

from rich.console import Console
from rich.table import Table

from warpvox.algos.find import find_runs, find_searches
from warpvox.algos.report.learning_curves import (
    AXES,
    SUFFIXES,
    curves_of,
    curves_of_searches,
    evaluations_of,
    labelled,
    write_curves,
)
from warpvox.algos.report.members import read_members
from warpvox.algos.statistics import LEVEL, mean_interval
from warpvox.checks import check_choice
from warpvox.cli.run_groups import group_runs
from warpvox.configs.show import CurvesConfig
from warpvox.errors import ConfigError, RunError, listing
from warpvox.io.console import echo, literal
from warpvox.io.writing import check_suffix
from warpvox.runs import Run


def run(config: CurvesConfig, given: Collection[str], console: Console) -> None:
    """Draw learning curves of runs, write their numbers as CSV, and print a table of the last and best returns."""
    check_suffix("file", config.file, SUFFIXES, ConfigError)

    # Curves of searches, or of trainings by task
    young = []
    searches = find_searches(config.runs, config.output_dir)
    if searches:
        check_choice("x of design searches", config.x, ("steps", "evaluations"))
        members = [one for one in read_members(searches) if len(one.best)]
        if not members:
            raise RunError("None of the design searches has evaluated a design yet: there is nothing to draw.")
        panels = curves_of_searches(members, config.x)
    else:
        check_choice("x of trainings", config.x, ("steps", "elapsed", "iteration"))
        named = find_runs(config.runs, config.output_dir)  # of several checkpoints of a run there is one curve
        found = list({one.folder.resolve(): dataclasses.replace(one, checkpoint=None) for one in named}.values())
        tasks: dict[str, list[Run]] = {}
        for each_run in found:
            if evaluations_of(each_run):
                tasks.setdefault(str(each_run.config["task"]), []).append(each_run)
            else:
                young.append(each_run.folder.name)
        if not tasks:
            raise RunError(f"The run {found[0].folder} has no evaluation yet: there is nothing to draw.")
        panels = {task: curves_of(group_runs(runs), config.x) for task, runs in tasks.items()}

    path = write_curves(panels, config.file, config.x, (config.size[0], config.size[1]))

    # Table: end of the curves, and best evaluations, over the runs of each group
    percent = f"{100 * LEVEL:g} %"
    table = Table(title=literal(f"deterministic return, mean of n runs [{percent} interval, Student's t]"))
    table.title_justify = "left"
    for heading in ("settings", "n", AXES[config.x], "last return", "best return"):
        table.add_column(heading, justify="left" if heading == "settings" else "right", overflow="fold")
    for label, curve in labelled(panels):
        last = mean_interval([points[1, -1] for points in curve.runs])
        best = mean_interval([points[1].max() for points in curve.runs])
        end = f"{max(points[0, -1] for points in curve.runs):,.0f}"
        table.add_row(*map(literal, (label, len(curve.runs), end, last, best)))
    console.print(table)
    if young:
        echo(console, f"left out, without an evaluation yet: {listing(young)}")
    echo(console, f"curves: {path}\ntable: {path.with_suffix('.csv')}")
