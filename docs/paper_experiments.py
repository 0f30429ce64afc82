"""Makes the experiments of Evolution Gym's paper and the page with their numbers. Not part of the library.

    python docs/paper_experiments.py run [--minutes 60] [--folder outputs/paper]   # design searches that are not done
    python docs/paper_experiments.py                                               # the page of the committed tables

Several processes may run the searches of one folder: each is made by one of them, and what was interrupted is gone on
with. Their tables ``paper_members.csv`` and ``paper_curves.csv`` lie in the folder and hold the committed rows as well:
copied to ``docs/results`` they are what the page is made of. ``tests/docs`` says when it is out of date.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import os
import signal
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from warpvox.algos.codesign.robots import robots_of
from warpvox.algos.interrupt import terminable
from warpvox.algos.report.charts import COLOURS, PANEL, Series, chart, sheet
from warpvox.algos.report.members import read_members
from warpvox.algos.statistics import improvement, interquartile_mean, interval
from warpvox.algos.suite.members import DONE, Member
from warpvox.algos.suite.run import FAILED, make_member
from warpvox.cli.config import load
from warpvox.cli.suite_plan import BENCHMARK10, plan
from warpvox.envs.known_returns import known_returns
from warpvox.envs.registry import task_ids
from warpvox.errors import RunError
from warpvox.io.writing import claimed, write_table, write_text
from warpvox.robots.returns import recorded
from warpvox.runs import read_summary

FOLDER = Path(__file__).resolve().parent
RESULTS, PAGE, CHART = FOLDER / "results", FOLDER / "paper_experiments.md", FOLDER / "images" / "paper_experiments.svg"
MEMBERS, CURVES = "paper_members.csv", "paper_curves.csv"
STEPS = 20_000_000
"""Control steps of a search."""
SETTINGS = ["training=fast"]
"""Keys of all searches, besides those of ``suite=paper``."""
SEARCHES = {"ga": "GA", "bo_paper": "BO", "cppn_neat": "CPPN-NEAT"}
KEY = ("task", "search", "seed")
COLUMNS = (
    *KEY,
    *("evaluations", "control_steps", "generations", "return", "noise", "seconds", "processor", "commit"),
)
"""``return``: of the best design, in exact arithmetic; ``noise``: its mean in disturbed episodes."""
FRACTIONS = [k / 20 for k in range(1, 21)]
AXES = ("control_steps", "evaluations")
CURVE_COLUMNS = (*KEY, "axis", *map("{:g}".format, FRACTIONS))
"""The best fitness so far at fractions of the budget in control steps, or in evaluations."""
JUDGED = ("return", "noise")

Row = Mapping[str, str]


def members() -> list[Member]:
    """All design searches in the order in which they are made, so that a cut leaves something to compare."""

    def planned(*words: str) -> list[Member]:
        common = ["suite=paper", f"control_steps={STEPS}", f"codesign=[{','.join(SETTINGS)}]", "device=cpu"]
        return plan(load("suite", [*common, *words]))

    others = [one for one in planned("tasks=[all]", "searches=[ga]") if one.task not in BENCHMARK10]
    return sorted([*planned(), *others], key=lambda one: one.seed)


def read_rows(name: str, folder: Path = RESULTS) -> list[Row]:
    """The committed rows of a table and those in ``folder``, which replace them."""
    files = [path / name for path in dict.fromkeys((RESULTS, folder)) if (path / name).is_file()]
    rows = [row for file in files for row in csv.DictReader(file.read_text(encoding="utf-8").splitlines())]
    return list({(*map(row.get, KEY), row.get("axis")): row for row in rows}.values())


def done(folder: Path) -> set[tuple[str, str, int]]:
    """Keys of the members in the tables."""
    return {(row["task"], row["search"], int(row["seed"])) for row in read_rows(MEMBERS, folder)}


def run(folder: Path, minutes: float | None = None) -> None:
    """Make the members that are not done; an interrupt, or the end of the time, leaves one to be gone on with."""
    if minutes is not None:
        timer = threading.Timer(60 * minutes, os.kill, (os.getpid(), signal.SIGTERM))
        timer.daemon = True
        timer.start()
    with terminable(), suppress(KeyboardInterrupt):
        for member in members():
            place = folder / member.folder
            place.mkdir(parents=True, exist_ok=True)
            try:
                with claimed(place):  # not for the search's own folder, which it claims itself
                    if member.key in done(folder):
                        continue
                    print(*member.key, flush=True)
                    outcome = make_member(dataclasses.replace(member.settings, threads=1), place / "search")
                    if outcome["status"] == DONE:
                        store(folder, member, place / "search")
                    elif outcome["status"] != FAILED:
                        break
            except RunError as error:  # another process makes it
                print(error, flush=True)


def store(folder: Path, member: Member, place: Path) -> None:
    """Judge the best design of a search that is done, and add its rows to the tables."""
    summary, about = read_summary(place), recorded(next(robots_of(place, 1)), {}).about
    (found,) = read_members([place])
    last = member.settings.search.max_evaluations
    places = {
        "control_steps": [found.best_at(share * STEPS) for share in FRACTIONS],
        "evaluations": [found.best[: max(1, int(share * last + 1e-9))].max() for share in FRACTIONS],
    }
    facts = {"control_steps": "steps", "seconds": "elapsed_seconds"}
    values = {name: summary.get(facts.get(name, name)) for name in COLUMNS[len(KEY) :]}
    values |= {"return": about["return"], "noise": about["noise"]["return"]}
    curves = [(*member.key, axis, *(f"{value:.6g}" for value in places[axis])) for axis in AXES]
    added = {CURVES: curves, MEMBERS: [(*member.key, *values.values())]}
    while True:
        with suppress(RunError), claimed(folder):
            for name, rows in added.items():  # the curves first: a member with a row is done
                columns = COLUMNS if name == MEMBERS else CURVE_COLUMNS
                every = [*(row.values() for row in read_rows(name, folder)), *rows]
                write_table(folder / name, columns, sorted(map(list, every), key=_order))
            return
        time.sleep(0.1)


def _order(row: Sequence[object]) -> tuple[int, ...]:
    task, search, seed = row[: len(KEY)]
    return task_ids().index(str(task)), list(SEARCHES).index(str(search)), int(str(seed))


HEAD = """# The paper's experiments in numbers

