"""Report that compares finished or running design searches by their archives.

    python -m lab.comparison.report outputs/look          # every search that lies in the folder

writes ``report.html`` with ``results.csv``, ``curves.svg`` and ``winners.png`` beside it.
"""

from __future__ import annotations

import argparse
import base64
import csv
import html
import io
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import warpvox as wv
from lab.comparison.statistics import improvement, interquartile_mean, interval, interval_text
from warpvox.algos.report.members import SearchResult, read_members
from warpvox.envs.registry import known_returns

PANELS = 4
"""Maximum number of panels in a row."""
RESULTS = ("task", "search", "seed", "best_return", "designs", "control_steps", "seconds", "status", "folder")
Groups = dict[str, dict[str, list[SearchResult]]]
"""Searches with results, by task and name."""


def read_searches(folders: Sequence[Path]) -> list[SearchResult]:
    """Read all searches in these folders that have evaluated a design.

    Raises:
        SystemExit: there is none, or seeds of one search differ by other settings, too.
    """
    places = sorted({path.parent for folder in folders for path in folder.rglob("archive.sqlite")})
    searches = [one for one in read_members(places) if len(one.best)]
    if not searches:
        raise SystemExit(f"No design search in {', '.join(map(str, folders))} has evaluated a design.")
    for named in grouped(searches).values():
        for runs in named.values():
            for other in runs[1:]:
                if key := _difference(runs[0].settings, other.settings):
                    raise SystemExit(f"{runs[0].folder} and {other.folder} differ in {key}: give each a folder.")
    return searches


def _difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> str | None:
    """Return the first setting, other than the seed, in which two searches differ."""
    for key in one:
        if key != "seed" and one[key] != other.get(key):
            return key
    return None


def grouped(searches: Sequence[SearchResult]) -> Groups:
    """Group searches by task and name, with tasks in the order of the paper."""
    order = [*wv.task_ids(), *sorted({one.task for one in searches})]
    groups: Groups = {}
    for one in sorted(searches, key=lambda one: order.index(one.task)):
        groups.setdefault(one.task, {}).setdefault(one.search, []).append(one)
    return groups


def scores_of(groups: Groups) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, int]]:
    """Compute scores by search and task, and the common number of control steps of each task.

    A score is 0 for the return of random bodies under random actions, 1 for the best published one. It is taken after
    the control steps that every run of the task has spent. Tasks without a published return, or without runs of every
    search, are left out.
    """
    names = list(dict.fromkeys(name for named in groups.values() for name in named))
    known = known_returns()
    scores: dict[str, dict[str, np.ndarray]] = {name: {} for name in names}
    steps = {}
    for task, named in groups.items():
        if len(named) < len(names) or task not in known or known[task].best is None:
            continue
        steps[task] = min(int(one.steps[-1]) for runs in named.values() for one in runs)
        for name, runs in named.items():
            scores[name][task] = np.array([known[task].score(one.best_at(steps[task])) for one in runs])
    return scores if steps else {}, steps


def write_report(folder: Path, searches: Sequence[SearchResult]) -> Path:
    """Write the report's page, pictures and table into ``folder``; return the path of the page."""
    folder.mkdir(parents=True, exist_ok=True)
    groups = grouped(searches)

    # Table for other programs
    results = []
    for one in searches:
        key = (one.task, one.search, one.seed)
        spent = (int(one.evaluations[-1]), int(one.steps[-1]), one.summary.get("elapsed_seconds"))
        results.append((*key, float(one.best[-1]), *spent, one.summary.get("status"), one.folder.as_posix()))
    write_csv(folder / "results.csv", RESULTS, results)

    # Pictures
    picture = draw_curves(groups)
    write(folder / "curves.svg", picture)
    winners = {}
    for task, named in groups.items():
        winners[task] = max((one for runs in named.values() for one in runs), key=lambda one: one.best[-1])
    bodies = [one.winner.candidate.body for one in winners.values() if one.winner]
    captions = [(task, f"{one.best[-1]:.3f}", one.search) for task, one in winners.items() if one.winner]
    winners_file = io.BytesIO()
    wv.draw_bodies(bodies, captions).save(winners_file, "PNG")
    write(folder / "winners.png", winners_file.getvalue())

    # Page
    parts = [
        f"<h1>{len(groups)} tasks, {len(searches)} searches</h1>",
        _table(("task", "search", "runs", "best", "mean ± deviation", "published", "designs", "control steps"), groups),
        "<p>Best return of all runs, their mean, and how many designs and control steps they have taken together.</p>",
        f"<h2>Best return over control steps</h2>{_image('svg+xml', picture)}",
        "<p>Means of the runs, and ranges. A run that ends before the others keeps its best return.</p>",
        f"<h2>Comparison</h2>{_comparison(groups)}",
        f"<h2>Best bodies</h2>{_image('png', winners_file.getvalue())}",
    ]
    style = "body{font:15px sans-serif;margin:2em}td,th{padding:.2em .8em;text-align:right}img{max-width:100%}"
    head = f"<!doctype html><meta charset='utf-8'><title>Comparison of searches</title><style>{style}</style>"
    page = folder / "report.html"
    write(page, (head + "\n".join(parts)).encode())
    return page


