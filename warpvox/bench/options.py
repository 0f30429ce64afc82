"""``warpvox bench suite=options``: what inheritance and early stopping are worth, at equal control steps.

Each option searches with the genetic algorithm from the same seeds, so that the first generation has the same bodies,
and spends the same number of control steps: stopping designs early leaves enough for more of them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from warpvox.algos.candidate import Parent
from warpvox.algos.codesign.population_evaluator import PopulationEvaluator
from warpvox.algos.env_factory import Arena
from warpvox.algos.search import GaSettings, make_search
from warpvox.algos.settings import TrainingConfig
from warpvox.bench.report import Report, number
from warpvox.configs.presets import training_preset
from warpvox.errors import ConfigError, SimulationError

__all__ = ["run"]

SHAPE = (5, 5)
OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "inherit=true": {"inherit": True},
    "rungs=[0.25,0.5]": {"rungs": [0.25, 0.5]},
    "both": {"inherit": True, "rungs": [0.25, 0.5]},
}
EVALUATIONS = 6
"""Of a training: enough that the best of a noisy learning curve is found, too few to cost much."""


def run(config: Any, report: Report) -> dict[str, Any]:
    """Best fitness of each option over the control steps spent, for each seed.

    Raises:
        ConfigError: too few steps for a second generation. SimulationError: an option has spent other than the steps.
    """
    options = config.options
    figures: dict[str, Any] = {}
    for name, changes in OPTIONS.items():
        training = training_preset(
            "fast", iterations=options.iterations, eval_interval=max(1, options.iterations // EVALUATIONS), **changes
        )
        designs = _affordable(training, options.steps)
        if designs <= options.population:
            raise ConfigError(
                f"options.steps={options.steps:,} trains {designs} designs of {options.iterations} iterations, which is"
                f" not more than one generation of options.population={options.population}."
            )
        curves = []
        for seed in range(config.seed, config.seed + options.seeds):
            with report.status(f"{name}, seed {seed}: {designs} designs"):
                curves.append(_search(config, training, designs, seed))
        figures[name] = {"designs": designs, "curves": curves, "best": [curve[-1][1] for curve in curves]}
    _check(figures, options.steps, _full(training))
    _show(config, report, figures)
    report.plot("options", lambda figure: _draw(figure, figures))
    return {"task": config.task, "options": figures}


def _full(training: TrainingConfig) -> int:
    """Control steps of a training to the end."""
    return training.envs * training.ppo.steps * training.iterations


def _affordable(training: TrainingConfig, steps: int) -> int:
    """How many designs can be trained with so many control steps, when designs are stopped as the settings say."""
    cost, going, before = 0.0, 1.0, 0.0
    for rung in [*training.rungs, 1.0]:
        cost += going * (rung - before)
        going, before = going * training.keep, rung
    return round(steps / (_full(training) * cost))


def _search(config: Any, training: TrainingConfig, designs: int, seed: int) -> list[tuple[int, float]]:
    """One search: (control steps spent, best fitness so far) after every generation."""
    precision = dict(dtype=config.dtype, arithmetic=config.arithmetic)
    arena = Arena(config.task, device=config.device, threads=config.threads, **precision)
    evaluator = PopulationEvaluator(arena, training, seed)
    settings = GaSettings(population=config.options.population, max_evaluations=designs)
    search = make_search(settings, SHAPE, seed)
    parents: dict[int, Parent] = {}
    spent, best, curve = 0, -math.inf, []
    while asked := search.ask():
        outcomes = evaluator.evaluate(asked, parents)
        search.tell([outcome.fitness for outcome in outcomes])
        for candidate, outcome in zip(asked, outcomes, strict=True):
            spent, best = spent + outcome.steps, max(best, outcome.fitness)
            if training.inherit and outcome.policy is not None:
                parents[candidate.id] = Parent(candidate.body, outcome.policy, outcome.fitness)
        curve.append((spent, best))
    return curve


def _check(figures: dict[str, Any], steps: int, full: int) -> None:
    """Raise SimulationError unless all have spent what they were given, give or take a design for each generation."""
    for name, figure in figures.items():
        for curve in figure["curves"]:
            if abs(curve[-1][0] - steps) > full * len(curve):
                raise SimulationError(f"{name} has spent {curve[-1][0]:,} control steps in place of {steps:,}.")


def _show(config: Any, report: Report, figures: dict[str, Any]) -> None:
    options = config.options
    rows = []
    for name, figure in figures.items():
        half = [_best_at(curve, options.steps / 2) for curve in figure["curves"]]
        ahead = np.array(figure["best"]) - np.array(figures["plain"]["best"])
        spent = [curve[-1][0] for curve in figure["curves"]]
        rows.append(
            [
                name,
                str(figure["designs"]),
                f"{np.mean(spent) / 1e6:.2f}",
                number(float(np.mean(half))),
                number(float(np.mean(figure["best"]))),
                " ".join(f"{value:.2f}" for value in figure["best"]),
                "-" if name == "plain" else f"{np.count_nonzero(ahead > 0)} of {len(ahead)}",
            ]
        )
    title = (
        f"{config.task}, genetic algorithm, generations of {options.population}, a full training is"
        f" {options.iterations} iterations, {options.seeds} seeds"
    )
    headings = ["training.", "designs", "million steps", "best at half", "best at the end", "by seed", "beats plain"]
    report.table(title, headings, rows)


def _best_at(curve: list[tuple[int, float]], steps: float) -> float:
    """The best after so many control steps: that of the last whole generation, the first at least."""
    return [best for spent, best in curve if spent <= max(steps, curve[0][0])][-1]


def _draw(figure: Any, figures: dict[str, Any]) -> None:
    axes = figure.subplots()
    for k, (name, result) in enumerate(figures.items()):
        for seed, curve in enumerate(result["curves"]):
            spent, best = zip(*curve, strict=True)
            axes.plot([s / 1e6 for s in spent], best, color=f"C{k}", label=None if seed else name, marker=".")
    axes.set(xlabel="million control steps", ylabel="best fitness")
    axes.grid(alpha=0.3)
    axes.legend()