The paper shows its experiments as curves: the genetic algorithm (GA) on all 32 tasks (Figure 35), and GA, Bayesian
optimisation (BO) and CPPN-NEAT on ten of them. Here they are design searches with {steps} million control steps each.
**{done} of {all} searches are done**: {ga} of {ga_all} with GA on all tasks, {ten} of {ten_all} of the comparison on
ten, {seeds} seeds each (GA on the ten counts in both).

Searches, populations and shapes are those of the paper's Tables 2 to 5 (`search=ga`, `bo_paper` and `cppn_neat`,
[search](search.md)). Each body is trained for as many control steps as in the paper, 512,000, but with `training=fast`;
tasks are those of the [release](paper.md). **The budget is much smaller than the paper's**: {designs} bodies, where the
paper has 250, 500 or 750. A first generation of {population} is random, and the search chooses {rest} more. So the
numbers say what such a budget brings, and little about the searches with a larger one.
"""
PICTURE = """
![Best return over control steps, a panel a task](images/{name})

The best fitness so far, in the float32 arithmetic of the searches: mean and range of the seeds that are done.
"""
GA_TABLE = """
## GA on all tasks

| task | seeds | nominal | under noise | best published | by |
|---|---:|---:|---:|---:|---|
"""
COMPARED = """
## GA, BO and CPPN-NEAT

Seeds that all three have done; means, the best in bold.

