"""``warpvox bench suite=mixed``: a different body in every environment, beside one body in all."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from warpvox.bench.report import Report, middle, number, spread
from warpvox.bench.step import unit
from warpvox.bench.subject import LOADING, clock
from warpvox.design import sample_design
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import SimulationError

__all__ = ["run"]

SHAPE = (5, 5)
ALONE = 4
"""Random bodies that are measured one in all environments; their mean is what different bodies compare with."""
CHANGED = 8
"""One of so many environments gets another body when bodies are exchanged."""


FULL = np.array([[1, 3, 4, 3, 1], [2, 4, 3, 4, 2], [3, 1, 2, 1, 3], [4, 2, 1, 2, 4], [3, 4, 3, 4, 3]], np.int8)
"""A body without empty cells: a pack of different bodies has the springs of all cells, too."""


def sampled(count: int, seed: int) -> list[np.ndarray]:
    """Random bodies."""
    return [sample_design(SHAPE, np.random.default_rng([seed, k])) for k in range(count)]


def rates(envs: list[VoxelVecEnv], steps: int, repeats: int, seed: int) -> list[list[float]]:
    """Control steps per second of each batch, repetition by repetition in turns."""
    found: list[list[float]] = [[] for _ in envs]
    draw = np.random.default_rng(seed)
    moves = [
        [torch.as_tensor(draw.uniform(0.6, 1.6, (env.num_envs, env.num_actions)), dtype=env.dtype) for _ in range(8)]
        for env in envs
    ]
    for repeat in range(repeats + 1):
        for env, actions, rate in zip(envs, moves, found, strict=True):
            began, count = clock(env.device), steps if repeat else LOADING
            for step in range(count):
                env.step(actions[step % len(actions)].to(env.device))
            if repeat:  # the first round loads kernels
                rate.append(count * env.num_envs / (clock(env.device) - began))
    return found


def check(env: VoxelVecEnv, designs: list[np.ndarray], options: dict[str, Any], seed: int) -> None:
    """Raise SimulationError unless an environment among others does what it does alone, bit for bit."""
    lanes = env.sim.buffers.lanes
    if env.sim.layout == "lanes":
        options = options | {"lanes": lanes}
    env.reset()
    actions = torch.as_tensor(np.random.default_rng(seed).uniform(0.6, 1.6, (3, env.num_actions)), dtype=env.dtype)
    for action in actions:
        found = env.step(action.to(env.device).expand(env.num_envs, -1))[0]
    for k in (0, len(designs) - 1):
        alone = make_vec(env.spec, [designs[k]], lanes, **options)
        alone.reset()
        for action in actions:
            expected = alone.step(action[: alone.num_actions].to(env.device).expand(lanes, -1))[0]
        if not torch.equal(found[k, : alone.num_obs], expected[0]):
            raise SimulationError(
                f"Environment {k} moves otherwise among other bodies than alone: speeds mean nothing."
            )


def changes(env: VoxelVecEnv, repeats: int, seed: int) -> list[float]:
    """Seconds of CPU time in which one of CHANGED environments gets another body."""
    mask = torch.arange(env.num_envs, device=env.device) % CHANGED == 0
    count, found = int(mask.sum()), []
    for repeat in range(repeats + 1):
        bodies = sampled(count, seed + 1 + repeat)
        began = clock(env.device)
        env.set_designs(bodies, mask)
        if repeat:
            found.append(clock(env.device) - began)
    return found


def run(config: Any, report: Report) -> dict[str, Any]:
    """Speeds, and the times of building and of exchanging bodies."""
    count = config.num_envs
    options = dict(device=config.device, dtype=config.dtype, arithmetic="fast", threads=config.threads)
    designs = sampled(count, config.seed)
    with report.status("building, checking, then measuring"):
        alone = [make_vec(config.task, [body], count, **options) for body in (*designs[:ALONE], FULL)]
        began = clock(config.device)
        mixed = make_vec(config.task, designs, count, **options)
        built = clock(config.device) - began
        check(mixed, designs, options, config.seed)
        found = rates([mixed, *alone], config.steps, config.repeats, config.seed)
        open_to_change = make_vec(config.task, designs, count, grid=SHAPE, **options)
        changed = changes(open_to_change, config.repeats, config.seed)
    mixed_rate, *sparse, full = [middle(rate) for rate in found]
    report.note("Checked: the first and the last body move among the others as they do alone, bit for bit.")
    rows = [[f"{count} different bodies", spread(found[0])]]
    rows += [[f"body {k} in all", spread(rate)] for k, rate in enumerate(found[1:-1])]
    rows += [["a full body in all", spread(found[-1])]]
    report.table(
        f"{config.task}, {count} environments, random 5x5 bodies, control steps per {unit(config.device)}",
        ["", "step only"],
        rows,
    )
    report.note(
        f"Different bodies step at {mixed_rate / np.mean(sparse):.0%} of the speed of one in all (the mean of {ALONE}),"
        f" and at {mixed_rate / full:.0%} of that of a body without empty cells. They were built in"
        f" {built:.2f} s; {count // CHANGED} of {count} were exchanged in {number(1e3 * middle(changed))} ms."
    )
    return {
        "task": config.task,
        "mixed": found[0],
        "alone": found[1:-1],
        "full": found[-1],
        "built": built,
        "changed": changed,
    }
