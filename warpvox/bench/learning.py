"""``warpvox bench suite=learning``: how long it takes to learn, with EvoGym's settings of PPO and with ours."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch

from warpvox.algos.evaluate import evaluator
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.batch.options import lanes_for
from warpvox.bench.case import one_body
from warpvox.bench.check import against_scalar
from warpvox.bench.report import Report, middle, number
from warpvox.cli.config import load
from warpvox.envs.vec_env import make_vec

__all__ = ["learn", "run"]

WARM_UP = 2
"""Iterations before the clock starts: they load kernels and belong to another run."""
MEDIANS = ("seconds", "cpu_seconds", "steps")


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
    _show(config, report, figures)
    return {"task": config.task, "stop_return": config.learning.stop_return, "ppo": figures}


def learn(config: Any, body: np.ndarray, name: str, seed: int) -> dict[str, Any]:
    """One run: its curve, and what it took to the return (None: not reached)."""
    settings = load("train", [f"ppo={name}", f"seed={seed}"])
    torch.manual_seed(seed)
    options = dict(
        device=config.device, dtype=config.dtype, arithmetic=config.arithmetic, threads=config.threads, seed=seed
    )
    env = make_vec(config.task, [body], settings.num_envs, **options)
    against_scalar(env, seed)
    options |= {"device": "cpu", "lanes": lanes_for(settings.num_envs) if env.device == "cpu" else None}
    judge = evaluator(make_vec(config.task, [body], 1, auto_reset=False, **options))  # as `warpvox train` has it
    schedule = Schedule(settings.max_iterations, settings.max_iterations, settings.eval_interval)
    Runner(adapt(env, settings.ppo), settings.ppo, schedule, evaluator=judge).learn(WARM_UP)
    torch.manual_seed(seed)
    runner = Runner(adapt(env, settings.ppo), settings.ppo, schedule, evaluator=judge)
    curve: list[dict[str, Any]] = []
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
    """Medians of the runs that reached the return (None: no run did)."""
    done = [row for row in runs if row["seconds"] is not None]
    medians = {name: middle([row[name] for row in done]) if done else None for name in MEDIANS}
    return {"reached": len(done), **medians, "best_return": max(row["best_return"] for row in runs)}


def _show(config: Any, report: Report, figures: dict[str, Any]) -> None:
    goal = config.learning.stop_return
    rows = []
    for name, figure in figures.items():
        runs = figure["runs"]
        shown = [number(figure[what]) for what in ("seconds", "cpu_seconds", "steps", "best_return")]
        done = [row["seconds"] for row in runs if row["seconds"] is not None]
        shown.insert(1, f"{number(min(done))} to {number(max(done))}" if done else "-")
        rows.append([f"ppo={name}, {runs[0]['num_envs']} environments", f"{figure['reached']} of {len(runs)}", *shown])
    headings = ["", f"reached {goal:g}", "seconds", "from, to", "CPU seconds", "control steps", "best return"]
    title = f"{config.task}, {config.threads} threads, {config.device}: time to a return of {goal:g}"
    report.table(title, headings, rows)
    report.note(
        "Seconds of wall-clock time, evaluations included, kernels loaded; medians of the runs that got there."
        f" Others ended with the settings' own number of iterations or after {config.learning.seconds:g} s."
    )