def write(path: Path, content: bytes) -> None:
    """Write a file of the folder; a symbolic link of that name is replaced, not followed."""
    path.unlink(missing_ok=True)
    path.write_bytes(content)


def write_csv(path: Path, names: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([names, *rows])
    write(path, text.getvalue().encode())


def draw_curves(groups: Groups) -> bytes:
    """Draw the best return over control steps as SVG: one panel per task, one colour per search."""
    names = list(dict.fromkeys(name for named in groups.values() for name in named))
    panels: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]] = {}
    for task, named in groups.items():
        panels[task] = {}
        for name, runs in named.items():
            first, last = max(one.steps[0] for one in runs), max(one.steps[-1] for one in runs)
            places = np.linspace(first, last, 200)
            panels[task][name] = places, np.array([[one.best_at(steps) for steps in places] for one in runs])
    return draw_panels(panels, names)


def draw_panels(panels: Mapping[str, Mapping[str, tuple[Any, np.ndarray]]], names: Sequence[str]) -> bytes:
    """Draw curves over control steps as SVG: means of runs with their ranges.

    Args:
        panels: places ``[k]`` and returns ``[runs, k]`` by title and name.
        names: of all searches, in the order of their colours.
    """
    columns = min(PANELS, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(4 * columns, 2.6 * rows), layout="constrained")
    for number, (title, curves) in enumerate(panels.items(), 1):
        axes = figure.add_subplot(rows, columns, number, title=title)
        for name, (places, values) in curves.items():
            colour = f"C{names.index(name) % 10}"
            axes.plot(places, values.mean(0), color=colour, label=name)
            axes.fill_between(places, values.min(0), values.max(0), color=colour, alpha=0.2, linewidth=0)
    figure.axes[0].legend(frameon=False)
    stored = io.BytesIO()
    with rc_context({"svg.hashsalt": "warpvox", "svg.fonttype": "none"}):  # equal runs make equal files
        figure.savefig(stored, format="svg", metadata={"Date": None})
    return stored.getvalue()


def _image(kind: str, content: bytes) -> str:
    return f'<img src="data:image/{kind};base64,{base64.b64encode(content).decode()}">'


def _table(heads: Sequence[str], groups: Groups) -> str:
    lines = [f"<tr>{''.join(f'<th>{head}</th>' for head in heads)}</tr>"]
    known = known_returns()
    for task, named in groups.items():
        published = known[task].best if task in known else None
        for name, runs in named.items():
            best = np.array([one.best[-1] for one in runs])
            deviation = f" ± {best.std(ddof=1):.3f}" if len(runs) > 1 else ""
            cells = [
                *(html.escape(task), html.escape(name), f"{len(runs)}", f"{best.max():.3f}"),
                *(f"{best.mean():.3f}{deviation}", "" if published is None else f"{published:g}"),
                f"{sum(int(one.evaluations[-1]) for one in runs):,}",
                f"{sum(int(one.steps[-1]) for one in runs):,}",
            ]
            lines.append(f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
    return f"<table>{''.join(lines)}</table>"


def _comparison(groups: Groups) -> str:
    """Compute each search's interquartile mean, and the probabilities that one search beats another."""
    scores, steps = scores_of(groups)
    if not scores:
        return "<p>No task with a published return has runs of every search yet.</p>"
    lines = []
    for name, mine in scores.items():
        found = interval_text(interval(interquartile_mean, mine))
        lines.append(f"<tr><td>interquartile mean of {html.escape(name)}</td><td>{found}</td></tr>")
    for one, other in itertools.permutations(scores, 2):
        found = interval_text(interval(improvement, scores[one], scores[other]))
        lines.append(f"<tr><td>{html.escape(f'{one} better than {other}')}</td><td>{found}</td></tr>")
    spent = ", ".join(f"{task} {count:,}" for task, count in steps.items())
    text = (
        "Scores: 0 is the return of random bodies under random actions, 1 the best published return; taken after the"
        f" control steps that every run of a task has spent ({html.escape(spent)}). In brackets 95 % bootstrap"
        " intervals over the runs of each task."
    )
    return f"<table>{''.join(lines)}</table><p>{text}</p>"


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="folders that design searches lie in")
    parser.add_argument("--out", type=Path, help="where the page is written; by default the first folder")
    given = parser.parse_args(words)
    print(write_report(given.out or given.folders[0], read_searches(given.folders)))


if __name__ == "__main__":
    main()
