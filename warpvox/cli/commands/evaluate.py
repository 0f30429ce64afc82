"""``warpvox evaluate``: evaluates trained policies, with confidence intervals and comparisons."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from warpvox.algos.find import find_runs
from warpvox.algos.protocols import NOMINAL
from warpvox.algos.statistics import Interval, mean_interval
from warpvox.cli.run_groups import group_runs
from warpvox.code import Code
from warpvox.configs.show import EvaluateConfig
from warpvox.design import zoo_tasks
from warpvox.errors import ConfigError, WarpvoxError, counted
from warpvox.io.console import echo, literal
from warpvox.io.text import shown
from warpvox.io.writing import to_yaml, write_table
from warpvox.runs import ZOO, as_name, new_folder, write_summary

if TYPE_CHECKING:
    from warpvox.algos.training.policy_table import Judged


def run(config: EvaluateConfig, given: Collection[str], console: Console) -> Path:
    """Evaluate trained runs, print and write the tables of returns, and return the folder of the results.

    Of several runs those that cannot be evaluated are left out, with a line each.

    Raises:
        WarpvoxError: a run that does not exist, or none can be evaluated as asked; nothing is written then.
    """
    from warpvox.algos.training.loading import Playing
    from warpvox.algos.training.policy_table import evaluate_run, judged_groups, tables
    from warpvox.devices.startup import prepare

    if config.task is not None and not isinstance(config.task, Code):
        raise ConfigError("task names the code of runs of your own tasks (FILE.py:NAME); a run knows its task.")

    # Evaluate
    robots = [f"{ZOO}{name}" for name in (zoo_tasks() if config.zoo == ["all"] else config.zoo)]
    runs = ([] if robots else ["latest"]) if config.runs is None else config.runs
    found = find_runs([*runs, *robots], config.output_dir)
    names = ("checkpoint", "stochastic", "protocol", "seed", "device", "dtype", "arithmetic", "threads")
    playing = Playing(config.episodes, **{name: getattr(config, name) for name in (*names, "task", "policy")})
    rows = {}
    failed = []
    for number, each_run in enumerate(found):
        try:
            with console.status(f"evaluating run {number + 1} of {len(found)}"):
                prepare(config.torch_threads, config.seed)
                rows[id(each_run)] = evaluate_run(each_run, playing, config.designs, config.level)
        except WarpvoxError as error:
            failed.append((each_run, error))
    if not rows:
        raise failed[0][1]
    for each_run, error in failed:
        echo(console, f"left out: {shown(each_run.folder)}: {error}")

    # Compare
    found = [each_run for each_run in found if id(each_run) in rows]
    judged = judged_groups(group_runs(found), lambda each_run: rows[id(each_run)])
    tasks = {str(each_run.config["task"]) for each_run in found}
    place = as_name(tasks.pop()) if len(tasks) == 1 else "several"
    with new_folder(config.output_dir, "evaluate", place, config.name, to_yaml(config)) as folder:
        _print(judged, config, console)

        # Equal episodes with a body add no information: say so.
        policies = [row for several in rows.values() for row in several]
        alike = [row for row in policies if not row.drawn and len(row.independent) < len(row.returns)]
        if alike and config.protocol == NOMINAL:
            which = "all runs" if len(alike) == len(policies) else f"{len(alike)} of {len(policies)} runs"
            echo(
                console,
                f"The {config.episodes} episodes of {which} are one for each body: the task draws nothing at random and"
                " the policy is deterministic. One each says as much, stochastic=true samples actions.",
            )

        # The tables as CSV, and everything in summary.json
        contents = tables(judged, config.level)
        for name, table in contents.items():
            if table:
                columns = [column for column in table[0] if column != "returns"]
                write_table(folder / f"{name}.csv", columns, ([row[column] for column in columns] for row in table))
        first = [one for one in judged if one.disturbance == judged[0].disturbance]
        values = [value for one in first for row in one.rows for value in row.returns]
        summary: dict[str, Any] = {"command": "evaluate", "interval": "Student t, Welch"}
        for name in ("checkpoint", "stochastic", "protocol", "episodes", "seed", "level"):
            summary[name] = getattr(config, name)
        summary["mean_return"] = sum(values) / len(values)
        write_summary(folder, summary | contents)
    for name in ("runs.csv", "groups.csv", "comparisons.csv", "summary.json"):
        if (folder / name).is_file():
            echo(console, shown(folder / name))
    return folder


def _print(judged: list[Judged], config: EvaluateConfig, console: Console) -> None:
    """Print the returns of all runs, and the differences between groups."""
    from warpvox.algos.training.policy_table import compare

    # A section for each group: its runs, and their mean where there are several
    sections = []
    before = None
    for entry in judged:
        label = "" if entry.group is before else entry.group.label
        before = entry.group
        rows = []
        for each_run, row in zip(entry.group.runs, entry.rows, strict=True):
            folder = each_run.folder
            name = folder.name
            if folder.parent.name == "designs":  # of a search
                name = f"{folder.parents[1].name}/{name}"
            cells = (label, name, entry.disturbance, *_cells(row.interval))
            rows.append((*cells, f"{row.low_tenth:.3f}", row.episodes, "episodes"))
        if entry.over == "runs":
            interval = mean_interval(entry.values, config.level)
            rows.append(("", "all", entry.disturbance, *_cells(interval), "", str(interval.n), "runs"))
        sections.append(rows)
    percent = f"{100 * config.level:g} %"
    kind = "sampled actions" if config.stochastic else "deterministic"
    counts = sorted({len(row.returns) for entry in judged for row in entry.rows})
    many = counted(counts[0], "episodes") if len(counts) == 1 else f"{counts[0]} to {counts[-1]} episodes"
    headings = "settings", "run", "protocol", "mean", f"{percent} CI", "10 % quantile", "n", "over"
    _print_table(f"mean return, {kind}, {many} of each run", headings, sections, console)

    # Differences
    rows = []
    for first, second, interval in compare(judged, config.level):
        over = first.over if first.over == second.over else f"{first.over} and {second.over}"
        sizes = f"{len(first.values)}, {len(second.values)}"
        rows.append((first.group.label, second.group.label, first.disturbance, *_cells(interval), sizes, over))
    if rows:
        headings = "first", "less second", "protocol", "difference", f"{percent} CI", "n", "over"
        _print_table(f"differences of mean returns, Welch's {percent} interval", headings, [rows], console)
    echo(console, "Student's t: intervals over runs cover other trainings, those over episodes this policy alone.")


def _print_table(title: str, headings: Sequence[str], sections: list[list[tuple]], console: Console) -> None:
    """Print a table in sections; narrow consoles omit label columns with one value."""
    # Columns to show
    columns = list(zip(*(row for rows in sections for row in rows), strict=True))
    width = 0
    kept = []
    for heading, cells in zip(headings, columns, strict=True):
        width += max(map(len, (heading, *cells))) + 3
        is_label = heading in ("settings", "protocol", "n", "over")
        if not is_label or len({*cells} - {""}) != 1:
            kept.append(headings.index(heading))
    if width < console.width:
        kept = list(range(len(headings)))

    # The table
    table = Table(title=title, title_justify="left")
    for heading in (headings[k] for k in kept):
        right = heading in ("mean", "difference", "n")
        table.add_column(heading, justify="right" if right else "left", overflow="fold")
    for rows in sections:
        for row in rows:
            table.add_row(*(literal(row[k]) for k in kept))
        table.add_section()
    console.print(table)


def _cells(interval: Interval) -> tuple[str, str]:
    """Format the mean and interval of a table row."""
    known = math.isfinite(interval.low)
    return f"{interval.mean:.3f}", f"{interval.low:.3f} to {interval.high:.3f}" if known else ""
