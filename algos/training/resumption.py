"""Continuing a training: what may change, and from which checkpoint."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.training.settings import Training
from warpvox.errors import RunError
from warpvox.io.console import shell_argument
from warpvox.io.writing import check_writable
from warpvox.runs import STATE, Run, check_unchanged, read_summary
from warpvox.trust import as_stored

if TYPE_CHECKING:
    from warpvox.algos.training.runner import Runner

__all__ = ["CHANGEABLE", "check_left", "continued"]

CHANGEABLE = (
    "max_iterations", "eval_interval", "eval_envs", "stop_return", "save_interval", "device", "threads",
    "torch_threads", "cuda_graph", "logger", "nan_guard", "memory_check", "resume", "output_dir",
)  # fmt: skip
"""Keys that may differ when a run is resumed: they do not change what is learned.

But for rounding: another device, or other ``torch_threads``, adds up the products of matrices in another order.
"""


def continued(settings: Training, source: Run) -> tuple[Training, Path]:
    """The settings of a run that goes on, and the checkpoint that it goes on from.

    Raises:
        ConfigError: settings that would make it another run. RunError, StorageError: it cannot go on.
    """
    check_writable(source.folder)
    named = dataclasses.replace(settings, task=getattr(settings.task, "id", settings.task))
    check_unchanged(source.config, as_stored(named, source.config), CHANGEABLE)
    checkpoint = source.checkpoint or source.folder / STATE
    if not checkpoint.is_file():
        raise RunError(
            f"The run {source.folder} cannot be resumed: it has no {STATE}. If it was stopped before its first"
            " iteration, start it again."
        )
    try:
        load_checkpoint(checkpoint)
    except RunError as error:
        reason = str(error).rstrip(".")
        for number in reversed(source.iterations):
            other = source.folder / f"model_{number}.pt"
            with suppress(RunError):
                load_checkpoint(other)
                reason += f". The newest checkpoint that can be read is that of iteration {number}; go on from there,"
                reason += f" with new episodes: warpvox train {shell_argument('resume', other)}"
                break
        else:
            reason += ", and there is no other checkpoint: start the run again."
        raise RunError(reason) from None
    return dataclasses.replace(settings, resume=None), checkpoint


def check_left(folder: Path, runner: Runner) -> None:
    """Raise RunError, with what to type instead, if a resumed run has nothing left to do.

    One that was killed between its last iteration and its summary is let through: the summary is left.
    """
    done, total, goal = runner.current_learning_iteration, runner.schedule.total, runner.schedule.stop_return
    again = f"go on with: warpvox train {shell_argument('resume', folder)}"
    ended = read_summary(folder).get("status") == "done"  # a run that was killed in its last moment has no summary
    if done > total or (ended and done == total):
        raise RunError(
            f"The run has already made {done} iterations, and max_iterations={total} asks for no more;"
            f" {again} max_iterations={2 * done}"
        )
    if ended and goal is not None and runner.last_return >= goal:
        raise RunError(
            f"The run has ended because an evaluation ({runner.last_return:.3f}) has already reached"
            f" stop_return={goal:g}; {again} stop_return=null"
        )
