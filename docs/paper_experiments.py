"""Makes the experiments of Evolution Gym's paper and the page with their numbers. Not part of the library.

    python docs/paper_experiments.py run [FOLDER [DEVICE]]   # design searches that are not done: outputs/paper, cpu
    python docs/paper_experiments.py                         # the page of the committed tables

Several processes may share a folder: each search is made by one of them. What was interrupted, by ``timeout 60m`` for
instance, is gone on with. ``paper_members.csv`` and ``paper_curves.csv`` in the folder hold the committed rows as well:
copied to ``docs/results`` they are what the page is made of. ``tests/docs`` says when it is out of date.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np

import warpvox as wv
from warpvox.algos.codesign.robots import robots_of
from warpvox.algos.interrupt import terminable
from warpvox.algos.report.charts import COLOURS, PANEL, Series, chart, sheet
from warpvox.algos.report.members import read_members
from warpvox.algos.statistics import improvement, interquartile_mean, interval
from warpvox.algos.suite.members import DONE, Member
from warpvox.algos.suite.run import FAILED, make_member
from warpvox.cli.config import load
from warpvox.cli.suite_plan import BENCHMARK10, plan
from warpvox.envs.registry import known_returns, task_ids
from warpvox.errors import RunError
from warpvox.io.reading import read_table
from warpvox.io.writing import claimed, write_table, write_text
from warpvox.robots import judge, save_robot
from warpvox.runs import read_summary

FOLDER = Path(__file__).resolve().parent
RESULTS, PAGE, CHART = FOLDER / "results", FOLDER / "paper_experiments.md", FOLDER / "images" / "paper_experiments.svg"
MEMBERS, CURVES = "paper_members.csv", "paper_curves.csv"
STEPS = 20_000_000
"""Control steps of a search."""
SETTINGS = ["training=fast", "training.iterations=60"]
"""Keys of all searches, besides those of ``suite=paper``; the paper's 512,000 control steps would leave 39 bodies."""
SEARCHES = {"ga": "GA", "bo_paper": "BO", "cppn_neat": "CPPN-NEAT"}
"""Names of the searches and what the paper calls them."""
KEY = ("task", "search", "seed")
FACTS = ("evaluations", "control_steps", "generations", "return", "noise", "seconds", "processor", "commit")
COLUMNS = (*KEY, *FACTS)
"""``return``: of the best design, in exact arithmetic; ``noise``: its mean in disturbed episodes."""
FRACTIONS = [k / 20 for k in range(1, 21)]
AXES = ("control_steps", "evaluations")
CURVE_COLUMNS = (*KEY, "axis", *map("{:g}".format, FRACTIONS))
"""The best fitness so far at fractions of the budget in control steps, or in evaluations."""
SLOWEST = "Traverser-v0"
JUDGED = ("return", "noise")

Row = Mapping[str, str]


@cache
def members() -> list[Member]:
    """All design searches in the order in which they are made, so that a cut leaves something to compare.

    ``Traverser-v0`` comes last: each of its searches takes as long as six others.
    """

    def planned(*words: str) -> list[Member]:
        common = ["suite=paper", f"control_steps={STEPS}", f"codesign=[{','.join(SETTINGS)}]", "device=cpu"]
        return plan(load("suite", [*common, *words]))

    others = [one for one in planned("tasks=[all]", "searches=[ga]") if one.task not in BENCHMARK10]
    return sorted([*planned(), *others], key=lambda one: (one.task == SLOWEST, one.seed))


def read_rows(name: str, folder: Path = RESULTS) -> list[Row]:
    """The committed rows of a table and those in ``folder``, which replace them."""
    rows = [*read_table(RESULTS / name), *read_table(folder / name)]
    return list({(*map(row.get, KEY), row.get("axis")): row for row in rows}.values())


def _key(row: Row) -> tuple[str, str, int]:
    return row["task"], row["search"], int(row["seed"])


def run(folder: Path, device: str = "cpu") -> None:
    """Make the members that are not done, until an interrupt."""
    with terminable(), suppress(KeyboardInterrupt):
        for member in members():
            place = folder / member.folder
            place.mkdir(parents=True, exist_ok=True)
            try:
                with claimed(place):  # not the search's own folder, which it claims itself
                    if member.key in map(_key, read_rows(MEMBERS, folder)):
                        continue
                    print(*member.key, flush=True)
                    settings = dataclasses.replace(member.settings, device=device, threads=1)
                    outcome = make_member(settings, place / "search")
                    if outcome["status"] == DONE:
                        store(folder, member, place / "search")
                    elif outcome["status"] != FAILED:
                        break
            except RunError as error:  # another process makes it
                print(error, flush=True)


