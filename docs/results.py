"""Makes ``docs/results.md``; ``make results`` runs it. Not part of the library.

    python docs/results.py                       # the page: the zoo, docs/results/*.csv and envs/known_returns.csv
    python docs/results.py random                # what chance reaches, into envs/known_returns.csv; takes minutes
    python docs/results.py protocols [TASK ...]  # the zoo's robots in disturbed episodes, into docs/results; minutes

``tests/docs`` says when the page is out of date.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import trim_mean

import warpvox as wv
from warpvox.algos.evaluate import evaluate
from warpvox.algos.protocols import DISTURBANCES, NOMINAL
from warpvox.algos.statistics import mean_interval
from warpvox.envs.registry import FILE as KNOWN_RETURNS, KnownReturn, known_returns, task_ids
from warpvox.io import writing
from warpvox.io.reading import read_table
from warpvox.robots import Robot
from warpvox.robots.returns import EPISODES, judge_robust
from warpvox.system import processor_name
from warpvox.view.rollout import agent_of

FOLDER = Path(__file__).resolve().parent
KNOWN = FOLDER.parent / "envs" / KNOWN_RETURNS
DISTURBED, REPEATED = (FOLDER / "results" / f"{name}.csv" for name in ("protocols", "repeats"))
PAGE = FOLDER / "results.md"
DISTURBED_COLUMNS = ("task", "episodes", "n", "mean", "low", "high", "quantile_10", "processor")
"""``episodes``: the disturbance; ``low``, ``high``: the 95 % interval of the mean (Student's t)."""
NOISE = "noise"
"""Disturbance that robots are ranked by."""
RUNS = 5
"""Trainings, with different seeds, behind an interquartile mean."""
MANY = 6
"""From so many tasks on their number is given instead of their names."""
BODIES = 64
"""Random bodies of 5 x 5 cells, one episode each."""
Row = Mapping[str, str]
HEAD = """# Results

The best robots found so far, chosen by their mean return under noise (in other episodes than those shown), beside the
best published returns with bodies of 5 x 5 cells.
{sizes}
{summary}

| task | gait | under noise | IQM of 5 | published | by | nominal | sticky | start | sensors | control steps | time |
|---|---|---:|---:|---:|---|---:|---:|---:|---:|---:|---:|
"""
SUMMARY = """\
With normal noise of 1 % of the action range on every action, {held} of {known} robots are at or above the best
published return (mean of {episodes} episodes): {networks} with feedback, {gaits} open loop. With sticky actions
{sticky} are, after random starts {start}."""
NOTES = """
- *Under noise*: the mean of {episodes} episodes with its 95 % interval (Student's t), in bold where it is at or above
  the best published return. Normal noise with a deviation of {sigma:g} is added to each action, which is clipped to
  0.6 to 1.6. All [protocols](protocols.md) are in exact arithmetic (`python docs/results.py protocols`,
  {processor}); `docs/results/protocols.csv` has their intervals and 10 % quantiles.
- *IQM of 5*: the interquartile mean under noise (that of the middle three) of five trainings of this body with five
  seeds, among them this robot's, the one that it went on from or, of DownStepper-v0, one that went on from it
  (`python docs/repeats.py`, `docs/results/repeats.csv`), for {repeated} robots so far. **A robot is the best of some
  trials; this is what to expect of one.**
- *Nominal*: what `warpvox play zoo=TASK` repeats in the released simulator's arithmetic ([the zoo](zoo.md)), the
  mean of eight episodes in BidirectionalWalker-v0 and Catcher-v0, which draw at random. ▼ is below the best published
  return. Where noise takes most of it away, the robot shows what its body can do once, not what it does reliably.
- ○ is an open-loop [gait](zoo.md#gaits), whose actions depend on the time alone; all others are networks with
  feedback, which see what the task observes; *sensors* concerns them alone.
- *Control steps*, *time* (wall): of the whole search or training, and of those that it started from, on one or two
  cores of a busy machine, so that the time says no more than its order. A training for one body does not include the
  search that found it. `warpvox zoo task=TASK` shows all commands. Equal seeds give equal results on equal machines, by
  the commit of a command (`wv.zoo(TASK).about["start"]` has those of the earlier ones, as far as they are known): some
  keys have other names today, `zoo:TASK` is the robot of that time, and folders that a command names are not in the
  repository.

## Sources

Published returns are the best of anybody, of one undisturbed episode each; their protocols differ. A score of 1 in a
[comparison of searches](evaluation.md#comparing-searches) is such a return.

| method | source | protocol | tasks |
|---|---|---|---|
"""


def page(robots: Sequence[Robot], disturbed: Sequence[Row], repeated: Sequence[Row]) -> str:
    """``docs/results.md`` from the zoo's robots and the rows of two tables."""
    judged: dict[str, dict[str, Row]] = {}
    for row in disturbed:
        judged.setdefault(row["task"], {})[row["episodes"]] = row
    again: dict[str, list[float]] = {}
    for row in repeated:
        again.setdefault(row["task"], []).append(float(row["noise"]))
    again = {task: values for task, values in again.items() if len(values) == RUNS}
    shapes = {robot.task: "x".join(map(str, robot.body.shape)) for robot in robots}
    larger = [f"{task} ({shape})" for task, shape in shapes.items() if shape != "5x5"]
    sizes = f"Ours are as large, except those of {', '.join(larger)}.\n" if larger else ""
    lines = [_line(robot, judged[robot.task], again.get(robot.task)) for robot in robots]
    processors = ", ".join(sorted({row["processor"] for row in disturbed}))
    known = {"episodes": EPISODES, "sigma": DISTURBANCES[NOISE].noise, "processor": processors}
    notes = NOTES.format(**known, repeated=len(again))
    head = HEAD.format(sizes=sizes, summary=summary(robots, disturbed))
    return "".join([head, *lines, notes, *_sources(known_returns().values())])


def summary(robots: Sequence[Robot], disturbed: Sequence[Row]) -> str:
    """The sentences that README repeats."""
    best = {task: one.best for task, one in known_returns().items() if one.best is not None}
    ours = [robot for robot in robots if robot.task in best]
    held = [robot for robot in ours if robot.robust_return >= best[robot.task]]
    networks = sum(robot.has_feedback for robot in held)
    rows = [row for row in disturbed if row["task"] in best and float(row["mean"]) >= best[row["task"]]]
    others = {part: sum(row["episodes"] == part for row in rows) for part in ("sticky", "start")}
    counts = {"known": len(ours), "held": len(held), "networks": networks, "gaits": len(held) - networks}
    return SUMMARY.format(**counts, **others, episodes=EPISODES)


def _line(robot: Robot, judged: Mapping[str, Row], again: Sequence[float] | None) -> str:
    known, about = known_returns()[robot.task], robot.about
    best = math.inf if known.best is None else known.best
    below = "▼" if robot.mean_return < best < math.inf else ""
    noisy, high = (float(judged[NOISE][name]) for name in ("mean", "high"))
    bold = "**" if noisy >= best else ""
    cells = [robot.task, "" if robot.has_feedback else "○", f"{bold}{noisy:.3f}{bold} ± {high - noisy:.3f}"]
    cells.append(f"{trim_mean(again, 0.25):.3f}" if again else "")
    cells += ["" if known.best is None else f"{best:g}", known.method, f"{robot.mean_return:.3f}{below}"]
    cells += [f"{float(judged[part]['mean']):.3f}" if part in judged else "" for part in ("sticky", "start", "sensors")]
    cells += [f"{about['control_steps']:,}", duration(about["wall_s"])]
    return f"| {' | '.join(cells)} |\n"


def duration(seconds: float) -> str:
    """Hours and minutes."""
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02} min" if minutes >= 60 else f"{minutes} min"


