"""Makes ``docs/results.md`` from committed data; ``make results`` runs it. Not part of the library.

    python docs/results.py                       # the page, from docs/results/*.csv and envs/known_returns.csv
    python docs/results.py export [FOLDER ...]   # the table from the zoo and from the design searches in folders
    python docs/results.py random                # what chance reaches, into envs/known_returns.csv; takes minutes
    python docs/results.py protocols [TASK ...]  # the zoo's robots in disturbed episodes, into docs/results; minutes

``export`` takes a robot of the zoo before a search: its return is exact and can be replayed. Of several searches of a
task the one with the best return stays, that of the table included. ``tests/docs`` says when the page is out of date.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import warpvox as wv
from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.codesign.archive import FILE as ARCHIVE, Archive, archives_in
from warpvox.algos.evaluate import evaluate
from warpvox.algos.protocols import DISTURBANCES, NOMINAL
from warpvox.algos.report.benchmark import duration
from warpvox.algos.report.members import SearchResult, read_members
from warpvox.algos.statistics import interquartile_mean, mean_interval
from warpvox.cli.robot_entries import command_of
from warpvox.envs.registry import FILE as KNOWN_RETURNS, KnownReturn, known_returns, task_ids
from warpvox.io import writing
from warpvox.io.reading import read_table
from warpvox.robots import Gait, zoo_tasks
from warpvox.robots.returns import EPISODES, judge_robust
from warpvox.runs import find_codesign
from warpvox.system import processor_name

FOLDER = Path(__file__).resolve().parent
KNOWN = FOLDER.parent / "envs" / KNOWN_RETURNS
TABLE, DISTURBED, REPEATED = (FOLDER / "results" / f"{name}.csv" for name in ("returns", "protocols", "repeats"))
PAGE = FOLDER / "results.md"
COLUMNS = (
    *("task", "return", "episodes", "evaluation", "shape", "policy", "control_steps", "seconds", "date", "processor"),
    *("commit", "command"),
)
"""``return``: of the robot of the zoo; ``evaluation``: the best deterministic evaluation of the search; ``policy``:
``gait``, open loop; else a network, without a name."""
DISTURBED_COLUMNS = ("task", "episodes", "n", "mean", "low", "high", "quantile_10", "processor")
"""``episodes``: the disturbance; ``low``, ``high``: the 95 % interval of the mean (Student's t)."""
NOISE = "noise"
"""Disturbance that robots are ranked by."""
RUNS = 5
"""Trainings, with different seeds, behind an interquartile mean."""
GAIT = "gait"
MANY = 6
"""From so many tasks on their number is given instead of their names."""
BODIES = 64
"""Random bodies of 5 x 5 cells, one episode each."""
Row = Mapping[str, str]
HEAD = """# Results

The best robots found so far, chosen by their mean return under noise, beside the best published returns with bodies
of 5 x 5 cells.
{sizes}
{summary}

| task | gait | under noise | IQM of 5 | published | by | nominal | sticky | start | sensors | control steps | time |
|---|---|---:|---:|---:|---|---:|---:|---:|---:|---:|---:|
"""
SUMMARY = """\
With normal noise of 1 % of the action range on every action, {held} of {known} robots are at or above the best
published return (mean of {episodes} episodes); {networks} of the {known} have feedback, {gaits} are open loop."""
NOTES = """
- *Under noise*: the mean of {episodes} episodes with its 95 % interval (Student's t), in bold where it is at or above
  the best published return. Normal noise with a deviation of {sigma:g} is added to each action, which is clipped to
  0.6 to 1.6. All [protocols](protocols.md) are in exact arithmetic (`python docs/results.py protocols`,
  {processor}); `docs/results/protocols.csv` has their intervals and 10 % quantiles.
- *IQM of 5*: the interquartile mean under noise of five trainings of this body with five seeds, this robot's among
  them (`python docs/repeats.py`, `docs/results/repeats.csv`), for {repeated} robots so far. **A robot is the best of
  some trials; this is what to expect of one.**
- *Nominal*: what `warpvox play zoo=TASK` repeats in the released simulator's arithmetic ([the zoo](zoo.md)), the
  mean of eight episodes in BidirectionalWalker-v0 and Catcher-v0, which draw at random. ▼ is below the best published
  return. Where noise takes most of it away, the robot shows what its body can do once, not what it does reliably.
- ○ is an open-loop [gait](zoo.md#gaits), whose actions depend on the time alone; all others are networks with
  feedback, which see what the task observes; *sensors* concerns them alone.
- *Control steps*, *time* (wall): of the whole search or training, and of those that it started from; one thread of a
  busy machine, so that the time is an upper bound. A training for one body does not include the search that found it.
  `warpvox zoo task=TASK` shows its commands, `docs/results/returns.csv` the last of each robot with commit and
  processor. Equal seeds give equal results on equal machines, by the commit of a command: some keys have other names
  today, and folders that a command names are not in the repository.

## Sources

Published returns are the best of anybody, of one undisturbed episode each; their protocols differ. A score of 1 in a
[comparison of searches](evaluation.md#comparing-searches) is such a return.

| method | source | protocol | tasks |
|---|---|---|---|
"""


def page(rows: Sequence[Row], disturbed: Sequence[Row] = (), repeated: Sequence[Row] = ()) -> str:
    """``docs/results.md`` from the rows of the three tables."""
    ours, published = {row["task"]: row for row in rows}, known_returns()
    judged = {(row["task"], row["episodes"]): row for row in disturbed}
    again: dict[str, list[float]] = {}
    for row in repeated:
        again.setdefault(row["task"], []).append(float(row["noise"]))
    again = {task: values for task, values in again.items() if len(values) == RUNS}
    larger = [f"{row['task']} ({row['shape']})" for row in rows if row["shape"] not in ("", "5x5")]
    sizes = f"Ours are as large, except those of {', '.join(larger)}.\n" if larger else ""
    lines = [
        _line(one, ours.get(task), {part: judged.get((task, part)) for part in DISTURBANCES}, again.get(task))
        for task, one in published.items()
    ]
    processors = ", ".join(sorted({row["processor"] for row in disturbed}))
    known = {"episodes": EPISODES, "sigma": DISTURBANCES[NOISE].noise, "processor": processors}
    notes = NOTES.format(**known, repeated=len(again))
    head = HEAD.format(sizes=sizes, summary=summary(rows, disturbed))
    return "".join([head, *lines, notes, *_sources(published.values())])


def summary(rows: Sequence[Row], disturbed: Sequence[Row]) -> str:
    """The sentence that README repeats."""
    best = {task: one.best for task, one in known_returns().items() if one.best is not None}
    ours = {row["task"]: row for row in rows if row["task"] in best}
    gaits = sum(row["policy"] == GAIT for row in ours.values())
    noisy = [row for row in disturbed if row["task"] in ours and row["episodes"] == NOISE]
    return SUMMARY.format(
        known=len(ours),
        gaits=gaits,
        networks=len(ours) - gaits,
        held=sum(float(row["mean"]) >= best[row["task"]] for row in noisy),
        episodes=EPISODES,
    )


def _line(one: KnownReturn, row: Row | None, judged: Mapping[str, Row | None], again: Sequence[float] | None) -> str:
    mark, noisy, expected, undisturbed, steps, seconds = "", "-", "", "-", "", ""
    best = "" if one.best is None else f"{one.best:g}"
    if row is not None:
        value = float(row["return"] or row["evaluation"])
        below = "▼" if one.best is not None and value < one.best else ""
        mark = "○" * (row["policy"] == GAIT)
        undisturbed = (f"{value:.3f}" if row["return"] else f"*{value:.3f}*") + below
        steps = f"{int(row['control_steps']):,}"
        seconds = duration(float(row["seconds"])) if row["seconds"] else ""
    if found := judged[NOISE]:
        mean, high = float(found["mean"]), float(found["high"])
        bold = "**" * (one.best is not None and mean >= one.best)
        noisy = f"{bold}{mean:.3f}{bold} ± {high - mean:.3f}"
        if again:
            expected = f"{interquartile_mean({one.task: np.array(again)}):.3f}"
    others = [
        f"{float(found['mean']):.3f}" if (found := judged[part]) else "" for part in ("sticky", "start", "sensors")
    ]
    cells = [one.task, mark, noisy, expected, best, one.method, undisturbed, *others, steps, seconds]
    return f"| {' | '.join(cells)} |\n"


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


def export(folders: Sequence[Path], before: Sequence[Row] = ()) -> list[dict[str, str]]:
    """The rows of the zoo's robots and of the best search of every other task, as text.

    Args:
        folders: that design searches lie in; those that have not ended, and those by the paper's rules, do not count.
        before: rows that stay unless there is a better search, or a robot.
    """
    rows = {row["task"]: {name: row.get(name, "") for name in COLUMNS} for row in before}
    robots = [task for task in zoo_tasks() if task in task_ids()]
    members = [one for folder in folders for one in read_members(archives_in(folder)) if _counts(one)]
    best = {one.task: one for one in sorted(members, key=lambda one: one.winner.fitness)}
    for task, member in best.items():
        held = rows.get(task)
        if task not in robots and (held is None or member.winner.fitness > float(held["evaluation"] or "-inf")):
            rows[task] = _search(member)
    return list((rows | {task: _robot(task) for task in robots}).values())


def _counts(member: SearchResult) -> bool:
    done = member.summary.get("status") == "done" and member.winner is not None
    return done and member.task in task_ids() and member.settings.get("rules") == "evogym"


def _search(member: SearchResult) -> dict[str, str]:
    with Archive.read(member.folder / ARCHIVE) as archive:
        date = archive.created_at[:10]
    values = {"evaluation": f"{member.winner.fitness:.9g}", "control_steps": int(member.steps[-1])}
    if member.winner.policy is not None:
        policy = load_checkpoint(member.folder / member.winner.policy)["policy"]
        values |= {"policy": GAIT} if policy.get("gait") else {}
    values |= {} if member.seconds is None else {"seconds": f"{member.seconds:.0f}"}
    values |= {name: member.summary.get(name) or "" for name in ("processor", "commit")}
    command = command_of("codesign", find_codesign(str(member.folder), "").config)
    return _row(member.task, member.winner.candidate.body, command, date, **values)


def _robot(task: str) -> dict[str, str]:
    robot = wv.zoo(task)
    about = robot.about
    values = {"return": repr(about["return"]), "episodes": len(about["returns"])}
    values |= {"policy": GAIT} if isinstance(robot.policy, Gait) else {}
    values |= {
        "control_steps": about["control_steps"],
        "seconds": "" if about["wall_s"] is None else f"{about['wall_s']:.0f}",
    }
    values |= {"evaluation": f"{about['fitness']:.9g}"} if "fitness" in about else {}
    processors = {one.get("processor") for one in (about, *about.get("start", ()))}
    values |= {"processor": ", ".join(sorted(processors - {None})), "commit": about.get("commit") or ""}
    return _row(task, robot.body, about["command"], about["date"], **values)


def _row(task: str, body: Any, command: str, date: str, **values: object) -> dict[str, str]:
    known_values = {"task": task, "shape": "x".join(map(str, body.shape)), "command": command, "date": date} | values
    return {name: str(known_values.get(name, "")) for name in COLUMNS}


def random_return(task: str) -> float:
    """The mean return of random bodies under actions that are uniform in each control step."""
    import torch

    bodies = [wv.sample_design((5, 5), seed=seed) for seed in range(BODIES)]
    env = wv.make_vec(task, designs=bodies, num_envs=BODIES, seed=0, device="cpu", auto_reset=False)
    draws = torch.Generator().manual_seed(0)
    low, high = 0.6, 1.6

    def policy(obs: Any) -> Any:
        return low + (high - low) * torch.rand((env.num_envs, env.num_actions), generator=draws)

    return evaluate(env, policy).mean_return


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
    elif sys.argv[1:2] == ["export"]:
        write_table(TABLE, export([Path(text) for text in sys.argv[2:]], read_table(TABLE)))
    else:
        writing.write_text(PAGE, page(*map(read_table, (TABLE, DISTURBED, REPEATED))))
