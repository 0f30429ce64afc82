"""``warpvox bench suite=peer``: ours and the reference alternately, on the same body, task and kind of actions."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from warpvox.bench.case import Case, one_body
from warpvox.bench.check import STEPS, against_reference
from warpvox.bench.reference import Reference, reference_python
from warpvox.bench.report import Report, middle, number, spread
from warpvox.bench.runner import HEADINGS, Runner, measure, unit
from warpvox.envs.registry import released_id
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["run"]


def run(config: Any, report: Report) -> dict[str, Any]:
    """A batch, one environment of gymnasium, one of the drop-in, and the reference.

    Raises:
        ConfigError: no reference. SimulationError: ours and the reference differ.
    """
    import warpvox.envs
    import warpvox.evogym.envs  # noqa: F401  (both register their environments)

    body = one_body(config)
    batch = Case(f"warpvox, {config.num_envs} environments", config.task, [body], config.num_envs)
    with Reference(reference_python(config, report)) as reference:
        with report.status("checking the physics"):
            reference.start(config.task, body)
            error = against_reference(config, config.task, body, reference)
            runner = Runner(config, batch)
        report.note(f"Checked: within {error:.1e} of the reference over {STEPS} steps in float64.")
        with report.status("measuring"):
            runner.fit()
            one = gymnasium.make(f"warpvox/{config.task}", body=body, device=config.device, disable_env_checker=True)
            drop_in = gymnasium.make(released_id(config.task), body=body.astype(float), disable_env_checker=True)
            others = {
                "warpvox, one gymnasium environment": _timer(config, one),
                "warpvox, one environment of the drop-in": _timer(config, drop_in),
                reference.name: reference.timer(config.steps, runner.env.num_actions, config.seed),
            }
            found = measure({batch.name: runner}, config.columns, config.repeats, others)
    alone, drop_in, theirs = (found[name]["step"] for name in others)
    base = middle(theirs)
    rows = []
    for name, rates in found.items():
        best = rates.get("step") or next(iter(rates.values()))
        rows.append([name, *(spread(rates.get(column, [])) for column in config.columns), number(middle(best) / base)])
    title = f"{config.task}, control steps per {unit(config.device)}: median (least to most)"
    report.table(title, ["", *(HEADINGS[column] for column in config.columns), "ratio"], rows)
    if config.device == "cpu":
        report.note("Rates are per second of CPU time, that is of one core; the ratio is that of the medians.")
    return {
        "task": config.task,
        "check_error": error,
        "steps": runner.steps,
        "rates": found[batch.name],
        "gymnasium": alone,
        "drop_in": drop_in,
        "reference": theirs,
        "versions": reference.versions,
        "ratio": {column: middle(values) / base for column, values in found[batch.name].items() if values},
        "ratio_gymnasium": middle(alone) / base,
        "ratio_drop_in": middle(drop_in) / base,
    }


def _timer(config: Any, env: gymnasium.Env) -> Callable[[], float]:
    """A function that measures the rate of one environment of gymnasium; resets are not counted."""
    rng = np.random.default_rng(config.seed)
    env.reset()
    env.step(env.action_space.sample())

    def rate() -> float:
        seconds, began = 0.0, time.process_time()
        for action in rng.uniform(ACTION_LOW, ACTION_HIGH, (config.steps, *(env.action_space.shape or ()))):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                seconds += time.process_time() - began
                env.reset()
                began = time.process_time()
        return config.steps / (seconds + time.process_time() - began)

    return rate
