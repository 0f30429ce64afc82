"""``warpvox bench suite=precision``: how far float32 is from float64, and how far chaos alone takes float64.

Two questions. How do positions drift apart, step by step, from the same state under the same actions; near the origin,
at x = 9 far from it, and for bodies of 35 x 35 voxels? And what becomes of returns over whole episodes? Both are asked
again of float64 with noise on its actions, of 1e-10 and of 1e-7, which is what rounding them to float32 would do:
what that changes is chaos and no matter of how the simulation computes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from warpvox.bench.bodies import full_body
from warpvox.bench.report import Report, number
from warpvox.design import sample_design
from warpvox.envs.vec_env import make_vec
from warpvox.simulation import Simulation
from warpvox.types import VOXEL, Cell
from warpvox.world import World

__all__ = ["compare", "drift", "run"]

NOISES = (1e-10, 1e-7)
"""Half-widths of the noise on the actions of further float64 runs."""
GRID = 1024
"""Actions are whole multiples of 1 / GRID, exact in every precision."""
HORIZONS = (1, 2, 5, 10, 20, 50, 100)
FAR = 90
"""Cells from the origin: x = 9."""
LARGE, FEW = 35, 8
"""Side of the large bodies, and how many are looked at."""
OTHERS = {"float32": ("float32", 0.0)} | {f"float64, actions + {noise:.0e}": ("float64", noise) for noise in NOISES}
"""What is compared with float64: precision and noise."""


def run(config: Any, report: Report) -> dict[str, Any]:
    """Drift of positions in three places, and returns under two kinds of actions."""
    bodies = [sample_design((5, 5), seed=config.seed + k) for k in range(config.designs)]
    large = [full_body(LARGE, config.seed + k) for k in range(min(FEW, config.designs))]
    places = {
        f"{len(bodies)} random bodies of 5 x 5 at x = 0.1": (bodies, 1),
        f"the same at x = {FAR * VOXEL:g}": (bodies, FAR),
        f"{len(large)} full bodies of {LARGE} x {LARGE} at x = 0.1": (large, 1),
    }
    drifts: dict[str, Any] = {}
    for name, (some, column) in places.items():
        with report.status(f"simulating {name}"):
            drifts[name] = drift(config, some, column)
    _show_drifts(report, drifts)
    returns: dict[str, Any] = {}
    for kind in ("sine", "noise"):
        with report.status(f"simulating episodes, {kind}"):
            exact = _returns(config, bodies, kind, "float64", 0.0)
            others = {name: _returns(config, bodies, kind, *how) for name, how in OTHERS.items()}
        returns[kind] = {name: compare(exact, values) for name, values in others.items()}
    _show_returns(config, report, returns)
    report.plot("precision", lambda figure: _draw(figure, drifts))
    return {"task": config.task, "designs": config.designs, "noise": NOISES, "drift": drifts, "returns": returns}


def drift(config: Any, bodies: list[np.ndarray], column: int) -> dict[str, Any]:
    """How far any coordinate of a body is from where float64 has it, at most: median and most over the bodies.

    By the steps of HORIZONS, in simulator units; under sine waves on flat ground.
    """
    rng = np.random.default_rng(config.seed)
    exact = _flat(config, bodies, column, "float64")
    others = {name: (_flat(config, bodies, column, dtype), noise) for name, (dtype, noise) in OTHERS.items()}
    shape = (len(bodies), exact.num_actions)
    rate, phase = rng.uniform(0.01, 0.1, shape), rng.uniform(0.0, 1.0, shape)
    found: dict[str, dict[str, list[float]]] = {name: {"median": [], "most": []} for name in OTHERS}
    for step in range(1, HORIZONS[-1] + 1):
        actions = _on_grid(1.1 + 0.5 * np.sin(2 * np.pi * (rate * step + phase)))
        exact.step(torch.as_tensor(actions))
        for sim, noise in others.values():
            sim.step(torch.as_tensor(actions + noise * rng.uniform(-1.0, 1.0, shape)))
        if step in HORIZONS:
            # the state itself: positions that are returned are rounded to the simulation's dtype
            here = exact.state()["pos"]
            for name, (sim, _) in others.items():
                apart = (sim.state()["pos"] - here).abs().flatten(1).amax(1).cpu()
                found[name]["median"].append(float(apart.median()))
                found[name]["most"].append(float(apart.max()))
    return {"steps": list(HORIZONS), **found}


def _flat(config: Any, bodies: list[np.ndarray], column: int, dtype: str) -> Simulation:
    worlds = []
    for body in bodies:
        world = World()
        world.add_from_array("ground", np.full((1, 2 * FAR), int(Cell.FIXED)), 0, 0)
        world.add_from_array("robot", body, column, 1)
        worlds.append(world)
    return Simulation(worlds, device=config.device, dtype=dtype, threads=config.threads)


def compare(exact: np.ndarray, other: np.ndarray) -> dict[str, float]:
    """How far two sets of returns are apart.

    Mean and median absolute difference, both also relative to the range; median of the differences relative to the
    returns themselves; rank correlation.
    """
    apart = np.abs(exact - other)
    ranks = [np.argsort(np.argsort(values)) for values in (exact, other)]
    return {
        "mean_difference": float(apart.mean()),
        "mean_of_range": float(apart.mean() / np.ptp(exact)),
        "median_difference": float(np.median(apart)),
        "median_of_range": float(np.median(apart) / np.ptp(exact)),
        "median_relative": float(np.median(apart / np.abs(exact))),
        "rank_correlation": float(np.corrcoef(*ranks)[0, 1]),
    }


def _returns(config: Any, bodies: list[np.ndarray], kind: str, dtype: str, noise: float) -> np.ndarray:
    """float64 [bodies]: return of one episode of each."""
    options = dict(device=config.device, dtype=dtype, auto_reset=False, threads=config.threads)
    env = make_vec(config.task, bodies, len(bodies), **options)
    env.reset()
    rng = np.random.default_rng(config.seed)
    shape = (env.num_envs, env.num_actions)
    rate, phase = rng.uniform(0.01, 0.1, shape), rng.uniform(0.0, 1.0, shape)
    total = torch.zeros(env.num_envs, dtype=torch.float64, device=env.device)
    for t in range(env.max_episode_steps):
        waves = 1.1 + 0.5 * np.sin(2 * np.pi * (rate * t + phase))
        actions = _on_grid(waves if kind == "sine" else rng.uniform(0.6, 1.6, shape))
        actions += noise * np.random.default_rng([config.seed, t]).uniform(-1.0, 1.0, shape)
        total += env.step(torch.as_tensor(actions))[1].double()
    return total.cpu().numpy()


def _on_grid(actions: np.ndarray) -> np.ndarray:
    return np.rint(actions * GRID) / GRID


def _show_drifts(report: Report, drifts: dict[str, Any]) -> None:
    rows = [
        [f"{name}: {what}", *(number(value, 2) for value in found[what]["median"])]
        for name, found in drifts.items()
        for what in OTHERS
    ]
    title = "Distance from float64 after so many control steps, in simulator units (a voxel is 0.1)"
    report.table(f"{title}: the largest of a body, median of the bodies", ["", *(str(step) for step in HORIZONS)], rows)


def _show_returns(config: Any, report: Report, returns: dict[str, Any]) -> None:
    headings = ["mean difference", "of the range", "median difference", "of the range", "of the return", "rank corr."]
    rows = [
        [
            f"{kind}, {name}",
            number(row["mean_difference"]),
            f"{row['mean_of_range']:.2%}",
            number(row["median_difference"]),
            f"{row['median_of_range']:.2%}",
            f"{row['median_relative']:.2%}",
            f"{row['rank_correlation']:.4f}",
        ]
        for kind, found in returns.items()
        for name, row in found.items()
    ]
    title = f"{config.task}: returns of {config.designs} random bodies, whole episodes, against float64"
    report.table(title, ["actions, computed", *headings], rows)


def _draw(figure: Any, drifts: dict[str, Any]) -> None:
    axes = figure.subplots()
    for colour, (name, found) in zip(("C0", "C1", "C2"), drifts.items(), strict=True):
        for what, style in zip(OTHERS, ("o-", "x:", "+--"), strict=True):
            axes.plot(found["steps"], found[what]["median"], style, color=colour, label=f"{name}, {what}")
    axes.set(xscale="log", yscale="log", xlabel="control steps", ylabel="distance from float64, simulator units")
    axes.grid(which="both", alpha=0.3)
    axes.legend(fontsize=7)
