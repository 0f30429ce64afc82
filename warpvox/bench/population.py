"""``warpvox bench suite=population``: a generation of designs trained at once, against one after another."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from warpvox.algos.env_factory import Arena
from warpvox.algos.population.training import PopulationTraining
from warpvox.algos.settings import TrainingConfig
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.bench.report import Report, middle, number
from warpvox.configs.presets import training_preset
from warpvox.design import sample_design
from warpvox.errors import SimulationError

__all__ = ["run"]

SHAPE = (5, 5)
CHECKED, CHECK_STEPS, CHECK_ITERATIONS, TOLERANCE = 3, 4, 2, 1e-6
"""The check: so many designs, control steps of a rollout and iterations in float64; contacts let what is only rounding
grow too fast for more."""


@dataclass
class Times:
    """Seconds that an iteration of all designs takes, of the wall's clock and of CPU time."""

    wall: list[float]
    cpu: list[float]

    @staticmethod
    def of(part: Callable[[], object], repeats: int) -> Times:
        """Time ``part`` again and again, once without the clock first: it loads kernels."""
        part()
        times = Times([], [])
        for _ in range(repeats):
            wall, cpu = time.perf_counter(), time.process_time()
            part()
            times.wall.append(time.perf_counter() - wall)
            times.cpu.append(time.process_time() - cpu)
        return times


def run(config: Any, report: Report) -> dict[str, Any]:
    """Check that both learn the same, then time whole iterations of both.

    Raises:
        SimulationError: a design trained with others learns something else than alone.
    """
    settings, options = training_preset(config.population.training), config.population
    bodies = [sample_design(SHAPE, seed=config.seed + k) for k in range(options.designs)]
    seeds = list(range(options.designs))
    with report.status("checking that both learn the same"):
        error = _check(config, bodies[:CHECKED], seeds[:CHECKED], options.training)
    report.note(f"Parameters within {error:.1e} of separate trainings after {CHECK_ITERATIONS} updates in float64.")
    precision = dict(dtype=config.dtype, arithmetic=config.arithmetic)
    arena = Arena(config.task, device=config.device, threads=config.threads, **precision)
    with report.status("training all at once"):
        training = PopulationTraining(arena, bodies, seeds, settings)
        together = Times.of(training.iterate, config.repeats)
        wall = time.perf_counter()
        training.evaluate()
        evaluation = time.perf_counter() - wall
    with report.status("training one after another"):
        apart = _one_after_another(arena, bodies, seeds, settings, config.repeats)
    return _show(config, report, settings, together, apart, evaluation) | {"check_error": error}


def _stock(arena: Arena, body: np.ndarray, seed: int, settings: TrainingConfig) -> Runner:
    env = adapt(arena.make([body], settings.envs, [seed], auto_reset=True), settings.ppo)
    return Runner(env, settings.ppo, Schedule(settings.iterations, evaluate=10**9))


def _one_after_another(
    arena: Arena, bodies: Sequence[np.ndarray], seeds: Sequence[int], settings: TrainingConfig, repeats: int
) -> Times:
    """The sum over the designs of an iteration of each."""
    parts = []
    for body, seed in zip(bodies, seeds, strict=True):
        runner = _stock(arena, body, seed, settings)
        parts.append(Times.of(lambda runner=runner: runner.learn(1), repeats))
    columns = ([part.wall for part in parts], [part.cpu for part in parts])
    return Times(*([sum(row) for row in zip(*column, strict=True)] for column in columns))


@contextmanager
def _double() -> Iterator[None]:
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


def _check(config: Any, bodies: Sequence[np.ndarray], seeds: Sequence[int], preset: str) -> float:
    """The largest difference of a parameter of the policies; raises SimulationError if it is too large."""
    settings, worst = training_preset(preset, {"steps": CHECK_STEPS}), 0.0
    arena = Arena(config.task, device=config.device, dtype="float64", threads=config.threads)
    with _double(), torch.random.fork_rng():
        training = PopulationTraining(arena, bodies, seeds, settings)
        for _ in range(CHECK_ITERATIONS):
            training.iterate()
        for design, (body, seed) in enumerate(zip(bodies, seeds, strict=True)):
            torch.manual_seed(seed)
            runner = _stock(arena, body, seed, settings)
            runner.learn(CHECK_ITERATIONS, init_at_random_ep_len=settings.ppo.random_start)
            for name, value in runner.alg.actor.state_dict().items():
                worst = max(worst, float((value.cpu().double() - training.policy(design)[name]).abs().max()))
    if not worst < TOLERANCE:
        raise SimulationError(
            f"A design trained with others differs by {worst:.1e} from one trained alone after {CHECK_ITERATIONS}"
            f" updates (allowed: {TOLERANCE:.0e}): no speed is worth printing."
        )
    return worst


def _show(
    config: Any, report: Report, settings: TrainingConfig, together: Times, apart: Times, evaluation: float
) -> dict[str, Any]:
    designs = config.population.designs
    steps = designs * settings.envs * settings.ppo.steps
    rows, rates = [], {}
    for name, times in (("all at once", together), ("one after another", apart)):
        rates[name] = {"wall": steps / middle(times.wall), "cpu": steps / middle(times.cpu)}
        seconds = [number(middle(times.wall)), number(middle(times.cpu))]
        rows.append([name, *seconds, *(number(rate) for rate in rates[name].values())])
    ratio = {what: rates["all at once"][what] / rates["one after another"][what] for what in ("wall", "cpu")}
    shape = "x".join(str(n) for n in SHAPE)
    title = (
        f"{config.task}, {designs} random {shape} bodies, training={config.population.training}: {settings.envs}"
        f" environments of {settings.ppo.steps} steps each, {config.threads} threads ({config.torch_threads} of torch)"
    )
    headings = ["an iteration of all", "seconds", "CPU seconds", "control steps/s", "control steps/CPU s"]
    report.table(title, headings, rows)
    count = settings.iterations // settings.eval_interval
    whole = settings.iterations * middle(together.wall) + count * evaluation
    report.note(
        f"At once: {ratio['wall']:.1f} times as fast ({ratio['cpu']:.1f} times by CPU time). An evaluation of all takes"
        f" {evaluation:.1f} s; a generation of {settings.iterations} iterations with {count} evaluations takes"
        f" {whole:,.0f} s: {settings.iterations * steps / whole:,.0f} control steps of training per second."
    )
    return {
        "task": config.task,
        "designs": designs,
        "rates": rates,
        "ratio": ratio,
        "evaluation_seconds": evaluation,
        "generation_seconds": whole,
    }
