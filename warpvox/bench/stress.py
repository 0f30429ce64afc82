"""``warpvox bench suite=stress``: every task under actions that no policy would take, with random bodies, watched.

Bodies are random, from 1 to ``stress.largest`` voxels a side. Environments act in the ways of :data:`WAYS`, and now
and then some are thrown: all their points get one more velocity. After every control step everything that is returned
must be finite and nothing fixed may have moved; points inside terrain are measured.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from warpvox.bench.report import Report, number
from warpvox.cli.console import echo
from warpvox.design import sample_design
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.envs.worlds import task_world
from warpvox.errors import WorldError
from warpvox.types import ACTION_HIGH, ACTION_LOW, VOXEL

__all__ = ["WAYS", "Depths", "Findings", "run", "stress"]

WAYS = ("low", "high", "alternating", "slow", "random", "wild")
"""All actuators short; long; from one to the other each step; every 10 steps; at random; random from -1e6 to 1e6."""
LANES = 32
"""Environments of a design: those of a pack, so that no lane is idle."""
THROW_EVERY, THROW_SPEED = 40, 30.0
"""Every so many control steps an eighth of the environments is thrown, each axis by up to so many units of speed: three
voxels a control step, and half as fast again as the points of a robot ever are by themselves."""
DEEPEST = 3
"""Voxels up to which depths are told apart."""
LOOK_EVERY = 8
"""Control steps between two looks at depths."""


@dataclass
class Findings:
    """What was seen: numbers that were not finite, fixed coordinates that moved (neither may be), episodes that ended
    unstable, those among them that diverged, looks at environments that left out contacts, the deepest point."""

    not_finite: int = 0
    moved: int = 0
    diverged: int = 0
    unstable: int = 0
    overflow: int = 0
    steps: int = 0
    depth: float = 0.0
    seconds: float = 0.0


class Depths:
    """How deep points are inside cells of terrain or below the floor, in voxels.

    Args:
        env: the environments; their worlds give the terrain.
    """

    def __init__(self, env: VoxelVecEnv) -> None:
        self.sim = env.sim
        self.names = [name for name in env.sim.object_names if name in env.sim.mobile_names]
        size = [max(getattr(world, side) for world in env.sim.worlds) + 2 * DEEPEST for side in ("width", "height")]
        self.solid = np.zeros((len(env.sim.worlds), *size), bool)
        self.solid[:, :, :DEEPEST] = True  # under the world is the floor: nothing leaves that way
        for world, solid in zip(env.sim.worlds, self.solid, strict=True):
            still = [item for name, item in world.objects.items() if item.is_static and name not in env.sim.loose]
            for item in still:
                rows, columns = item.grid.nonzero()
                solid[DEEPEST + item.x + columns, DEEPEST + item.y + item.grid.shape[0] - 1 - rows] = True
        self.design = env.sim.design_index.cpu().numpy()
        self.free = {name: _free_points(env.sim, name) for name in self.names}

    def __call__(self) -> np.ndarray:
        """float64 ``[num_envs]``: the deepest point of all that can move; :data:`DEEPEST` means that or deeper."""
        deepest = np.zeros(self.sim.num_envs)
        for name in self.names:
            place = self.sim.object_positions(name).double().cpu().numpy() / VOXEL
            inside = np.where(self.free[name], self._inside(place), 0.0)
            deepest = np.maximum(deepest, inside.max(1))
        return deepest

    def _inside(self, place: np.ndarray) -> np.ndarray:
        """Distance of points ``[num_envs, points, 2]`` to the nearest cell that is not solid; 0: outside."""
        cell = np.floor(place)
        known = ((cell >= 0) & (cell < np.array(self.solid.shape[1:]) - 2 * DEEPEST)).all(-1)
        x, y = (np.where(known, cell[..., axis], 0).astype(int) + DEEPEST for axis in (0, 1))
        depth = np.maximum(-place[..., 1], 0.0)  # beside the world there is the floor alone
        env, point = np.nonzero(known & self.solid[self.design[:, None], x, y])
        x, y, part = x[env, point], y[env, point], (place - cell)[env, point]
        best = np.full(len(env), float(DEEPEST))
        for dx, dy in itertools.product(range(-DEEPEST, DEEPEST + 1), repeat=2):
            gap = np.hypot(_gap(part[:, 0], dx), _gap(part[:, 1], dy))
            best = np.where(self.solid[self.design[env], x + dx, y + dy], best, np.minimum(best, gap))
        depth[env, point] = best
        return depth


def _gap(part: np.ndarray, cells: int) -> np.ndarray:
    """Way along an axis from a place in a cell to the cell so many further."""
    if cells == 0:
        return np.zeros_like(part)
    return cells - part if cells > 0 else part - cells - 1


def _free_points(sim: Any, name: str) -> np.ndarray:
    """bool ``[num_envs, points]``: points of an object that can move."""
    free, points = np.zeros((sim.num_envs, sim.num_points(name)), bool), sim.rows_of(name)[:, ::2]
    real = points.cumsum(1) - 1
    env, column = points.nonzero(as_tuple=True)
    free[env, real[env, column]] = ~sim.fixed_rows[:, ::2][env, column]
    return free


def bodies_for(task: str, count: int, largest: int, seed: int) -> list[np.ndarray]:
    """Random bodies that fit into a task's world: the first a single voxel, the others of drawn sizes."""
    rng = np.random.default_rng([seed, count])
    bodies = [np.array([[3]], np.int8)]
    while len(bodies) < count:
        shape = tuple(int(n) for n in rng.integers(2, largest + 1, 2))
        body = sample_design(shape, seed=int(rng.integers(2**31)))
        try:
            task_world(get_task(task), body)
        except WorldError:
            continue  # too large for this world: another size is drawn
        bodies.append(body)
    return bodies


