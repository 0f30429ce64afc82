"""``warpvox bench suite=learning``: how long it takes to learn, with EvoGym's settings of PPO and with ours."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch

from warpvox.algos.evaluate import evaluator
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.batch.options import lanes_for
from warpvox.bench.bodies import one_body
from warpvox.bench.check import against_scalar
from warpvox.bench.reference import open_reference
from warpvox.bench.report import Report, middle, number
from warpvox.cli.config import load
from warpvox.envs.vec_env import make_vec
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["learn", "run"]

WARM_UP = 2
"""Iterations before the clock starts: they load kernels and belong to another run."""


def run(config: Any, report: Report) -> dict[str, Any]:
    """Runs of each of ``learning.ppo`` until an evaluation reaches the return or the time is over."""
    body = one_body(config)
    figures: dict[str, Any] = {}
    for name in config.learning.ppo:
        runs = []
        for seed in range(config.learning.seeds):
            with report.status(f"ppo={name}, seed {seed}: at most {config.learning.seconds:.0f} s"):
                runs.append(learn(config, body, name, config.seed + seed))
        figures[name] = {"runs": runs} | _summary(runs)
    theirs = _reference_rate(config, report, body)
    _show(config, report, figures, theirs)
    report.plot("learning", lambda figure: _draw(figure, config, figures))
    return {"task": config.task, "stop_return": config.learning.stop_return, "ppo": figures, "reference_rate": theirs}


def learn(config: Any, body: np.ndarray, name: str, seed: int) -> dict[str, Any]:
    """One run: its curve, and what it took to the return (None: not reached)."""
    settings = load("train", [f"ppo={name}", f"seed={seed}"])
    torch.manual_seed(seed)
    options = dict(
        device=config.device, dtype=config.dtype, arithmetic=config.arithmetic, threads=config.threads, seed=seed
    )
    env = make_vec(config.task, [body], settings.num_envs, **options)
    against_scalar(env, seed)
    lanes = lanes_for(settings.num_envs) if env.device == "cpu" else None
    judge = evaluator(make_vec(config.task, [body], 1, auto_reset=False, lanes=lanes, **options))
    schedule = Schedule(settings.max_iterations, settings.max_iterations, settings.eval_interval)
    Runner(adapt(env, settings.ppo), settings.ppo, schedule, evaluator=judge).learn(WARM_UP)
    torch.manual_seed(seed)
    runner = Runner(adapt(env, settings.ppo), settings.ppo, schedule, evaluator=judge)
    curve: list[dict[str, float]] = []
    began, cpu = time.perf_counter(), time.process_time()
    goal, reached = config.learning.stop_return, None
    first = settings.ppo.random_start
    while runner.current_learning_iteration < settings.max_iterations:
        left = settings.max_iterations - runner.current_learning_iteration
        runner.learn(min(settings.eval_interval, left), init_at_random_ep_len=first)
        first, seconds = False, time.perf_counter() - began
        curve.append({"seconds": seconds, "steps": runner.steps, "return": runner.last_return})
        if runner.last_return >= goal:
            reached = seconds
        if runner.last_return >= goal or seconds > config.learning.seconds:
            break
    return {
        "seed": seed,
        "seconds": reached,
        "cpu_seconds": time.process_time() - cpu,
        "steps": runner.steps,
        "best_return": runner.best_return,
        "num_envs": settings.num_envs,
        "curve": curve,
    }


def _summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    done = [row for row in runs if row["seconds"] is not None]
    return {
        "reached": len(done),
        "seconds": middle([row["seconds"] for row in done]) if done else None,
        "cpu_seconds": middle([row["cpu_seconds"] for row in done]) if done else None,
        "steps": middle([row["steps"] for row in done]) if done else None,
        "best_return": max(row["best_return"] for row in runs),
    }


def _reference_rate(config: Any, report: Report, body: np.ndarray) -> float | None:
    """Control steps per CPU second of the reference, if there is one."""
    with open_reference(config, report, needed=False) as reference:
        if reference is None:
            return None
        reference.start(config.task, body)
        actuators = int(np.isin(body, (3, 4)).sum())
        actions = np.random.default_rng(config.seed).uniform(ACTION_LOW, ACTION_HIGH, (config.steps, actuators))
        return middle([reference.rate(actions) for _ in range(config.repeats)])


def _show(config: Any, report: Report, figures: dict[str, Any], theirs: float | None) -> None:
    goal = config.learning.stop_return
    rows = []
    for name, figure in figures.items():
        runs = figure["runs"]
        done = [row["seconds"] for row in runs if row["seconds"] is not None]
        rows.append(
            [
                f"ppo={name}, {runs[0]['num_envs']} environments",
                f"{figure['reached']} of {len(runs)}",
                number(figure["seconds"]),
                f"{number(min(done))} to {number(max(done))}" if done else "-",
                number(figure["cpu_seconds"]),
                number(figure["steps"]),
                number(figure["best_return"]),
                number(figure["steps"] / theirs if theirs and figure["steps"] else None),
            ]
        )
    headings = [
        "",
        f"reached {goal:g}",
        "seconds",
        "from, to",
        "CPU seconds",
        "control steps",
        "best return",
        "reference",
    ]
    report.table(
        f"{config.task}, {config.threads} threads, {config.device}: time to a return of {goal:g}", headings, rows
    )
    report.note(
        "Seconds of the wall's clock, evaluations included, kernels loaded; medians of the runs that got there."
        f" Others ended with the settings' own number of iterations or after {config.learning.seconds:g} s."
        + (" The last column: CPU seconds in which the reference steps as often, without learning." if theirs else "")
    )


def _draw(figure: Any, config: Any, figures: dict[str, Any]) -> None:
    left, right = figure.subplots(1, 2, sharey=True)
    for colour, (name, found) in zip(("C0", "C1"), figures.items(), strict=False):
        for k, row in enumerate(found["runs"]):
            values = [point["return"] for point in row["curve"]]
            label = f"ppo={name}" if k == 0 else None
            left.plot([point["seconds"] for point in row["curve"]], values, color=colour, label=label)
            right.plot([point["steps"] for point in row["curve"]], values, color=colour)
    for axes, what in ((left, "seconds"), (right, "control steps")):
        axes.axhline(config.learning.stop_return, color="grey", linestyle=":")
        axes.set(xlabel=what)
        axes.grid(alpha=0.3)
    left.set(ylabel="return of a deterministic evaluation")
    left.legend()
    figure.suptitle(config.task)
