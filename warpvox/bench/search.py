"""``warpvox bench suite=search``: the search algorithms on a made-up fitness, against random search.

No controller is trained: :class:`warpvox.algos.search.synthetic.SyntheticFitness` says at once what a body is worth,
and its best body is known. Every algorithm meets the same seeds, and each seed has its own best body, so that
algorithms are compared pair by pair.
"""

from __future__ import annotations

import time
from collections import Counter
from typing import Any

import numpy as np

from warpvox.algos.search import SearchSettings, make_search, settings_from
from warpvox.algos.search.synthetic import SyntheticFitness, best_of
from warpvox.bench.report import Report, number
from warpvox.cli.config import load
from warpvox.errors import ConfigError

__all__ = ["chance", "run"]

BASELINE = "random"
FLIPS = 200_000
"""Random signs for a p value; the smallest that can be told is one of so many."""
SHOWN = (100, 250, 500, 750)
"""Evaluations after which the best fitness is tabulated, and at the end."""
SOLVED = 1 - 1e-9


def run(config: Any, report: Report) -> dict[str, Any]:
    """Best fitness of each of ``searches.names`` after so many evaluations, and how sure the differences are."""
    searches = config.searches
    names = list(dict.fromkeys([BASELINE, *searches.names]))
    settings = {name: _settings(name, searches.evaluations) for name in names}
    shape, seeds = _shape(searches.shape), [config.seed + k for k in range(searches.seeds)]
    found: dict[str, Any] = {}
    for name in names:
        with report.status(f"{name}: {len(seeds)} searches of {searches.evaluations} evaluations"):
            began = time.process_time()
            fitness = {seed: SyntheticFitness(seed, shape) for seed in seeds}
            origins: Counter[str] = Counter()
            curves = [best_of(make_search(settings[name], shape, seed), fitness[seed], origins) for seed in seeds]
            seconds = (time.process_time() - began) / len(seeds)
            found[name] = {"curves": curves, "cpu_seconds": seconds, "origins": dict(origins)}
    final = {name: np.array([curve[-1] for curve in figure["curves"]]) for name, figure in found.items()}
    for name, figure in found.items():
        figure["p"] = {other: chance(final[name] - final[other], config.seed) for other in names if other != name}
    _show(config, report, found, final)
    _show_origins(report, found)
    report.plot("search", lambda figure: _draw(figure, found))
    return {"evaluations": searches.evaluations, "shape": list(shape), "seeds": seeds, "searches": found}


def chance(differences: np.ndarray, seed: int) -> float:
    """One-sided p value of paired ``differences [n]``: how often random signs add up to as much as they do.

    If neither of a pair were better, each sign would be as likely as the other.
    """
    signs = np.random.default_rng(seed).choice((-1.0, 1.0), (FLIPS, len(differences)))
    # a sum that is equal but for rounding counts as reached
    reached = signs @ differences >= differences.sum() - 1e-12
    return float((1 + np.count_nonzero(reached)) / (1 + FLIPS))


def _settings(name: str, evaluations: int) -> SearchSettings:
    """As ``warpvox codesign search=NAME`` has them."""
    return settings_from(load("codesign", [f"search={name}", f"search.max_evaluations={evaluations}"]).search)


def _shape(shape: list[int]) -> tuple[int, int]:
    if len(shape) != 2:
        raise ConfigError(f"searches.shape must be two numbers, rows and columns; got {shape}.")
    return shape[0], shape[1]


def _show(config: Any, report: Report, found: dict[str, Any], final: dict[str, np.ndarray]) -> None:
    evaluations = config.searches.evaluations
    marks = [mark for mark in SHOWN if mark < evaluations] + [evaluations]
    rows = []
    for name, figure in found.items():
        curves = np.array(figure["curves"])
        others = [other for other in (BASELINE, "ga") if other in found]
        rows.append(
            [
                name,
                *(number(float(curves[:, mark - 1].mean())) for mark in marks),
                number(float(final[name].std(ddof=1)) if len(curves) > 1 else None),
                f"{np.count_nonzero(final[name] > SOLVED)} of {len(curves)}",
                *(_chance(figure["p"].get(other)) for other in others),
                number(figure["cpu_seconds"]),
            ]
        )
    headings = ["search", *(f"after {mark}" for mark in marks), "deviation", "solved"]
    headings += [f"p against {other}" for other in (BASELINE, "ga") if other in found] + ["CPU seconds"]
    rows_, columns = config.searches.shape
    report.table(
        f"Best fitness, mean of {config.searches.seeds} seeds, bodies of {rows_} x {columns}; the optimum is 1",
        headings,
        rows,
    )
    report.note(
        "p: chance that a search that is no better would look at least so much better, from the differences of equal"
        " seeds. CPU seconds: of a whole search, without evaluations."
    )


def _chance(p: float | None) -> str:
    """One digit; none against itself."""
    return "-" if p is None else f"{p:.1g}"


def _show_origins(report: Report, found: dict[str, Any]) -> None:
    """Bodies after the first generation by what their search says of them."""
    names = list(dict.fromkeys(origin for figure in found.values() for origin in figure["origins"]))
    rows = []
    for name, figure in found.items():
        total = sum(figure["origins"].values())
        shares = [figure["origins"].get(origin, 0) / total if total else None for origin in names]
        rows.append([name, *("-" if not share else f"{share:.1%}" for share in shares)])
    report.table("Origin of the bodies after the first generation", ["search", *names], rows)


def _draw(figure: Any, found: dict[str, Any]) -> None:
    axes = figure.subplots()
    for name, result in found.items():
        curves = np.array(result["curves"])
        middle, spread = curves.mean(0), curves.std(0)
        steps = np.arange(1, len(middle) + 1)
        (line,) = axes.plot(steps, middle, label=name)
        axes.fill_between(steps, middle - spread, middle + spread, color=line.get_color(), alpha=0.15)
    axes.set(xlabel="evaluations", ylabel="best fitness", ylim=(0, 1.02))
    axes.grid(alpha=0.3)
    axes.legend()
