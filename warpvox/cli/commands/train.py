"""``warpvox train``: from a configuration to a run folder with a trained policy."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, cast

from rich.console import Console

from warpvox.algos.find import find_run
from warpvox.cli.application import run_command
from warpvox.cli.config import load
from warpvox.configs.train import TrainConfig
from warpvox.runs import TRAINING

if TYPE_CHECKING:
    from warpvox.algos.training.job import Job


def run(words: list[str]) -> None:
    run_command("train", words, train, make_job, lambda job: job.check())


def make_job(config: TrainConfig, overrides: list[str], config_dir: Path | None) -> Job:
    """The training of a configuration; with ``resume`` on top of the configuration of the run that it goes on with."""
    from warpvox.algos.training.job import Job

    if config.resume is None:
        return Job(config, {word.partition("=")[0] for word in overrides})
    source = find_run(config.resume, config.output_dir, TRAINING, resume=True)
    names = {item.name for item in dataclasses.fields(TrainConfig)}
    stored = {name: value for name, value in source.config.items() if name in names}
    return Job(load("train", overrides, config_dir, base=stored, home=source.folder), source=source)


def train(job: Job, console: Console) -> Path:
    """Make a run, and record its best policy where exports are asked for; returns its folder."""
    from warpvox.devices.startup import prepare
    from warpvox.progress.training import Terminal, with_tracker

    config = cast(TrainConfig, job.settings)

    class Films(Terminal):
        def end(self, job: Job) -> None:  # before another process may write to the folder
            super().end(job)
            if not config.export or job.summary.get("status") != "done":
                return
            from warpvox.algos.training.playing import load_result
            from warpvox.cli.exports import ROLLOUT, print_returns, record_run, write_exports

            folder, run = cast(Path, job.folder), find_run(str(job.folder), config.output_dir)
            with console.status("simulating"):
                rollout = record_run(run, *load_result(run, config, config.device), None)
            print_returns(rollout, console)
            rollout.save(folder / ROLLOUT)
            write_exports(rollout, folder, config.export, console)

    prepare(config.torch_threads, config.seed)
    job.train(with_tracker(config.logger, [Films(console)]))
    return cast(Path, job.folder)
