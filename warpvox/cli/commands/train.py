"""``warpvox train``: trains a policy and writes it to a run folder."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, cast

from rich.console import Console

from warpvox.algos.find import find_run
from warpvox.configs.train import TrainConfig
from warpvox.runs import TRAINING

if TYPE_CHECKING:
    from warpvox.algos.training.job import Job


def make_job(config: TrainConfig, given: Collection[str]) -> Job:
    """Create the training job of the settings; ``given``: keys that must agree with a pretrained policy."""
    from warpvox.algos.training.job import Job

    if config.resume is None:
        return Job(config, given)
    return Job(config, source=find_run(config.resume, config.output_dir, TRAINING, resume=True))


def check(config: TrainConfig, given: Collection[str]) -> None:
    """Raise an error if the task, body, policy or device of the settings does not exist."""
    make_job(config, given).check()


def run(config: TrainConfig, given: Collection[str], console: Console) -> Path:
    """Train a policy, export its best version if requested, and return the run's folder."""
    from warpvox.devices.startup import prepare
    from warpvox.progress.training import Terminal, with_tracker

    job = make_job(config, given)

    def show() -> None:
        """Record an episode of the best policy and write the formats in ``export``."""
        if not config.export:
            return
        from warpvox.algos.training.playing import load_result
        from warpvox.cli.exports import ROLLOUT, print_returns, record_run, write_exports

        folder = cast(Path, job.folder)
        trained = find_run(str(folder), config.output_dir)
        with console.status("simulating"):
            rollout = record_run(trained, *load_result(trained, config, config.device), None)
        print_returns(rollout, console)
        rollout.save(folder / ROLLOUT)
        write_exports(rollout, folder, config.export, console)

    prepare(config.torch_threads, config.seed)
    job.train(with_tracker(config.logger, [Terminal(console)]), finish=show)
    return cast(Path, job.folder)
