"""Rollouts of trained runs, and the files made from them."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from warpvox.cli.runs import Run
from warpvox.cli.say import say
from warpvox.configs.schema import EXPORTS
from warpvox.errors import ConfigError, did_you_mean, listing

if TYPE_CHECKING:
    from warpvox.rollout import Rollout

__all__ = ["check_formats", "load_run", "record_run", "write_exports"]

ROLLOUT = "rollout.npz"
# format -> file, module, function
WRITERS = {
    "usd": ("rollout.usd", "warpvox.usd", "write_usd"),
    "gif": ("rollout.gif", "warpvox.render", "write_gif"),
    "mp4": ("rollout.mp4", "warpvox.render", "write_mp4"),
    "html": ("rollout.html", "warpvox.player", "write_html"),
}
TILES = 16
"""Environments that a picture shows at most."""


def check_formats(formats: Any, key: str) -> list[str]:
    """The formats as a list, each once.

    Raises:
        ConfigError: something that cannot be written.
    """
    names = [formats] if isinstance(formats, str) else formats
    if not isinstance(names, list) or not names:
        raise ConfigError(f"{key} must be one of {listing(EXPORTS)} or a list of them, got {formats!r}.")
    for name in names:
        if name not in EXPORTS:
            hint = did_you_mean(name, EXPORTS)
            raise ConfigError(f"{key} must be one of {listing(EXPORTS)} or a list of them, got {name!r}.{hint}")
    return list(dict.fromkeys(names))


def load_run(run: Run, config: Any) -> tuple[Any, Any]:
    """Environments and policy of a run as play's configuration ``config`` wants them.

    Raises:
        RunError: no checkpoint, or one that does not fit. ConfigError, DeviceError: ``config`` asks too much.
    """
    from warpvox.algos.checkpoint import load_controller
    from warpvox.cli.build import make_env, training_lanes
    from warpvox.cli.config import load_values
    from warpvox.sim import resolve_device

    device = resolve_device(config.device)
    path = run.find_checkpoint(config.checkpoint)
    trained = load_values("train", run.config)
    changes = {"device": device, "threads": config.threads, "lanes": training_lanes(trained, device)}
    if config.dtype is not None:
        changes["dtype"] = config.dtype
    env = make_env(trained, config.num_envs, auto_reset=False, **changes)
    controller = load_controller(path, device)
    controller.check(env)
    return env, controller


def record_run(run: Run, env: Any, controller: Any, steps: int | None) -> Rollout:
    """One deterministic episode of every environment."""
    from warpvox.rollout import record

    return record(env, controller, steps, metadata={"run": run.folder.name})


def write_exports(rollout: Rollout, folder: Path, formats: list[str], console: Console) -> list[Path]:
    """Write the rollout itself and each format; returns the paths."""
    from warpvox.cli.build import shown

    written = [rollout.save(folder / ROLLOUT)]
    for name in formats:
        file, module, function = WRITERS[name]
        with console.status(f"writing {file}"):
            options = {"envs": list(range(min(rollout.num_envs, TILES)))} if name in ("gif", "mp4") else {}
            getattr(import_module(module), function)(rollout, folder / file, **options)
        written.append(folder / file)
    for path in written:
        say(console, f"{shown(path)}  ({_size(path)})")
    return written


def _size(path: Path) -> str:
    size = path.stat().st_size
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"