class _Actions:
    """Environment k acts in way ``k % len(WAYS)``."""

    def __init__(self, env: VoxelVecEnv, seed: int) -> None:
        self.shape = (env.num_envs, env.num_actions)
        self.way = torch.arange(env.num_envs) % len(WAYS)
        self.draw = torch.Generator().manual_seed(seed)

    def __call__(self, step: int) -> torch.Tensor:
        drawn = torch.rand(self.shape, generator=self.draw, dtype=torch.float64)
        pulse = {"low": 0, "high": 1, "alternating": step % 2, "slow": step // 10 % 2}
        out = ACTION_LOW + (ACTION_HIGH - ACTION_LOW) * drawn
        for k, way in enumerate(WAYS):
            mine = (self.way == k)[:, None]
            if way in pulse:
                out = torch.where(mine, ACTION_HIGH if pulse[way] else ACTION_LOW, out)
            elif way == "wild":
                out = torch.where(mine, 1e6 * (2 * drawn - 1), out)
        return out


def _throw(env: VoxelVecEnv, draw: torch.Generator) -> None:
    state = env.sim.state()
    vel = state["vel"]
    kick = THROW_SPEED * (2 * torch.rand((env.num_envs, 1, 2), generator=draw, dtype=torch.float64) - 1)
    chosen = torch.rand((env.num_envs, 1), generator=draw) < 1 / 8
    free = _rows(env.sim, False)
    whole = kick.expand(-1, vel.shape[1] // 2, -1).reshape(env.num_envs, -1)
    state["vel"] = torch.where(chosen & free, vel + whole, vel)
    env.sim.set_state(state)


def _rows(sim: Any, fixed: bool) -> torch.Tensor:
    """bool ``[num_envs, rows of the state]``: coordinates of points that are fixed or can move.

    Those of objects that episodes begin in another place are neither.
    """
    names = [name for name in sim.object_names if name not in sim.loose]
    chosen = torch.stack([sim.rows_of(name) for name in names]).any(0)
    return chosen & (sim.fixed_rows == fixed)


def stress(env: VoxelVecEnv, control_steps: int, seed: int) -> Findings:
    """Take at least so many control steps, of all environments together, and say what was found."""
    found, actions, depths = Findings(), _Actions(env, seed), Depths(env)
    draw = torch.Generator().manual_seed(seed + 1)
    fixed = _rows(env.sim, True)
    env.reset(seed)
    home = env.sim.state()["pos"][fixed].clone()
    began = time.perf_counter()
    for step in range(-(-control_steps // env.num_envs)):
        if step % THROW_EVERY == THROW_EVERY - 1:
            _throw(env, draw)
        obs, reward, _, _, info = env.step(actions(step))
        values = (obs, reward, info["final_obs"], *info["reward_terms"].values())
        found.not_finite += sum(int((~torch.isfinite(value)).sum()) for value in values)
        found.diverged += int(info["diverged"].sum())
        found.unstable += int(info["unstable"].sum())
        found.overflow += int(env.sim.overflow.sum())
        if step % LOOK_EVERY == 0:
            found.depth = max(found.depth, float(depths().max()))
            found.moved += int((env.sim.state()["pos"][fixed] != home).sum())
        found.steps += env.num_envs
    found.seconds = time.perf_counter() - began
    return found


def run(config: Any, report: Report) -> dict[str, Any]:
    """A row a task.

    Raises:
        TaskError: unknown task.
    """
    options = config.stress
    tasks = [get_task(task).id for task in config.tasks] or task_ids()
    found: dict[str, Findings] = {}
    for place, task in enumerate(tasks):
        with report.status(f"{task} ({place + 1} of {len(tasks)})"):
            bodies = bodies_for(task, options.bodies, options.largest, config.seed)
            env = make_vec(
                task,
                bodies,
                LANES * len(bodies),
                device=config.device,
                dtype=config.dtype,
                arithmetic=config.arithmetic,
                threads=config.threads,
                seed=config.seed,
            )
            found[task] = one = stress(env, options.steps, config.seed)
        echo(report.console, f"{task}: {', '.join(f'{n} {v:.10g}' for n, v in vars(one).items())}")
    _show(report, found)
    wrong = [task for task, one in found.items() if one.not_finite or one.moved or one.depth > options.depth]
    return {"tasks": {task: vars(one) for task, one in found.items()}, "failed": wrong}


def _show(report: Report, found: dict[str, Findings]) -> None:
    headings = ["task", "control steps", "not finite", "fixed points moved", "deepest (voxels)"]
    headings += ["unstable", "diverged", "left out", "steps/s"]
    rows = [
        [
            task,
            f"{one.steps:,}",
            *(str(n) for n in (one.not_finite, one.moved)),
            f"{one.depth:.2f}",
            *(f"{n:,}" for n in (one.unstable, one.diverged, one.overflow)),
            number(one.steps / one.seconds),
        ]
        for task, one in found.items()
    ]
    report.table("Tasks under stress", headings, rows)
    report.note(f"In all {sum(one.steps for one in found.values()):,} control steps.")
