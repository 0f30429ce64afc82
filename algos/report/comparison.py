"""Searches compared over tasks: interquartile means, performance profiles, probabilities of improvement.

After Agarwal et al. (2021); formulas in docs/evaluation.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from warpvox.algos.report.charts import PANEL, Series, chart, intervals
from warpvox.algos.report.members import SearchResult
from warpvox.algos.report.page import row
from warpvox.algos.statistics import (
    LEVEL,
    Interval,
    bootstrap,
    improvement,
    interquartile_mean,
    interval,
    mean,
    optimality_gap,
    profile,
)
from warpvox.envs.registry import known_returns
from warpvox.io.console import in_html

MEASURES = {"interquartile mean": interquartile_mean, "mean": mean, "optimality gap": optimality_gap}
THRESHOLDS = 61
"""Points of a performance profile."""


@dataclass(frozen=True)
class Comparison:
    """Scores of searches on the tasks that all of them have runs of.

    Attributes:
        scores: float64 ``[runs]`` by search and task: 0 is chance, 1 the best published return.
        steps: control steps by task, after which the scores are taken: what every run of the task has spent.
    """

    scores: Mapping[str, Mapping[str, np.ndarray]]
    steps: Mapping[str, int]
    left_out: Sequence[str]

    def improvements(self) -> dict[tuple[str, str], Interval]:
        """The probability that a run of the first is better than one of the second, for all ordered pairs."""
        pairs = permutations(self.scores, 2)
        return {pair: interval(improvement, *map(self.scores.__getitem__, pair)) for pair in pairs}


def compare(groups: Mapping[str, Mapping[str, Sequence[SearchResult]]]) -> Comparison:
    """Compare searches at equal control steps; ``groups``: searches with a result, by task and name."""
    names = list(dict.fromkeys(name for named in groups.values() for name in named))
    known = known_returns()
    published = {task for task, returns in known.items() if returns.best is not None}
    tasks = [task for task, named in groups.items() if len(named) == len(names) and task in published]
    steps = {task: min(int(one.steps[-1]) for runs in groups[task].values() for one in runs) for task in tasks}

    def scored(task: str, name: str) -> np.ndarray:
        return np.array([known[task].score(one.best_at(steps[task])) for one in groups[task][name]])

    scores = {name: {task: scored(task, name) for task in tasks} for name in names if tasks}
    return Comparison(scores, steps, [task for task in groups if task not in tasks])


def charts_of(comparison: Comparison, looks: Mapping[str, Series]) -> list[str]:
    """The measures, then the profiles; none without scores."""
    if not comparison.scores:
        return []
    charts = [
        intervals([(name, looks[name].colour, interval(of, one)) for name, one in comparison.scores.items()], measure)
        for measure, of in MEASURES.items()
    ]
    values = np.concatenate([runs for scores in comparison.scores.values() for runs in scores.values()])
    thresholds = np.linspace(min(0.0, values.min()), max(1.0, values.max()), THRESHOLDS)
    series = []
    for name, scores in comparison.scores.items():
        share, low, high = bootstrap(lambda drawn: profile(drawn, thresholds), scores)
        series.append(looks[name].over(thresholds, share, low, high))
    return [*charts, chart(series, "score", "share of runs above it", PANEL, names=False)]


def comparison_html(comparison: Comparison, charts: Sequence[str]) -> str:
    """The charts of :func:`charts_of`, the probabilities of improvement and what they are of."""
    if not comparison.scores:
        return '<p class="faint">No task with a published return has runs of every search yet.</p>'
    parts = [f'<div class="panels">{"".join(f"<div>{one}</div>" for one in charts)}</div>']
    pairs = comparison.improvements()
    if pairs:
        body = "".join(
            row([(None, in_html(first)), (None, in_html(second)), (one.mean, in_html(str(one)))])
            for (first, second), one in pairs.items()
        )
        heads = "<tr><th>search</th><th>better than</th><th class='num'>probability of improvement</th></tr>"
        parts.append(f"<table><thead>{heads}</thead><tbody>{body}</tbody></table>")
    steps = ", ".join(f"{task} {count:,}" for task, count in comparison.steps.items())
    text = (
        f"Scores of {len(comparison.steps)} tasks: 0 is the return of random bodies under random actions, 1 the best"
        f" published return. Taken after the control steps that every run of a task has spent ({steps})."
        f" Intervals: {100 * LEVEL:g} %, stratified bootstrap over the runs of each task; none where there is one run."
    )
    if comparison.left_out:
        left_out = ", ".join(comparison.left_out)
        text += f" Left out, without a published return or without runs of every search: {left_out}."
    return "".join([*parts, f'<p class="faint">{in_html(text)}</p>'])