def store(folder: Path, member: Member, place: Path) -> None:
    """Judge the best design of a search that is done, and add its rows to the tables."""
    summary, (robot,) = read_summary(place), robots_of(place)
    (noisy,) = wv.evaluate(
        f"zoo:{save_robot(folder / member.folder / 'best.npz', robot)}", protocol="noise", device="cpu"
    )
    (found,) = read_members([place])
    last = member.settings.search.max_evaluations
    places = {
        "control_steps": [found.best_at(share * STEPS) for share in FRACTIONS],
        "evaluations": [found.best[: max(1, int(share * last + 1e-9))].max() for share in FRACTIONS],
    }
    facts = {"control_steps": "steps", "seconds": "elapsed_seconds"}
    values = {name: summary.get(facts.get(name, name)) for name in FACTS}
    values |= {"return": judge(robot).mean_return, "noise": round(noisy.mean, 9)}
    curves = [[*member.key, axis, *(f"{value:.6g}" for value in places[axis])] for axis in AXES]
    with claimed(folder, wait=True):
        for name, columns, rows in (
            (CURVES, CURVE_COLUMNS, curves),  # first: a member with a row is done
            (MEMBERS, COLUMNS, [[*member.key, *values.values()]]),
        ):
            write_table(folder / name, columns, [*(row.values() for row in read_rows(name, folder)), *rows])


HEAD = """# The paper's experiments in numbers

The paper shows its experiments as curves: the genetic algorithm (GA) on all 32 tasks (Figure 35), and GA, Bayesian
optimisation (BO) and CPPN-NEAT on ten of them. Here they are {searches} design searches with {steps:g} million control
steps each, three seeds of each search on each task.

Searches, populations and shapes (5 x 7 for Lifter-v0, else 5 x 5) are those of the paper's Tables 2 to 5 (`search=ga`,
`bo_paper` and `cppn_neat`, [search](search.md)). Each body is trained by `{settings}` for
122,880 control steps, where the paper has 512,000; tasks are those of the [release](paper.md). **The budget is smaller
than the paper's**: {designs} bodies, where the paper has 250, 500 or 750. A first generation of {population} is random,
for GA and BO with equal seeds the same, and the search chooses {rest} more. So the numbers say what such a budget
brings, and little about larger ones.
"""
PICTURE = f"""
![Best fitness over control steps, a panel a task](images/{CHART.name})

Curves are the best fitness so far in float32, as the searches compute: mean and range of the seeds. **The tables are
the best body's episodes in exact arithmetic.** A policy that has learnt one trajectory by heart can return something
else there, for better or worse, also under noise ([why](protocols.md)).
"""
GA_TABLE = """
## GA on all tasks

| task | nominal | under noise | best published | by |
|---|---:|---:|---:|---|
"""
COMPARED = """
## GA, BO and CPPN-NEAT

Means of the seeds, the best in bold.

| task | GA | BO | CPPN-NEAT | GA under noise | BO under noise | CPPN-NEAT under noise |
|---|---:|---:|---:|---:|---:|---:|
"""
SCORES = """
The interquartile mean of the [scores](evaluation.md#comparing-searches) on the {} of these tasks that
have a published return (0 is chance, 1 that return), and the probability that a run of GA is better; with 95 %
bootstrap intervals.

| search | nominal | under noise | GA better, nominal | GA better, under noise |
|---|---:|---:|---:|---:|
"""
VERDICT = """
The paper: "we found the GA baseline algorithm outperformed the other baselines algorithms the majority of the time"
(section E). Here GA alone has the highest mean on {} of {count} tasks (BO {}, CPPN-NEAT {}), under noise on {} (BO {},
CPPN-NEAT {}): {said}.
"""
NOTES = """
*Nominal* is the return of a search's best body, as an entry of [the zoo](zoo.md) states it; *under
noise* its mean in 32 [episodes with noise on the actions](protocols.md). Means over seeds, in brackets the lowest and
the highest. Published returns are the best of anybody ([results](results.md#sources)). A search took in the median,
several at once and most with one thread each: {minutes}. A search of two processors was stopped on the first and
finished on the second; {dirty} searches were made with uncommitted changes (`-dirty`).

    python docs/paper_experiments.py run   # makes searches without a row in the tables; several may run at once
    python docs/paper_experiments.py       # this page, of docs/results/paper_members.csv and paper_curves.csv
"""
Returns = dict[tuple[str, str], list[list[float]]]
"""Nominal and under noise of each seed, by task and search."""


