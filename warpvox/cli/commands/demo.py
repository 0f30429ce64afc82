"""``warpvox demo``: from nothing to a walking robot that can be looked at."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from warpvox.cli.application import run_command
from warpvox.cli.commands.play import print_returns
from warpvox.cli.exports import ROLLOUT, record_run, write_exports
from warpvox.code import is_code
from warpvox.configs.schema import DemoConfig
from warpvox.errors import ConfigError
from warpvox.io.console import echo
from warpvox.runs import find_run

__all__ = ["demo", "run"]


def run(words: list[str]) -> None:
    """Train, record the best policy, export it, and say where everything is."""
    run_command("demo", words, demo)


def demo(config: DemoConfig, console: Console) -> Path:
    """Make a demo; returns its folder.

    Raises:
        WarpvoxError: what is asked for is not valid, or the training has failed.
    """
    if config.resume is not None:
        raise ConfigError("A demo starts anew; go on with it by `warpvox train resume=FOLDER`.")
    from warpvox.algos.training.job import Job
    from warpvox.algos.training.progress import Terminal
    from warpvox.cli.process import prepare

    prepare(config.torch_threads, config.seed)
    job = Job(config)
    job.train(Terminal(console), command="demo")
    _show(job.folder, config, console)
    return job.folder


def _show(folder: Path, config: DemoConfig, console: Console) -> None:
    """Record the best policy of a run and write it into the run's folder."""
    from warpvox.algos.training.loading import Playing, load_run

    source = find_run(str(folder), config.output_dir)
    own = config.task if is_code(config.task) else None
    env, controller = load_run(source, Playing(task=own))
    with console.status("simulating"):
        rollout = record_run(source, env, controller, None)
    print_returns(rollout, console)
    rollout.save(folder / ROLLOUT)
    write_exports(rollout, folder, config.export, console)
    page = folder / "rollout.html"
    if page.is_file():
        echo(console, f"open in a browser: {page.resolve().as_uri()}")
