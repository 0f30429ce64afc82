"""The report of many design searches: tasks by searches by seeds, as one page and as pictures.

It is made from archives alone, also while the searches are running. Formulas and sources: docs/evaluation.md.
"""

import base64
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np

from warpvox.algos.codesign.archive import Record
from warpvox.algos.report import FILE
from warpvox.algos.report.charts import COLOURS, PANEL, Series, chart, legend, sheet
from warpvox.algos.report.comparison import charts_of, compare, comparison_html
from warpvox.algos.report.gallery import write_gallery
from warpvox.algos.report.members import SearchResult, fitness_of, progress, read_members
from warpvox.algos.report.page import NOTHING, card, fact_list, page, row
from warpvox.envs.registry import known_returns, task_ids
from warpvox.io.console import in_html
from warpvox.io.writing import check_links, write_table, write_text
from warpvox.view.body_picture import draw_bodies
from warpvox.view.painter import save_png

TOP = 4
"""Designs of a generation that are shown."""
GENERATIONS, WINNERS = "generations", "winners.png"
"""Pictures beside the page: a folder with one a task, and the best designs of all tasks."""
Groups = Mapping[str, Mapping[str, Sequence[SearchResult]]]
"""Searches with a result by task and name."""


def write_benchmark(folder: Path, archives: Sequence[Path], facts: Mapping[str, str] | None = None) -> Path:
    """Write the page ``report.html`` with its pictures and the table ``results.csv``; returns the path of the page.

    The pictures: ``evaluations.svg`` and ``steps.svg`` (best return, a panel a task), ``comparison.svg``,
    ``winners.png``, ``generations/<task>.png``. What cannot be drawn yet is left out. Equal archives give equal files.

    Args:
        archives: folders of design searches; see :func:`warpvox.algos.report.members.read_members` for their names.
        facts: what stands under the title, by name, besides the figures of the searches.
    """
    check_links(folder, (GENERATIONS, WINNERS))
    members = read_members(archives)
    groups = _groups(members)
    comparison, best = compare(groups), _winners(groups)
    series = _names(groups)
    compared = charts_of(comparison, series)
    panels = {x: [_panel(task, runs, x, series) for task, runs in groups.items()] for x in ("evaluations", "steps")}
    if groups:
        for x, charts in panels.items():
            write_text(folder / f"{x}.svg", sheet(charts, [*series.values(), KNOWN], min(4, len(charts))))
        write_text(folder / "comparison.svg", sheet(compared, list(series.values())))
        _write_generations(folder / GENERATIONS, best)
    slots = {
        "facts": fact_list(_figures(members, best) | dict(facts or {})),
        "rows": "".join(_row(task, name, runs) for task, named in groups.items() for name, runs in named.items()),
        "winners": "".join(_card(task, one, one.winner) for task, one in best.items() if one.winner) or NOTHING,
        "gallery": _gallery(folder / WINNERS, best),
        "names": legend([*series.values(), KNOWN]),
        "comparison": comparison_html(comparison, compared),
        "generations": "".join(_generations(task, one) for task, one in best.items()) or NOTHING,
    } | {x: "".join(f"<div>{one}</div>" for one in charts) or NOTHING for x, charts in panels.items()}
    _write_table(folder / "results.csv", members)
    names = f"{len(series)} searches" if len(series) != 1 else "1 search"
    title = f"{len(groups)} tasks" if len(groups) != 1 else next(iter(groups))
    write_text(folder / FILE, page("benchmark.html", f"{title} · {names}", slots))
    return folder / FILE


KNOWN = Series("best published", colour=3, look="rule")


def _groups(members: Sequence[SearchResult]) -> Groups:
    """Searches that have a result: the benchmark's tasks in its order, then others; names as they appear."""
    done = [one for one in members if one.winner is not None]
    known = task_ids()
    tasks = sorted({one.task for one in done}, key=lambda task: (known.index(task) if task in known else 99, task))
    names = dict.fromkeys(one.search for one in done)
    groups: dict[str, dict[str, list[SearchResult]]] = {task: {} for task in tasks}
    for task, name in itertools.product(tasks, names):
        if runs := [one for one in done if (one.task, one.search) == (task, name)]:
            groups[task][name] = runs
    return groups


def _names(groups: Groups) -> dict[str, Series]:
    """The colour and look of each search, as a series with its name."""
    names = list(dict.fromkeys(name for named in groups.values() for name in named))
    looks = zip(names, itertools.cycle(itertools.product(("", "dash"), COLOURS)), strict=False)
    return {name: Series(name, colour=colour, look=look) for name, (look, colour) in looks}


def _winners(groups: Groups) -> dict[str, SearchResult]:
    every = {task: [one for runs in named.values() for one in runs] for task, named in groups.items()}
    return {task: max(several, key=lambda one: fitness_of(one.winner)) for task, several in every.items()}


def _figures(members: Sequence[SearchResult], best: Mapping[str, SearchResult]) -> dict[str, str]:
    published = {task: value for task in best if (value := _published(task)) is not None}
    reached = sum(fitness_of(best[task].winner) >= value for task, value in published.items())
    return {
        "tasks": f"{len(best)}",
        "runs": f"{len(members)}",
        "designs": f"{sum(one.evaluated for one in members):,}",
        "control steps": f"{sum(int(one.steps[-1]) for one in members if len(one.steps)):,}",
        "best published return reached": f"{reached} of {len(published)} tasks",
    }


