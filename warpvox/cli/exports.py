"""Rollouts of trained runs, and the files made from them."""

from __future__ import annotations

import dataclasses
import time
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from warpvox.cli.console import echo, shown
from warpvox.cli.runs import Run
from warpvox.errors import ConfigError

if TYPE_CHECKING:
    from warpvox.robots.entry import Robot
    from warpvox.view.rollout import Rollout

__all__ = [
    "ROLLOUT",
    "draws_at_random",
    "load_run",
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


def load_run(run: Run, config: Any, designs: Any = None, every: bool = False) -> tuple[Any, Any]:
    """Environments and policy of a run as play's configuration ``config`` wants them.

    Args:
        run: the run.
        config: of play.
        designs: bodies for a policy over many bodies; None: those held out, as many as there are environments.
        every: of such a policy, all bodies, the same number of environments for each.

    Raises:
        RunError: no checkpoint, or one that does not fit. ConfigError, DeviceError: ``config`` asks too much, or the
            run has a task of somebody's own that the user has not named.
    """
    if run.robot is not None:
        return _load_robot(run.robot, config, run.folder)
    from warpvox.algos.checkpoints.files import load_controller
    from warpvox.cli.build import make_env, training_lanes
    from warpvox.cli.config import load_values
    from warpvox.cli.designs import grid_of, held_out_of, is_many, read_bodies
    from warpvox.cli.trust import with_code
    from warpvox.devices.names import resolve_device

    device = resolve_device(config.device, config.num_envs)
    path = run.find_checkpoint(config.checkpoint)
    given = {"task": config.task, "policy": config.policy}
    trained = with_code(load_values("train", run.config), given, run.config, run.folder)
    changes = {"device": device, "threads": config.threads, "lanes": training_lanes(trained, device)}
    changes["memory_check"] = config.memory_check
    if config.dtype is not None:
        changes |= {"dtype": config.dtype, "arithmetic": None}
    if config.arithmetic is not None:
        changes["arithmetic"] = config.arithmetic
    if config.seed is not None:
        changes["seed"] = config.seed
    count = config.num_envs
    if is_many(trained):
        bodies = held_out_of(trained) if designs is None else read_bodies(designs, config.seed or 0, "designs")
        if every:
            count = len(bodies) * max(1, count // len(bodies))
        bodies = bodies[:count]
        lanes = trained.lanes if device == "cpu" else None
        changes |= {"lanes": lanes, "grid": grid_of(trained), "designs": bodies}
    elif designs is not None:
        raise ConfigError(
            "Other bodies go with a run over many of them (warpvox train designs=...); this one has its own."
        )
    env = make_env(trained, count, auto_reset=False, **changes)
    controller = load_controller(path, device, trained.policy)
    controller.check(env)
    if config.stochastic:
        from warpvox.algos.checkpoints.sampling import SampledController

        controller = SampledController(controller, trained.seed if config.seed is None else config.seed)
    return env, controller


def _load_robot(robot: Robot, config: Any, file: Path) -> tuple[Any, Any]:
    """Environments and policy of a stored robot; exact, with the recorded seeds, unless asked otherwise."""
    from warpvox.cli.trust import allowed
    from warpvox.code import Code
    from warpvox.devices.names import resolve_device
    from warpvox.envs.registry import get_task, task_ids
    from warpvox.robots.replay import SEEDS, robot_env

    if config.stochastic:
        raise ConfigError("stochastic=true goes with a run; a stored robot has no exploration to sample from.")
    if robot.policy is None:
        why = robot.about.get("no_policy", "there is a body alone.")
        raise ConfigError(f"The robot has no policy: {why} play agent=sine task={robot.task} design=zoo:... moves it.")
    task = allowed("task", robot.task, config.task, file)
    if isinstance(config.task, Code) and task not in task_ids():  # an entry for a task of the user's own has its id
        task = config.task
    robot = dataclasses.replace(robot, task=task)
    count = config.num_envs if get_task(robot.task).is_random else 1  # all episodes would be the same
    options = {
        name: getattr(config, name) for name in ("dtype", "arithmetic", "seed") if getattr(config, name) is not None
    }
    if config.arithmetic == "fast":
        options.setdefault("dtype", "float32")
    options |= {"threads": config.threads, "memory_check": config.memory_check}
    options |= {"device": resolve_device(config.device, count), "num_envs": count}
    seeds = [*SEEDS[:count], *range(SEEDS[-1] + 1, SEEDS[-1] + 1 + count - len(SEEDS))]
    return robot_env(robot, seeds, **options), robot.policy


def record_run(run: Run, env: Any, controller: Any, steps: int | None, stochastic: bool = False) -> Rollout:
    """One episode of every environment; of several bodies the best first.

    ``stochastic``: whether ``controller`` samples its actions.
    """
    from warpvox.view.rollout import record

    about: dict[str, Any] = {"run": run.folder.name, "stochastic": stochastic}
    if env.num_designs > 1:
        about["names"] = [f"body {design}" for design in env.design_index.tolist()]
    rollout = record(env, controller, steps, metadata=about)
    rollout.metadata["drawn"] = stochastic or draws_at_random(env)
    return rollout.best_first() if env.num_designs > 1 else rollout


def draws_at_random(env: Any) -> bool:
    """Whether the episodes of a design begin differently; begins new ones to find out."""
    import torch

    obs, _ = env.reset()
    for design in range(env.num_designs):
        rows = torch.nonzero(env.design_index == design)[:, 0]
        for values in (obs, *env.memory.values()):
            if not torch.equal(values[rows], values[rows[:1]].expand_as(values[rows])):
                return True
    return False


def record_agent(config: Any) -> Rollout:
    """One episode of every environment under an agent that needs no training.

    Args:
        config: play's configuration with an agent.
    """
    from warpvox.cli.build import load_bodies
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
