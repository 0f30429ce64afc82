"""Recording of rollouts for commands, and the files and tables written from them."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.status import Status
from rich.table import Table

from warpvox.algos.protocols import NOMINAL
from warpvox.examples import design_for
from warpvox.io.console import echo, literal
from warpvox.io.text import shown
from warpvox.runs import Run

if TYPE_CHECKING:
    from warpvox.view.rollout import Rollout

ROLLOUT = "rollout.npz"
_TILES = 16
"""Most environments in a picture, except for runs over many bodies."""
LARGE = (960, 540)
"""Size of a window, and of pictures with more than :data:`_TILES` environments, in pixels."""


def record_run(
    run: Run, env: Any, controller: Any, steps: int | None, stochastic: bool = False, protocol: str = NOMINAL
) -> Rollout:
    """Record one episode of a run's policy in every environment; several bodies are sorted by return.

    ``stochastic``: whether ``controller`` samples its actions; ``protocol``: by which it is disturbed.
    """
    from warpvox.view.rollout import record

    about: dict[str, Any] = {"run": run.folder.name, "stochastic": stochastic, "protocol": protocol}
    names = [[f"body {design}" for design in env.design_index.tolist()]] if env.num_designs > 1 else []
    names += [controller.names] if len(getattr(controller, "parts", ())) > 1 else []
    if names:
        about["names"] = list(map(", ".join, zip(*names, strict=True)))
    rollout = record(env, controller, steps, metadata=about)
    rollout.metadata["drawn"] = stochastic or protocol != NOMINAL or env.spec.is_random
    return rollout.best_first() if env.num_designs > 1 else rollout


def record_agent(config: Any) -> Rollout:
    """Record one episode of an untrained agent in every environment."""
    from warpvox.algos.training.bodies import load_bodies
    from warpvox.algos.training.playing import SHOWN
    from warpvox.envs.vec_env import make_vec
    from warpvox.view.rollout import record

    task = config.task or "Walker-v0"
    bodies = load_bodies(design_for(task, "walker" if config.design is None else config.design), config.seed or 0)
    env = make_vec(
        task,
        bodies,
        config.num_envs or len(bodies) * (1 if config.agent == "zero" else SHOWN),
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


def tiles_of(rollout: Rollout, most: int = 36) -> list[int]:
    """Choose the environments shown in a picture: the first ones, or evenly spaced ones of a rollout with names."""
    if "names" not in rollout.metadata:
        return list(range(min(rollout.num_envs, _TILES)))
    return np.linspace(0, rollout.num_envs - 1, min(rollout.num_envs, most)).round().astype(int).tolist()


def check_exports(formats: list[str], size: Any) -> None:
    """Raise RolloutError if an export format cannot be written; called before any simulation."""
    if "mp4" in formats:
        from warpvox.view.render import check_mp4

        check_mp4(size or LARGE)


def write_exports(
    rollout: Rollout, folder: Path, formats: list[str], console: Console, size: list[int] | None = None, every: int = 1
) -> None:
    """Export a rollout in each format to ``folder``, and print the paths.

    ``every``: show every n-th control step only; films then run n times as fast.
    """
    written = [folder / ROLLOUT] if (folder / ROLLOUT).is_file() else []
    for name in dict.fromkeys(formats):
        # File name, module and function by format
        writers = {
            "usd": ("rollout.usd", "warpvox.view.usd", "write_usd"),
            "gif": ("rollout.gif", "warpvox.view.render", "write_gif"),
            "mp4": ("rollout.mp4", "warpvox.view.render", "write_mp4"),
            "html": ("rollout.html", "warpvox.view.player", "write_html"),
            "png": ("rollout.png", "warpvox.view.render", "write_png"),
            "strip": ("rollout_strip.png", "warpvox.view.render", "write_filmstrip"),
        }
        file, module, function = writers[name]
        with console.status(f"writing {file}") as status:
            options: dict[str, Any] = {}
            tiled = ("gif", "mp4", "png")
            if size and name in (*tiled, "strip"):
                options["size"] = tuple(size)
            if name in tiled:
                options["envs"] = tiles_of(rollout)
                if len(options["envs"]) > _TILES:
                    options = {"size": LARGE} | options
            # Name of the writer's parameter for the key `every`
            thinned = {"usd": "stride", "gif": "every", "mp4": "every", "html": "every"}
            if name in thinned:
                options[thinned[name]] = every
            # Films take long: show progress.
            if name in ("gif", "mp4"):

                def tell(done: int, total: int, status: Status = status, file: str = file) -> None:
                    status.update(f"writing {file}: {done:,} of {total:,} pictures; every=N makes fewer")

                options["on_frame"] = tell
            getattr(import_module(module), function)(rollout, folder / file, **options)
        written.append(folder / file)
    for path in written:
        large = path.stat().st_size
        echo(console, f"{shown(path)}  ({f'{large / 1e6:.1f} MB' if large >= 1e6 else f'{large / 1e3:.0f} kB'})")
    if "html" in formats:
        echo(console, f"open in a browser: {(folder / writers['html'][0]).resolve().as_uri()}")


def print_returns(rollout: Rollout, console: Console) -> None:
    """Print a table of the first environments' returns and the mean over all."""
    returns = rollout.returns[-1]
    lengths = rollout.lengths
    several = len(rollout.scenes) > 1 and "names" not in rollout.metadata
    agent = rollout.metadata.get("agent", "policy")
    sampled = rollout.metadata.get("stochastic")
    protocol = rollout.metadata.get("protocol", NOMINAL)
    kinds = ["sampled actions"] * bool(sampled) + [f"protocol {protocol}"] * (protocol != NOMINAL)
    kind = (", ".join(kinds) or "deterministic") if agent == "policy" else f"agent {agent}"
    if rollout.metadata.get("diverged"):
        kind = f"up to the step in which environment {rollout.metadata.get('environment')} diverged"
    table = Table(title=literal(f"{rollout.title}, {kind}"))
    for heading in ("environment", *(["design"] if several else []), "return", "steps", "end"):
        table.add_column(heading, justify="left" if heading == "end" else "right")
    most = 20  # environments that the table shows
    for env in range(min(rollout.num_envs, most)):
        design = [str(rollout.design_index[env])] if several else []
        row = f"{returns[env]:.3f}", str(lengths[env]), _reason_of_end(rollout, env)
        table.add_row(literal(rollout.names[env]), *design, *row)
    if rollout.num_envs > most:
        table.add_row("...", *([""] if several else []), "", "", f"{rollout.num_envs - most} more")
    if rollout.num_envs > 1:
        table.add_section()
        mean = [f"{returns.mean():.3f}", f"{lengths.mean():.0f}", f"deviation {np.std(returns):.3f}"]
        table.add_row("mean", *([""] if several else []), *mean)
    console.print(table)
    if agent == "policy" and rollout.num_envs > len(rollout.scenes) and rollout.metadata.get("drawn") is False:
        # A deterministic policy in a deterministic task has one distinct episode for each design.
        designs = len(rollout.scenes)
        alike = "are identical"
        for design in range(designs):
            if len(np.unique(returns[rollout.design_index == design])) > 1:
                alike = "differ by rounding alone (of batched matrix products)"
        echo(
            console,
            f"the {rollout.num_envs} episodes {alike}: the task draws nothing at random and the policy is"
            f" deterministic; num_envs={designs} shows as much, stochastic=true samples its actions",
        )


def _reason_of_end(rollout: Rollout, env: int) -> str:
    """Return, as text, why the episode of an environment ended."""
    if not rollout.num_steps or not rollout.done[-1, env]:
        return "still going"
    if rollout.metadata.get("diverged"):
        return "diverged"
    return "task ended" if rollout.terminated[-1, env] else "time limit"