def _published(task: str) -> float | None:
    known = known_returns().get(task)
    return known and known.best


def _row(task: str, name: str, runs: Sequence[SearchResult]) -> str:
    best = np.array([fitness_of(one.winner) for one in runs])
    published = _published(task)
    fresh = runs[int(best.argmax())].fresh
    seconds = [one.seconds for one in runs if one.seconds is not None]
    numbers = [
        (len(runs), f"{len(runs)}"),
        (best.max(), f"<b>{best.max():.3f}</b>"),
        (best.mean(), f"{best.mean():.3f}" + (f" ± {best.std(ddof=1):.3f}" if len(runs) > 1 else "")),
        (fresh.mean, str(fresh)) if fresh else ("", ""),
        ("", "") if published is None else (published, f"{published:g}"),
        (total := sum(one.evaluated for one in runs), f"{total:,}"),
        (total := sum(int(one.steps[-1]) for one in runs), f"{total:,}"),
        (sum(seconds), duration(sum(seconds))) if seconds else ("", ""),
    ]
    return row([(None, in_html(task)), (None, in_html(name)), *numbers])


def duration(seconds: float) -> str:
    """Hours and minutes."""
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02} min" if minutes >= 60 else f"{minutes} min"


def _card(task: str, member: SearchResult, record: Record) -> str:
    published = _published(task)
    lines = [task, f"{member.search}, seed {member.seed}, #{record.id}"]
    if member.fresh:
        lines.append(f"on fresh seeds {member.fresh}")
    if published is not None:
        lines.append(f"best published {published:g}")
    return card(record, lines)


def _gallery(path: Path, best: Mapping[str, SearchResult]) -> str:
    """Write the winners in the worlds of their tasks as a picture, and show it; without tasks of users."""
    ours = task_ids()
    shown = [
        (task, one.winner.candidate.body, f"{task}  {one.winner.fitness:.2f}")
        for task, one in best.items()
        if task in ours and one.winner
    ]
    if not shown:
        return ""
    data = base64.b64encode(write_gallery(path, shown).read_bytes()).decode()
    return f'<img alt="the winners in the worlds of their tasks" src="data:image/png;base64,{data}">'


def _write_table(path: Path, members: Sequence[SearchResult]) -> None:
    rows = []
    for one in members:
        winner = [one.winner.fitness, one.winner.id] if one.winner else [None, None]
        spent = [one.evaluated, int(one.steps[-1]) if len(one.steps) else 0, one.seconds]
        judged = astuple(one.fresh) if one.fresh else [None] * 4
        rows.append([one.task, one.search, one.seed, *winner, *spent, *one.diversity, *judged, one.folder])
    names = ("task", "search", "seed", "best_return", "design", "evaluations", "steps", "seconds")
    names += ("diversity_first", "diversity_last", "fresh_mean", "fresh_low", "fresh_high", "fresh_episodes", "folder")
    write_table(path, names, rows)


def _panel(task: str, named: Mapping[str, Sequence[SearchResult]], x: str, looks: Mapping[str, Series]) -> str:
    """Best return over ``x``: the mean over the runs of each search, one standard deviation as a band."""
    series, last = [], 0.0
    for name, runs in named.items():
        places, values = progress(runs, x)
        mean, last = values.mean(1), max(last, places[-1])
        spread = values.std(1, ddof=1) if len(runs) > 1 else None
        series.append(looks[name].over(places, mean, *(() if spread is None else (mean - spread, mean + spread))))
    if (best := _published(task)) is not None:
        series.append(KNOWN.over((0.0, last), (best, best)))
    label = {"evaluations": "designs trained", "steps": "control steps"}[x]
    return chart(series, label, task, PANEL, names=False)


def _three(member: SearchResult) -> dict[int, list[Record]]:
    """The best designs of the first, the middle and the last generation that has any."""
    known = sorted({r.candidate.generation for r in member.records if r.fitness is not None and not r.diverged})
    chosen = dict.fromkeys((known[0], known[(len(known) - 1) // 2], known[-1]))
    return {generation: member.ranked(generation)[:TOP] for generation in chosen}


def _generations(task: str, member: SearchResult) -> str:
    columns = "".join(
        f"<div><p>generation {generation}</p><div class="
        f'"cards">{"".join(card(r, [f"#{r.id} · {r.candidate.origin}"], 12) for r in records)}</div></div>'
        for generation, records in _three(member).items()
    )
    title = f"{task} · {member.search}, seed {member.seed}"
    return f'<details open><summary>{in_html(title)}</summary><div class="generations">{columns}</div></details>'


def _write_generations(folder: Path, best: Mapping[str, SearchResult]) -> None:
    """A picture a task: the best designs of three generations of the best search, a column a generation."""
    for task, member in best.items():
        columns = _three(member)
        rows = min(len(records) for records in columns.values())
        shown = [(generation, records[k]) for k in range(rows) for generation, records in columns.items()]
        captions = [(f"{record.fitness:.3f}", f"generation {generation}") for generation, record in shown]
        bodies = [record.candidate.body for _, record in shown]
        title = f"{task} · {member.search}"
        name = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in task)
        save_png(draw_bodies(bodies, captions, title, columns=len(columns)), folder / f"{name}.png")