def page(rows: Sequence[Row]) -> str:
    """``docs/paper_experiments.md`` from the rows of all members."""
    settings, returns = members()[0].settings.search, Returns()
    minutes: dict[str, list[float]] = {}
    for row in rows:
        returns.setdefault((row["task"], row["search"]), []).append([float(row[name]) for name in JUDGED])
        minutes.setdefault(row["processor"], []).append(float(row["seconds"]) / 60)
    head = HEAD.format(
        searches=len(rows),
        steps=STEPS / 1e6,
        settings=" ".join(SETTINGS),
        designs=settings.max_evaluations,
        population=settings.population,
        rest=settings.max_evaluations - settings.population,
    )
    spent = [f"{np.median(some):.0f} min on {name} ({len(some)})" for name, some in sorted(minutes.items())]
    dirty = sum(row["commit"].endswith("-dirty") for row in rows)
    notes = NOTES.format(minutes="; ".join(spent), dirty=dirty)
    return "".join([head, PICTURE, *_ga_lines(returns), *_comparison(returns), notes])


def _ga_lines(returns: Returns) -> Iterator[str]:
    yield GA_TABLE
    for task, known in known_returns().items():
        cells = [f"{np.mean(x):.3f} ({min(x):.3f} to {max(x):.3f})" for x in zip(*returns[task, "ga"], strict=True)]
        best = "" if known.best is None else f"{known.best:g}"
        yield f"| {task} | {' | '.join(cells)} | {best} | {known.method} |\n"


def _comparison(returns: Returns) -> Iterator[str]:
    yield COMPARED
    wins, scores = np.zeros((len(JUDGED), len(SEARCHES)), int), {}
    for task in BENCHMARK10:
        runs = np.array([returns[task, name] for name in SEARCHES])
        means = runs.mean(1).T  # [judged, searches]
        best = means == means.max(1, keepdims=True)
        wins += best & (best.sum(1, keepdims=True) == 1)
        cells = (f"**{mean:.3f}**" if top else f"{mean:.3f}" for mean, top in zip(means.flat, best.flat, strict=True))
        yield f"| {task} | {' | '.join(cells)} |\n"
        if (known := known_returns()[task]).best is not None:
            scores[task] = np.vectorize(known.score)(runs)
    yield SCORES.format(len(scores))
    for number, name in enumerate(SEARCHES.values()):
        ga, mine = (
            [{task: runs[k, :, judged] for task, runs in scores.items()} for judged in range(len(JUDGED))]
            for k in (0, number)
        )
        cells = [str(interval(interquartile_mean, one)) for one in mine]
        cells += [str(interval(improvement, *pair)) if number else "" for pair in zip(ga, mine, strict=True)]
        yield f"| {name} | {' | '.join(cells)} |\n"
    most = wins[:, 0] > len(BENCHMARK10) / 2
    said = "a majority" if most.all() else "a majority by one of the two" if most.any() else "no majority"
    yield VERDICT.format(*wins.flat, count=len(BENCHMARK10), said=said)


def picture(curves: Sequence[Row]) -> str:
    """The chart, a panel for each task."""
    panels, steps = [], [share * STEPS for share in FRACTIONS]
    names = [Series(shown, colour=colour) for shown, colour in zip(SEARCHES.values(), COLOURS, strict=False)]
    for task in task_ids():
        series = []
        for search, name in zip(SEARCHES, names, strict=True):
            mine = [row for row in curves if (row["task"], row["search"], row["axis"]) == (task, search, AXES[0])]
            if mine:
                found = np.array([[float(row[column]) for column in CURVE_COLUMNS[-len(steps) :]] for row in mine])
                series.append(name.over(steps, found.mean(0), found.min(0), found.max(0)))
        panels.append(chart(series, "control steps", task, PANEL, names=False))
    return sheet(panels, names)


if __name__ == "__main__":
    if sys.argv[1:2] == ["run"]:
        folder, *device = sys.argv[2:] or ["outputs/paper"]
        run(Path(folder), *device)
    elif sys.argv[1:]:
        raise SystemExit(__doc__)
    else:
        write_text(PAGE, page(read_rows(MEMBERS)))
        write_text(CHART, picture(read_rows(CURVES)))
