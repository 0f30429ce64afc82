"""Learning curves of trainings and design searches: means over seeds with intervals, as picture and CSV."""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.algos.metrics import read_metrics
from warpvox.algos.report.members import SearchResult, progress
from warpvox.algos.statistics import mean_interval
from warpvox.errors import ConfigError
from warpvox.io.text import escaped
from warpvox.io.writing import atomic_path, check_suffix, write_table
from warpvox.runs import Run

SUFFIXES = (".png", ".svg", ".pdf")
AXES = {"steps": "control steps", "elapsed": "seconds", "iteration": "iterations", "evaluations": "designs trained"}
_COLOURS = ("#d96a14", "#2f6fb0", "#3a8a4d", "#8a4fa3", "#b03a48", "#5b6473")


@dataclass(frozen=True)
class Group:
    """Runs that differ only in their seed; ``label`` names the settings that distinguish the group."""

    label: str
    runs: tuple[Any, ...]


@dataclass(frozen=True)
class Curve:
    """Learning curve: mean over runs that differ only in their seed, with intervals.

    ``places``: values on the x axis, float64 ``[k]``; ``mean``, ``low``, ``high`` ``[k]``: mean return of the runs with
    its interval (NaN for a single run); ``runs``: x values and returns of each run, ``[2, evaluations]``.
    """

    label: str
    places: np.ndarray
    mean: np.ndarray
    low: np.ndarray
    high: np.ndarray
    runs: Sequence[np.ndarray]


def curves_of_searches(members: Sequence[SearchResult], x: str) -> dict[str, list[Curve]]:
    """Return, by task, a curve of the best return of each search, over ``steps`` or ``evaluations``.

    A search that has ended before others keeps its best return.
    """
    panels: dict[str, list[Curve]] = {}
    for task, name in dict.fromkeys((one.task, one.search) for one in members):
        runs = [one for one in members if (one.task, one.search) == (task, name)]
        places, values = progress(runs, x)
        points = [np.stack([places, column]) for column in values.T]
        panels.setdefault(task, []).append(_mean_curve(name, places, values, points))
    return panels


def curves_of(groups: Sequence[Group], x: str = "steps") -> list[Curve]:
    """Return a curve of the mean deterministic return for each group, over the column ``x`` of ``metrics.csv``.

    A run that has stopped early keeps its last return.
    """
    curves = []
    for group in groups:
        # Evaluations of each run, float64 [2, k]: values of x, and returns
        runs = []
        for each_run in group.runs:
            rows = evaluations_of(each_run)
            where = [row[x] for row in rows]
            what = [row["eval_return"] for row in rows]
            runs.append(np.array([where, what], float))

        # Runs are evaluated at different steps: they are interpolated at 200 common ones.
        if len(runs) == 1:
            places = runs[0][0]
            values = runs[0][1:].T
        else:
            first = max(points[0, 0] for points in runs)
            last = max(points[0, -1] for points in runs)
            places = np.linspace(first, last, 200)
            values = np.stack([np.interp(places, *points) for points in runs], axis=1)
        curves.append(_mean_curve(group.label, places, values, runs))
    return curves


def _mean_curve(label: str, places: np.ndarray, values: np.ndarray, runs: Sequence[np.ndarray]) -> Curve:
    """Compute the mean curve of ``values`` ``[places, runs]``, with confidence intervals."""
    intervals = [mean_interval(row) for row in values]
    mean = np.array([interval.mean for interval in intervals])
    low = np.array([interval.low for interval in intervals])
    high = np.array([interval.high for interval in intervals])
    return Curve(label, places, mean, low, high, runs)


def evaluations_of(found: Run) -> list[dict[str, float]]:
    """Select the rows of ``metrics.csv`` with an evaluation."""
    return [row for row in read_metrics(found.folder) if np.isfinite(row["eval_return"])]


