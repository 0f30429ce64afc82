"""``warpvox bench suite=learning``: how long it takes to learn, with EvoGym's settings of PPO and with ours."""

import time
from typing import Any

import numpy as np
import torch

from warpvox.algos.evaluate import evaluator
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.batch.options import lanes_for
from warpvox.bench.cases import make, one_body
from warpvox.bench.check import against_scalar
from warpvox.bench.report import Report, middle, number
from warpvox.cli.config import load

SECONDS = 150.0
WARM_UP = 2
"""Iterations before the clock starts: they load kernels and belong to another run."""
MEDIANS = ("seconds", "cpu_seconds", "steps")


def run(config: Any, report: Report) -> None:
    """Runs of each of ``learning.ppo`` until an evaluation reaches the return or the time is over."""
    body, keys, limit = one_body(config), config.learning, config.seconds or SECONDS
    goal = keys.stop_return
    runs: dict[str, list[dict[str, Any]]] = {}
    rows = []
    for name in keys.ppo:
        runs[name] = []
        for seed in range(keys.seeds):
            with report.console.status(f"ppo={name}, seed {seed}: at most {limit:.0f} s"):
                runs[name].append(learn(config, body, name, config.seed + seed))
        done = [row for row in runs[name] if row["seconds"] is not None]
        medians = {what: middle([row[what] for row in done]) if done else None for what in MEDIANS}
        shown = [*medians.values(), max(row["best_return"] for row in runs[name])]
        seconds = [row["seconds"] for row in done]
        shown.insert(1, f"{number(min(seconds))} to {number(max(seconds))}" if done else "-")
        rows.append(
            [f"ppo={name}, {runs[name][0]['num_envs']} environments", f"{len(done)} of {len(runs[name])}", *shown]
        )
    headings = ["", f"reached {goal:g}", "seconds", "from, to", "CPU seconds", "control steps", "best return"]
    title = f"{config.task}, {config.threads} threads, {config.device}: time to a return of {goal:g}"
    report.table(title, headings, rows)
    report.note(
        "Seconds of wall-clock time, evaluations included, kernels loaded; medians of the runs that got there."
        f" Others ended with the settings' own number of iterations or after {limit:g} s."
    )
    report.figures["runs"] = runs


def learn(config: Any, body: np.ndarray, name: str, seed: int) -> dict[str, Any]:
    """One run: its curve, and what it took to the return (``seconds`` None: not reached)."""
    settings, goal = load("train", [f"ppo={name}", f"seed={seed}"]), config.learning.stop_return
    torch.manual_seed(seed)
    env = make(config, [body], settings.num_envs, seed=seed)
    against_scalar(env, seed)
    lanes = lanes_for(settings.num_envs) if env.device == "cpu" else None  # evaluated as `warpvox train` does it
    judge = evaluator(make(config, [body], 1, seed=seed, auto_reset=False, device="cpu", lanes=lanes))
    schedule = Schedule(settings.max_iterations, settings.max_iterations, settings.eval_interval)
    Runner(adapt(env, settings.ppo), settings.ppo, schedule, evaluator=judge).learn(WARM_UP)
    torch.manual_seed(seed)
    runner = Runner(adapt(env, settings.ppo), settings.ppo, schedule, evaluator=judge)
    curve: list[dict[str, Any]] = []
    began, cpu = time.perf_counter(), time.process_time()
    first, seconds, reached = settings.ppo.random_start, 0.0, False
    while not reached and seconds <= (config.seconds or SECONDS):
        left = settings.max_iterations - runner.current_learning_iteration
        if left <= 0:
            break
        runner.learn(min(settings.eval_interval, left), init_at_random_ep_len=first)
        first, seconds, reached = False, time.perf_counter() - began, runner.last_return >= goal
        curve.append({"seconds": seconds, "steps": runner.steps, "return": runner.last_return})
    return {
        "seed": seed,
        "seconds": seconds if reached else None,
        "cpu_seconds": time.process_time() - cpu,
        "steps": runner.steps,
        "best_return": runner.best_return,
        "num_envs": settings.num_envs,
        "curve": curve,
    }
