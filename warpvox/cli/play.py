"""``warpvox play``: a trained policy without exploration, its returns, and what it did."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from warpvox import __version__
from warpvox.cli.config import expand, load, read_arguments, to_yaml
from warpvox.cli.exports import check_formats, load_run, record_run, write_exports
from warpvox.cli.runs import check_name, find_run, new_folder, write_summary
from warpvox.cli.say import say
from warpvox.cli.train import describe

if TYPE_CHECKING:
    from warpvox.rollout import Rollout

__all__ = ["play", "run"]

ROWS = 20
"""Environments that the table lists at most."""


def run(words: list[str]) -> None:
    """Do what ``warpvox play`` is asked for."""
    arguments = read_arguments(words)
    if describe("play", arguments):
        return
    console = Console()
    for overrides in expand(arguments, "play"):
        config = load("play", overrides, arguments.config_dir)
        play(config, config.export, console, "play")


def play(config: Any, formats: list[str], console: Console, command: str) -> Path:
    """Run one episode everywhere and write it down; returns the folder of the results.

    Raises:
        WarpvoxError: the run, or what is asked of it, is not valid; nothing is written then.
    """
    formats = check_formats(formats, "export") if formats else []
    check_name(config.name)
    source = find_run(config.run, config.output_dir)
    with console.status("loading"):
        from warpvox.cli.build import prepare, shown

        prepare(config.torch_threads, config.seed)
        env, controller = load_run(source, config)
    with console.status("simulating"):
        rollout = record_run(source, env, controller, config.steps)
    resolved = dataclasses.replace(config, run=str(source.checkpoint or source.folder), device=str(env.device))
    task = env.spec.id
    with new_folder(config.output_dir, command, task, config.name, to_yaml(resolved)) as folder:
        say(console, f"run: {shown(source.folder)}")
        print_returns(rollout, console)
        write_exports(rollout, folder, formats, console)
        write_summary(folder, summary_of(rollout, command, task, source.folder))
    return folder


def summary_of(rollout: Rollout, command: str, task: str, run_folder: Path) -> dict[str, Any]:
    """The rollout in figures, for ``summary.json``."""
    returns = rollout.returns[-1]
    return {
        "command": command,
        "task": task,
        "run": str(run_folder),
        "version": __version__,
        "mean_return": float(returns.mean()),
        "returns": [float(value) for value in returns],
        "lengths": [int(value) for value in rollout.lengths],
    }


def print_returns(rollout: Rollout, console: Console) -> None:
    """A table with a row for each environment (the first ones of many) and their mean."""
    returns, lengths = rollout.returns[-1], rollout.lengths
    several = len(rollout.scenes) > 1
    table = Table(title=f"{rollout.title}, deterministic")
    for heading in ("environment", *(["design"] if several else []), "return", "steps", "end"):
        table.add_column(heading, justify="left" if heading == "end" else "right")
    for env in range(min(rollout.num_envs, ROWS)):
        design = [str(rollout.design_index[env])] if several else []
        table.add_row(str(env), *design, f"{returns[env]:.3f}", str(lengths[env]), _end(rollout, env))
    if rollout.num_envs > ROWS:
        table.add_row("...", *([""] if several else []), "", "", f"{rollout.num_envs - ROWS} more")
    if rollout.num_envs > 1:
        table.add_section()
        mean = [f"{returns.mean():.3f}", f"{lengths.mean():.0f}", f"deviation {np.std(returns):.3f}"]
        table.add_row("mean", *([""] if several else []), *mean)
    console.print(table)


def _end(rollout: Rollout, env: int) -> str:
    if not rollout.num_steps or not rollout.done[-1, env]:
        return "still going"
    return "task ended" if rollout.terminated[-1, env] else "time limit"
