"""Generator of docs/results.md, and the measurements behind it.

python -m lab.zoo.results                       # the page: the zoo, the tables here and envs/known_returns.csv
python -m lab.zoo.results protocols [TASK ...]  # the zoo's robots in disturbed episodes, into protocols.csv
python -m lab.zoo.results random [TASK ...]     # what chance reaches, into envs/known_returns.csv
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import warpvox as wv
from warpvox.algos.robots import Robot
from warpvox.envs.registry import KnownReturn, known_returns

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
PAGE = ROOT / "docs" / "results.md"
KNOWN_RETURNS = ROOT / "envs" / "known_returns.csv"
DISTURBED = FOLDER / "protocols.csv"
"""Table of returns in disturbed episodes; ``low`` and ``high`` are the 95 % interval of the mean."""
REPEATED = FOLDER / "repeats.csv"
"""Table of repeated trainings with several seeds, and their mean returns under noise."""
EPISODES = 32
"""Number of episodes for each disturbance."""
NOISE_DEVIATION = 0.01
"""Standard deviation of the noise on each action, in units of target length."""
RUNS = 5
"""Number of trainings for an interquartile mean."""
MANY = 6
"""Number of tasks from which a count replaces their names."""
BODIES = 64
"""Number of random 5 x 5 bodies, with one episode each."""
Row = Mapping[str, str]
TEXT = FOLDER / "results_page.txt"
"""Text of the page without its tables."""
SUMMARY = """\
Under 1 % Gaussian action noise, {held} of {known} robots match or beat the best published return (mean of {episodes}
episodes): {networks} networks with feedback and {gaits} open-loop gaits (fixed rhythms without feedback). If actions
are repeated at random, {sticky} do; if episodes begin with random actions, {start}."""


def read_arguments(words: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("page", "protocols", "random"), default="page")
    parser.add_argument("tasks", nargs="*", help="tasks that are measured; without, all")
    return parser.parse_args(words)


def page(robots: Sequence[Robot], disturbed: Sequence[Row], repeated: Sequence[Row]) -> str:
    """Build ``docs/results.md`` from the zoo's robots and two tables."""
    by_task: dict[str, dict[str, Row]] = {}
    for row in disturbed:
        by_task.setdefault(row["task"], {})[row["episodes"]] = row
    larger = []
    for robot in robots:
        rows, columns = robot.body.shape
        if (rows, columns) != (5, 5):
            larger.append(f"{robot.task} ({rows} x {columns})")
    sizes = f"Bodies are 5 x 5 cells, except those of {', '.join(larger)}." if larger else "Bodies are 5 x 5 cells."

    return TEXT.read_text(encoding="utf-8").format(
        sizes=sizes,
        summary=summary(robots, disturbed),
        robots="".join(_line(robot, by_task[robot.task]["noise"]) for robot in robots),
        episodes=EPISODES,
        sigma=NOISE_DEVIATION,
        repeated=len(repeated_means(repeated)),
        sources="".join(_sources(known_returns().values())),
    )


def summary(robots: Sequence[Robot], disturbed: Sequence[Row]) -> str:
    """Build the sentences for README."""
    best = {task: one.best for task, one in known_returns().items() if one.best is not None}
    ours = [robot for robot in robots if robot.task in best]
    held = [robot for robot in ours if robot.robust_return >= best[robot.task]]
    networks = sum(robot.has_feedback for robot in held)
    rows = [row for row in disturbed if row["task"] in best and float(row["mean"]) >= best[row["task"]]]
    return SUMMARY.format(
        known=len(ours),
        held=len(held),
        episodes=EPISODES,
        networks=networks,
        gaits=len(held) - networks,
        sticky=sum(row["episodes"] == "sticky" for row in rows),
        start=sum(row["episodes"] == "start" for row in rows),
    )


def repeated_means(rows: Sequence[Row]) -> dict[str, float]:
    """Compute the interquartile mean under noise of each fully repeated task."""
    returns: dict[str, list[float]] = {}
    for row in rows:
        returns.setdefault(row["task"], []).append(float(row["noise"]))
    return {task: float(np.mean(sorted(values)[1:-1])) for task, values in returns.items() if len(values) == RUNS}