def write_curves(
    panels: Mapping[str, Sequence[Curve]], path: str | os.PathLike[str], x: str, size: tuple[int, int]
) -> Path:
    """Draw curves (runs thin, mean thick, 95 % interval as a band), and write their numbers as CSV.

    Args:
        panels: curves, see :func:`curves_of`, of pictures beside each other, by their titles.
        path: .png, .svg or .pdf; written whole or not at all.
        size: in pixels, of each picture; higher where the legend has more than four lines.
    """
    suffix = check_suffix("The file of a chart", path, SUFFIXES, ConfigError)
    target = Path(path)
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError:
        raise ConfigError("Curves need matplotlib, which is not installed: pip install 'warpvox[view]'.") from None

    # At most four pictures beside each other; a legend takes room from its fifth line on
    columns = min(4, len(panels))
    rows = -(-len(panels) // columns)
    more = max(0, *(len(several) - 4 for several in panels.values()))
    inches = (columns * size[0] / 100, rows * (size[1] + 22 * more) / 100)
    figure = Figure(figsize=inches, dpi=100, layout="constrained")
    for number, (title, several) in enumerate(panels.items()):
        # No title where the legend already says it
        said = [curve.label for curve in several] == [title]
        axes = figure.add_subplot(rows, columns, number + 1, title="" if said else _plain(title))

        # Lines
        for index, curve in enumerate(several):
            turn, number_of_colour = divmod(index, len(_COLOURS))
            colour = _COLOURS[number_of_colour]
            styles = ("-", "--", ":", "-.")  # the next one after each turn of the colours
            look: dict[str, Any] = {"color": colour, "linestyle": styles[turn % len(styles)]}
            if len(curve.runs) > 1:
                axes.fill_between(curve.places, curve.low, curve.high, color=colour, alpha=0.18, linewidth=0)
                for points in curve.runs:
                    axes.plot(*points, **look, linewidth=0.8, alpha=0.3)
            label = _plain(f"{curve.label} (n={len(curve.runs)})")
            # A line of one point could not be seen.
            dot = "o" if curve.places[0] == curve.places[-1] else None
            axes.plot(curve.places, curve.mean, **look, linewidth=2.2, label=label, marker=dot)

        # Axes, and the legend below them, off the curves
        axes.set_xlabel(AXES[x])
        axes.set_ylabel("deterministic return")
        axes.grid(color="#dde2ea", linewidth=0.8)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        axes.ticklabel_format(axis="x", style="plain")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
        axes.margins(x=0.01)
        axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, 0), borderaxespad=3.5)
        axes.locator_params(axis="x", nbins=max(2, size[0] // 110))
    # Equal runs make equal files: names inside an SVG are hashes with a random salt otherwise.
    kind = suffix.removeprefix(".")
    undated = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[kind]
    with atomic_path(target, follow=True) as temporary, rc_context({"svg.hashsalt": "warpvox"}):
        figure.savefig(temporary, format=kind, metadata=undated)

    # The same numbers as a table
    rows_of_table = []
    for label, curve in labelled(panels):
        for numbers in zip(curve.places, curve.mean, curve.low, curve.high, strict=True):
            place, *others = (f"{number:.9g}" if math.isfinite(number) else "" for number in numbers)
            rows_of_table.append([label, place, len(curve.runs), *others])
    write_table(target.with_suffix(".csv"), ("settings", x, "n", "mean", "low", "high"), rows_of_table)
    return target


def _plain(text: str) -> str:
    """Escape text so that matplotlib shows it unchanged."""
    return escaped(text).replace("$", r"\$")


def labelled(panels: Mapping[str, Sequence[Curve]]) -> Iterator[tuple[str, Curve]]:
    """Yield each curve with its legend label, which includes the panel's name if there are several."""
    for title, several in panels.items():
        for curve in several:
            alone = len(panels) == 1 or curve.label == title
            yield curve.label if alone else f"{title}, {curve.label}", curve
