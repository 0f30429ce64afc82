"""``warpvox bench suite=mixed``: a different body in every environment, beside one body in all."""

from functools import partial
from typing import Any

import numpy as np
import torch

from warpvox.bench.cases import sampled_bodies
from warpvox.bench.report import Report, middle, number, spread
from warpvox.bench.runner import Runner, measure, seconds, unit

SIDE = 5
ALONE = 4
"""Random bodies that are measured one in all environments; their mean is what different bodies compare with."""
CHANGED = 8
"""One of so many environments gets another body when bodies are exchanged."""
FULL = np.array([[1, 3, 4, 3, 1], [2, 4, 3, 4, 2], [3, 1, 2, 1, 3], [4, 2, 1, 2, 4], [3, 4, 3, 4, 3]], np.int8)
"""A body without empty cells: a pack of different bodies has the springs of all cells, too."""


def run(config: Any, report: Report) -> None:
    """Speeds, and the times of building and of exchanging bodies."""
    count, bodies = config.num_envs, sampled_bodies(SIDE, config.num_envs, config.seed)
    cases = {f"{count} different bodies": bodies}
    cases |= {f"body {k} in all": [body] for k, body in enumerate(bodies[:ALONE])} | {"a full body in all": [FULL]}
    with report.console.status("building, checking, then measuring"):
        # that of different bodies last: the others load the kernels
        made = {name: Runner(config, cases[name], arithmetic="fast") for name in reversed(cases)}
        runners = {name: made[name] for name in cases}
        rates = [found["step"] for found in measure(runners, ["step"], config.repeats).values()]
        changed = _exchange(config, bodies)
    built = next(iter(runners.values())).built
    worst = max(runner.error or 0.0 for runner in runners.values())
    report.note(f"Checked: each within {worst:.1e} of one environment alone in float64.")
    title = f"{config.task}, {count} environments, random {SIDE}x{SIDE} bodies, control steps per"
    rows = list(zip(cases, rates, strict=True))
    report.table(f"{title} {unit(config.device)}", ["", "step only"], rows, spread)
    ours, *sparse, full = map(middle, rates)
    report.note(
        f"Different bodies step at {ours / np.mean(sparse):.0%} of the speed of one in all (the mean of {ALONE}), and"
        f" at {ours / full:.0%} of that of a body without empty cells. They were built in {built:.2f} s;"
        f" {count // CHANGED} of {count} were exchanged in {number(1e3 * middle(changed))} ms."
    )
    report.figures |= {"built": built, "changed": changed, "check_error": worst}


def _exchange(config: Any, bodies: list[np.ndarray]) -> list[float]:
    """Seconds in which one of CHANGED environments gets another body."""
    env = Runner(config, bodies, checked=False, arithmetic="fast", grid=(SIDE, SIDE)).env
    mask, found = torch.arange(env.num_envs, device=env.device) % CHANGED == 0, []
    for repeat in range(config.repeats + 1):
        others = sampled_bodies(SIDE, int(mask.sum()), config.seed + 1 + repeat)
        found.append(seconds(partial(env.set_designs, others, mask), env.device))
    return found[1:]