def _line(robot: Robot, noise: Row) -> str:
    known = known_returns()[robot.task]
    mean = float(noise["mean"])
    half = float(noise["high"]) - mean
    bold = "**" if known.best is not None and mean >= known.best else ""
    published = "none" if known.best is None else f"{known.best:g}, {known.method}"
    kind = "network" if robot.has_feedback else "gait"
    return f"| {robot.task} | {bold}{mean:.3f}{bold} ± {half:.3f} | {published} | {kind} |\n"


def _sources(published: Iterable[KnownReturn]) -> list[str]:
    found: dict[tuple[str, str, str], list[str]] = {}
    for one in published:
        protocol = "; ".join(filter(None, (one.protocol, one.note)))
        found.setdefault((one.method or "none", one.source, protocol), []).append(one.task)
    lines = []
    for (method, source, protocol), tasks in sorted(found.items()):
        shown = ", ".join(tasks) if len(tasks) < MANY else f"{len(tasks)} tasks"
        place = f"<{source}>" if source.startswith("https:") else source
        lines.append(f"| {method} | {place} | {protocol} | {shown} |\n")
    return lines


def read_table(path: Path) -> list[Row]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write_table(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows in the order of the tasks, with the columns of the first row."""
    ordered = sorted(rows, key=lambda row: wv.task_ids().index(row["task"]))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(ordered[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(ordered)


def random_return(task: str) -> float:
    """Measure the mean return of random bodies under uniformly random actions."""
    bodies = [wv.sample_design((5, 5), seed=seed) for seed in range(BODIES)]
    env = wv.make_vec(task, designs=bodies, num_envs=BODIES, seed=0, device="cpu", dtype="float64", auto_reset=False)
    return float(wv.record(env, "random").returns[-1].mean())


def measure_random(tasks: Sequence[str]) -> None:
    """Measure the column ``random`` of the known returns again."""
    rows = {row["task"]: dict(row) for row in read_table(KNOWN_RETURNS)}
    for task in tasks:
        rows[task]["random"] = f"{random_return(task):.3f}"
        print(task, rows[task]["random"], flush=True)
    write_table(KNOWN_RETURNS, rows.values())


def disturbed_rows(task: str) -> list[Row]:
    """Measure a zoo robot under each disturbance and return rows.

    Raises:
        ValueError: the robot does not get the returns that its entry records.
    """
    robot, rows = wv.zoo(task), []
    for found in wv.evaluate(f"zoo:{task}", protocol="robust", episodes=EPISODES, device="cpu"):
        if found.disturbance == "nominal":
            continue  # the page has that of the entry
        if found.disturbance == "noise" and round(found.mean, 9) != robot.robust_return:
            raise ValueError(f"{task}: its entry records {robot.robust_return!r} under noise, not {found.mean!r}")
        interval = found.interval
        row = {"task": task, "episodes": found.disturbance, "n": str(interval.n)}
        values = {"mean": interval.mean, "low": interval.low, "high": interval.high, "quantile_10": found.low_tenth}
        rows.append(row | {name: f"{value:.3f}" for name, value in values.items()})
    return rows


def measure_disturbed(tasks: Sequence[str]) -> None:
    """Measure ``tasks`` under all disturbances and update the table."""
    rows = [row for row in read_table(DISTURBED) if row["task"] not in tasks]
    for task in tasks:
        rows += disturbed_rows(task)
        print(task, flush=True)
    write_table(DISTURBED, rows)


def main(given: argparse.Namespace) -> None:
    tasks = given.tasks or wv.task_ids()
    if given.what == "random":
        measure_random(tasks)
    elif given.what == "protocols":
        measure_disturbed(tasks)
    else:
        text = page([wv.zoo(task) for task in wv.task_ids()], read_table(DISTURBED), read_table(REPEATED))
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(read_arguments())
