"""``warpvox bench suite=mixed``: a different body in every environment, beside one body in all."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from warpvox.bench.case import Case, sampled_bodies
from warpvox.bench.report import Report, middle, number, spread
from warpvox.bench.runner import Runner, clock, measure, unit
from warpvox.envs.vec_env import VoxelVecEnv

__all__ = ["run"]

SIDE = 5
ALONE = 4
"""Random bodies that are measured one in all environments; their mean is what different bodies compare with."""
CHANGED = 8
"""One of so many environments gets another body when bodies are exchanged."""
FULL = np.array([[1, 3, 4, 3, 1], [2, 4, 3, 4, 2], [3, 1, 2, 1, 3], [4, 2, 1, 2, 4], [3, 4, 3, 4, 3]], np.int8)
"""A body without empty cells: a pack of different bodies has the springs of all cells, too."""


def run(config: Any, report: Report) -> dict[str, Any]:
    """Speeds, and the times of building and of exchanging bodies.

    Raises:
        SimulationError: an environment moves among other bodies otherwise than alone.
    """
    count, bodies = config.num_envs, sampled_bodies(SIDE, config.num_envs, config.seed)
    fast = {"arithmetic": "fast"}
    mixed = Case(f"{count} different bodies", config.task, bodies, count, fast)
    cases = [
        mixed,
        *(Case(f"body {k} in all", config.task, [body], count, fast) for k, body in enumerate(bodies[:ALONE])),
    ]
    cases.append(Case("a full body in all", config.task, [FULL], count, fast))
    with report.status("building, checking, then measuring"):
        runners = {case.name: Runner(config, case) for case in reversed(cases)}  # others load the kernels
        built = runners[mixed.name].built
        for runner in runners.values():
            runner.fit()
        rates = measure({case.name: runners[case.name] for case in cases}, ["step"], config.repeats)
        found = {name: values["step"] for name, values in rates.items()}
        open_to_change = replace(mixed, options=fast | {"grid": (SIDE, SIDE)})
        changed = _exchange(Runner(config, open_to_change, checked=False).env, config.repeats, config.seed)
    worst = max(runner.error or 0.0 for runner in runners.values())
    report.note(f"Checked: each within {worst:.1e} of one environment alone in float64.")
    title = f"{config.task}, {count} environments, random {SIDE}x{SIDE} bodies, control steps per"
    rows = [[name, spread(rates)] for name, rates in found.items()]
    report.table(f"{title} {unit(config.device)}", ["", "step only"], rows)
    ours, *sparse, full = map(middle, found.values())
    report.note(
        f"Different bodies step at {ours / np.mean(sparse):.0%} of the speed of one in all (the mean of {ALONE}), and"
        f" at {ours / full:.0%} of that of a body without empty cells. They were built in {built:.2f} s;"
        f" {count // CHANGED} of {count} were exchanged in {number(1e3 * middle(changed))} ms."
    )
    mixed_rates, *alone_rates, full_rates = found.values()
    figures = {"task": config.task, "mixed": mixed_rates, "alone": alone_rates, "full": full_rates}
    return figures | {"built": built, "changed": changed, "check_error": worst}


def _exchange(env: VoxelVecEnv, repeats: int, seed: int) -> list[float]:
    """Seconds in which one of CHANGED environments gets another body."""
    mask = torch.arange(env.num_envs, device=env.device) % CHANGED == 0
    found = []
    for repeat in range(repeats + 1):
        bodies = sampled_bodies(SIDE, int(mask.sum()), seed + 1 + repeat)
        began = clock(env.device)
        env.set_designs(bodies, mask)
        found.append(clock(env.device) - began)
    return found[1:]
