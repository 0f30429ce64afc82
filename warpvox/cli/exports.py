"""Rollouts of trained runs, and the files made from them."""

from __future__ import annotations

import time
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from warpvox.io.console import echo, shown
from warpvox.runs import Run

if TYPE_CHECKING:
    from warpvox.view.rollout import Rollout

__all__ = [
    "ROLLOUT",
    "record_agent",
    "record_run",
    "tiles_of",
    "write_exports",
]

ROLLOUT = "rollout.npz"
# format -> file, module, function
WRITERS = {
    "usd": ("rollout.usd", "warpvox.view.usd", "write_usd"),
    "gif": ("rollout.gif", "warpvox.view.render", "write_gif"),
    "mp4": ("rollout.mp4", "warpvox.view.render", "write_mp4"),
    "html": ("rollout.html", "warpvox.view.player", "write_html"),
    "png": ("rollout.png", "warpvox.view.render", "write_png"),
    "strip": ("rollout_strip.png", "warpvox.view.render", "write_filmstrip"),
}
TILED = ("gif", "mp4", "png")
SIZED = (*TILED, "strip")
THINNED = {"usd": "stride", "gif": "every", "mp4": "every", "html": "every"}
"""What a writer calls the key ``every``."""
FILMS = ("gif", "mp4")
MEASURED, LONG = 2.0, 20.0
"""Seconds after which the rest of a film is estimated, and from which on that is worth a line."""
TILES, BODIES = 16, 36
"""Environments that a picture shows at most; of a run over many bodies."""
LARGE = (960, 540)
"""Size of pictures of more than :data:`TILES`, in pixels."""


def record_run(run: Run, env: Any, controller: Any, steps: int | None, stochastic: bool = False) -> Rollout:
    """One episode of every environment; of several bodies the best first.

    ``stochastic``: whether ``controller`` samples its actions.
    """
    from warpvox.view.rollout import record

    about: dict[str, Any] = {"run": run.folder.name, "stochastic": stochastic}
    if env.num_designs > 1:
        about["names"] = [f"body {design}" for design in env.design_index.tolist()]
    rollout = record(env, controller, steps, metadata=about)
    rollout.metadata["drawn"] = stochastic or env.spec.is_random
    return rollout.best_first() if env.num_designs > 1 else rollout


def record_agent(config: Any) -> Rollout:
    """One episode of every environment under an agent that needs no training.

    Args:
        config: play's configuration with an agent.
    """
    from warpvox.algos.training.bodies import load_bodies
    from warpvox.envs.vec_env import make_vec
    from warpvox.view.rollout import record

    env = make_vec(
        config.task or "Walker-v0",
        load_bodies("walker" if config.design is None else config.design, config.seed or 0),
        config.num_envs,
        device=config.device,
        rules=config.rules or "evogym",
        dtype=config.dtype or "float32",
        arithmetic=config.arithmetic,
        seed=config.seed or 0,
        auto_reset=False,
        threads=config.threads,
        memory_check=config.memory_check,
    )
    return record(env, config.agent, config.steps)


def tiles_of(rollout: Rollout, most: int = BODIES) -> list[int]:
    """The environments that a picture shows: the first ones; of many bodies some, evenly chosen by their returns."""
    if "names" not in rollout.metadata:
        return list(range(min(rollout.num_envs, TILES)))
    return np.linspace(0, rollout.num_envs - 1, min(rollout.num_envs, most)).round().astype(int).tolist()


def write_exports(
    rollout: Rollout,
    folder: Path,
    formats: list[str],
    console: Console,
    size: list[int] | None = None,
    every: int = 1,
) -> list[Path]:
    """Write each format, say what there is (the rollout itself, if it was written, first); returns the paths.

    ``every``: show every n-th control step only; films then run n times as fast.
    """
    written = [folder / ROLLOUT] if (folder / ROLLOUT).is_file() else []
    for name in dict.fromkeys(formats):
        file, module, function = WRITERS[name]
        with console.status(f"writing {file}"):
            options: dict[str, Any] = {"size": tuple(size)} if size and name in SIZED else {}
            if name in TILED:
                options["envs"] = tiles_of(rollout)
                if len(options["envs"]) > TILES:
                    options = {"size": LARGE} | options
            if name in THINNED:
                options[THINNED[name]] = every
            if name in FILMS:
                options["on_frame"] = Estimate(file, console)
            getattr(import_module(module), function)(rollout, folder / file, **options)
        written.append(folder / file)
    for path in written:
        echo(console, f"{shown(path)}  ({_size(path)})")
    return written


class Estimate:
    """Says how many pictures a film will have and how long it will take, if that is long; an ``on_frame`` of films."""

    def __init__(self, file: str, console: Console) -> None:
        self.file, self.console, self.began, self.told = file, console, time.monotonic(), False

    def __call__(self, done: int, total: int) -> None:
        seconds = time.monotonic() - self.began
        if self.told or done < 2 or seconds < MEASURED:
            return
        self.told = True
        left = seconds / done * (total - done)
        if left >= LONG:
            words = f"{left / 60:.0f} minutes" if left >= 120 else f"{left:.0f} seconds"
            echo(self.console, f"{self.file}: {total:,} pictures, about {words} more; every=N makes fewer")


def _size(path: Path) -> str:
    size = path.stat().st_size
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"