| task | seeds | {names} | {noisy} |
|---|---:|{rule}
"""
NOTES = """
*Nominal* is the return of a search's best body in exact arithmetic, as an entry of [the zoo](zoo.md) states it; *under
noise* its mean in 32 [episodes with noise on the actions](protocols.md). Means over seeds, in brackets the lowest and
the highest. Published returns are the best of anybody ([results](results.md#sources)). A search took {minutes} minutes
in the median, one thread of a busy machine ({processors}).

    python docs/paper_experiments.py run   # makes searches that are not done; may run several times at once
    python docs/paper_experiments.py       # this page, of docs/results/paper_members.csv and paper_curves.csv
"""


def page(rows: Sequence[Row]) -> str:
    """``docs/paper_experiments.md`` from the rows of the members that are done."""
    every, finished = members(), {(row["task"], row["search"], int(row["seed"])): row for row in rows}
    ten = [one.key for one in every if one.task in BENCHMARK10]
    ga = [one.key for one in every if one.search == "ga"]
    search = every[0].settings.search
    parts = [
        HEAD.format(
            steps=f"{STEPS / 1e6:g}",
            done=len(finished),
            all=len(every),
            ga=_count(ga, finished),
            ga_all=len(ga),
            ten=_count(ten, finished),
            ten_all=len(ten),
            seeds=len({one.seed for one in every}),
            designs=search.max_evaluations,
            population=search.population,
            rest=search.max_evaluations - search.population,
        )
    ]
    if finished:
        parts += [PICTURE.format(name=CHART.name), GA_TABLE, *_ga_lines(finished), *_comparison(finished)]
        minutes = np.median([float(row["seconds"]) / 60 for row in rows])
        processors = ", ".join(sorted({row["processor"] for row in rows}))
        parts.append(NOTES.format(minutes=f"{minutes:.0f}", processors=processors))
    return "".join(parts)


Finished = Mapping[tuple[str, str, int], Row]


def _count(keys: Sequence[tuple[str, str, int]], finished: Collection[tuple[str, str, int]]) -> int:
    return sum(key in finished for key in keys)


def _values(
    finished: Finished, task: str, search: str, judged: str, seeds: Collection[int] | None = None
) -> np.ndarray:
    """Returns of a search on a task, by seed: of all that are done, or of ``seeds``."""
    found = {key[2]: row for key, row in sorted(finished.items()) if key[:2] == (task, search)}
    return np.array([float(row[judged]) for seed, row in found.items() if seeds is None or seed in seeds])


def _ga_lines(finished: Finished) -> list[str]:
    lines = []
    for task, known in known_returns().items():
        if len(values := _values(finished, task, "ga", JUDGED[0])):
            cells = [_range(_values(finished, task, "ga", judged)) for judged in JUDGED]
            best = "" if known.best is None else f"{known.best:g}"
            lines.append(f"| {task} | {len(values)} | {' | '.join(cells)} | {best} | {known.method} |\n")
    return lines


def _range(values: np.ndarray) -> str:
    return f"{values.mean():.3f}" + (f" ({values.min():.3f} to {values.max():.3f})" if len(values) > 1 else "")


def _comparison(finished: Finished) -> list[str]:
    """The three searches on the tasks on which all of them have done a seed."""
    seeds = {task: set.intersection(*(_seeds(finished, task, search) for search in SEARCHES)) for task in BENCHMARK10}
    tasks = [task for task in BENCHMARK10 if seeds[task]]
    if not tasks:
        return []
    values = {
        judged: {name: {t: _values(finished, t, name, judged, seeds[t]) for t in tasks} for name in SEARCHES}
        for judged in JUDGED
    }
    names, noisy = (" | ".join(f"{name}{more}" for name in SEARCHES.values()) for more in ("", " under noise"))
    lines = [COMPARED.format(names=names, noisy=noisy, rule="---:|" * 2 * len(SEARCHES))]
    wins: dict[str, list[str]] = {judged: [] for judged in JUDGED}
    for task in tasks:
        cells = []
        for judged in JUDGED:
            means = {name: values[judged][name][task].mean() for name in SEARCHES}
            best = max(means, key=means.__getitem__)
            wins[judged].append(best)
            cells += [f"**{mean:.3f}**" if name == best else f"{mean:.3f}" for name, mean in means.items()]
        lines.append(f"| {task} | {len(seeds[task])} | {' | '.join(cells)} |\n")
    return [*lines, *_scores(values), _verdict(wins, len(tasks))]


def _seeds(finished: Finished, task: str, search: str) -> set[int]:
    return {key[2] for key in finished if key[:2] == (task, search)}


def _scores(values: Mapping[str, Mapping[str, Mapping[str, np.ndarray]]]) -> list[str]:
    """Interquartile means of scores and probabilities of improvement, on tasks with a published return."""
    known = {task: one for task, one in known_returns().items() if one.best is not None}
    scores = {
        judged: {
            name: {task: known[task].score(runs) for task, runs in tasks.items() if task in known}  # by element
            for name, tasks in by_search.items()
        }
        for judged, by_search in values.items()
    }
    tasks = scores[JUDGED[0]]["ga"]
    if not tasks:
        return []
    lines = [
        f"\nInterquartile means of the [scores](evaluation.md#comparing-searches) on {len(tasks)} of these tasks with a"
        " published return (0 is chance, 1 that return), and the probability that a run of GA is better than one of the"
        " search, with 95 % bootstrap intervals where a task has several seeds.\n\n| search | nominal | under noise | GA better, nominal | GA better, under noise |\n"
        "|---|---:|---:|---:|---:|\n"
    ]
    for name, shown in SEARCHES.items():
        cells = [str(interval(interquartile_mean, scores[judged][name])) for judged in JUDGED]
        for judged in JUDGED:
            ga, other = scores[judged]["ga"], scores[judged][name]
            cells.append("" if name == "ga" else str(interval(improvement, ga, other)))
        lines.append(f"| {shown} | {' | '.join(cells)} |\n")
    return lines


def _verdict(wins: Mapping[str, Sequence[str]], count: int) -> str:
    counts = [", ".join(f"{shown} {found.count(name)}" for name, shown in SEARCHES.items()) for found in wins.values()]
    most = [found.count("ga") > count / 2 for found in wins.values()]
    said = "Yes" if all(most) else "By nominal returns alone" if most[0] else "Under noise alone" if most[1] else "No"
    limit = "" if count == len(BENCHMARK10) else f", as far as {count} of the ten tasks say"
    return (
        f"\nTasks on which a search has the highest mean, of {count}: {counts[0]}; under noise {counts[1]}. The paper:"
        ' "we found the GA baseline algorithm outperformed the other baselines algorithms the majority of the time"'
        f" (section E). Is it so here{limit}? {said}.\n"
    )


def picture(curves: Sequence[Row]) -> str:
    """The chart: a panel for each task with a member that is done."""
    colours = dict(zip(SEARCHES, COLOURS, strict=False))
    panels = []
    for task in task_ids():
        series = []
        for name, colour in colours.items():
            mine = [row for row in curves if (row["task"], row["search"], row["axis"]) == (task, name, AXES[0])]
            if mine:
                found = np.array([[float(row[column]) for column in CURVE_COLUMNS[-len(FRACTIONS) :]] for row in mine])
                mean, low, high = (
                    list(zip([share * STEPS for share in FRACTIONS], ends.tolist(), strict=True))
                    for ends in (found.mean(0), found.min(0), found.max(0))
                )
                series.append(Series(name, mean, colour=colour, band=[*high, *reversed(low)]))
        if series:
            panels.append(chart(series, "control steps", task, PANEL, names=False))
    return sheet(panels, [Series(shown, [], colour=colours[name]) for name, shown in SEARCHES.items()], 4)


def main() -> None:
    """See the top of this file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("page", "run"), default="page")
    parser.add_argument("--minutes", type=float, help="end after so long; what is being made is gone on with later")
    parser.add_argument("--folder", type=Path, default=Path("outputs/paper"), help="of searches and tables")
    given = parser.parse_args()
    if given.what == "run":
        run(given.folder, given.minutes)
    else:
        rows = read_rows(MEMBERS)
        write_text(PAGE, page(rows))
        if rows:
            write_text(CHART, picture(read_rows(CURVES)))


if __name__ == "__main__":
    main()
