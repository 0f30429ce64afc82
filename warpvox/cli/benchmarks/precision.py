"""``warpvox bench suite=precision``: how far float32 returns are from those in float64, and how far chaos is."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

__all__ = ["precision_suite"]

DESIGNS = 50
NOISE = 1e-10
"""Half-width of the noise on the actions of a second float64 run: what differs then is chaos, not precision."""


def precision_suite(config: Any, console: Console) -> dict[str, Any]:
    """Returns of random bodies under sine waves and under noise, each simulated three times."""
    from warpvox.design import sample_design

    bodies = [sample_design((5, 5), seed=config.seed + k) for k in range(DESIGNS)]
    result: dict[str, Any] = {"designs": DESIGNS, "noise": NOISE}
    table = Table(title=f"{config.task}: returns of {DESIGNS} random bodies against float64")
    for heading in ("actions", "computed", "mean |difference|", "of the range", "of the deviation", "rank correlation"):
        table.add_column(heading, justify="left" if heading in ("actions", "computed") else "right")
    for kind in ("sine", "noise"):
        with console.status(f"simulating, {kind}"):
            exact = _returns(config, bodies, kind, "float64", 0.0)
            others = {"float32": _returns(config, bodies, kind, "float32", 0.0)}
            others[f"float64, actions + {NOISE:.0e}"] = _returns(config, bodies, kind, "float64", NOISE)
        for name, values in others.items():
            row = compare(exact, values)
            result[f"{kind}, {name}"] = row
            table.add_row(
                kind,
                name,
                f"{row['mean_difference']:.4f}",
                f"{row['of_range']:.2%}",
                f"{row['of_deviation']:.2%}",
                f"{row['rank_correlation']:.4f}",
            )
    console.print(table)
    return result


def compare(exact: np.ndarray, other: np.ndarray) -> dict[str, float]:
    """Mean absolute difference of two sets of returns, as such and relative to their spread, and rank correlation."""
    difference = float(np.abs(exact - other).mean())
    ranks = [np.argsort(np.argsort(values)) for values in (exact, other)]
    return {
        "mean_difference": difference,
        "of_range": difference / float(np.ptp(exact)),
        "of_deviation": difference / float(exact.std()),
        "rank_correlation": float(np.corrcoef(*ranks)[0, 1]),
    }


def _returns(config: Any, bodies: list[np.ndarray], kind: str, dtype: str, noise: float) -> np.ndarray:
    """float64 [bodies]: return of one episode of each."""
    import torch

    from warpvox.envs.vec_env import make_vec

    options = dict(device=config.device, dtype=dtype, auto_reset=False, threads=config.threads)
    env = make_vec(config.task, bodies, len(bodies), **options)
    env.reset()
    rng = np.random.default_rng(config.seed)
    shape = (env.num_envs, env.num_actions)
    rate, phase = rng.uniform(0.01, 0.1, shape), rng.uniform(0.0, 1.0, shape)
    total = np.zeros(env.num_envs)
    for t in range(env.max_episode_steps):
        actions = 1.1 + 0.5 * np.sin(2 * np.pi * (rate * t + phase)) if kind == "sine" else rng.uniform(0.6, 1.6, shape)
        actions = np.rint(actions * 1024) / 1024  # exact in every precision
        actions += noise * np.random.default_rng([config.seed, t]).uniform(-1.0, 1.0, shape)
        _, reward, _, _, _ = env.step(torch.as_tensor(actions))
        total += reward.double().cpu().numpy()
    return total