def _sources(published: Iterable[KnownReturn]) -> list[str]:
    found: dict[tuple[str, str, str], list[str]] = {}
    for one in published:
        protocol = "; ".join(filter(None, (one.protocol, one.note)))
        found.setdefault((one.method or "none", one.source, protocol), []).append(one.task)
    lines = []
    for (method, source, protocol), tasks in sorted(found.items()):
        shown = ", ".join(tasks) if len(tasks) < MANY else f"{len(tasks)} tasks"
        lines.append(
            f"| {method} | {f'<{source}>' if source.startswith('https:') else source} | {protocol} | {shown} |\n"
        )
    return lines


def write_table(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write rows in the order of the tasks; columns are those of the first."""
    ordered = sorted(rows, key=lambda row: task_ids().index(row["task"]))
    writing.write_table(path, ordered[0], [row.values() for row in ordered])


def random_return(task: str) -> float:
    """The mean return of random bodies under actions that are uniform in each control step."""
    bodies = [wv.sample_design((5, 5), seed=seed) for seed in range(BODIES)]
    env = wv.make_vec(task, designs=bodies, num_envs=BODIES, seed=0, device="cpu", dtype="float64", auto_reset=False)
    return evaluate(env, agent_of("random", env)).mean_return


def measure_random() -> None:
    """Renew the column ``random``."""
    rows = {row["task"]: row for row in read_table(KNOWN)}
    for task in task_ids():
        rows[task]["random"] = f"{random_return(task):.3f}"
        print(task, rows[task]["random"], flush=True)
    write_table(KNOWN, rows.values())


def measure_disturbed(tasks: Sequence[str]) -> None:
    """Renew the rows of ``tasks`` in the table of returns in disturbed episodes.

    Raises:
        ValueError: a robot does not get what its entry records.
    """
    rows = [row for row in read_table(DISTURBED) if row["task"] not in tasks]
    for task in tasks:
        robot = wv.zoo(task)
        for part, returns in judge_robust(robot).items():
            if part == NOISE and returns != robot.about[NOISE]["returns"]:
                raise ValueError(
                    f"{task}: its entry records {robot.robust_return!r} under noise, not {np.mean(returns)!r}"
                )
            if part == NOMINAL:
                continue  # the page has that of the entry
            found = mean_interval(returns)
            values = [f"{value:.3f}" for value in (found.mean, found.low, found.high, np.quantile(returns, 0.1))]
            rows.append(dict(zip(DISTURBED_COLUMNS, (task, part, found.n, *values, processor_name()), strict=True)))
        print(task, flush=True)
    write_table(DISTURBED, rows)


if __name__ == "__main__":
    if sys.argv[1:2] == ["random"]:
        measure_random()
    elif sys.argv[1:2] == ["protocols"]:
        measure_disturbed(sys.argv[2:] or task_ids())
    else:
        writing.write_text(PAGE, page([*map(wv.zoo, task_ids())], read_table(DISTURBED), read_table(REPEATED)))
