"""``warpvox export``: a run's rollout, or one that was recorded before, as files: one format or several."""

from __future__ import annotations

import dataclasses
from typing import Any

from rich.console import Console

from warpvox.cli.config import expand, load, read_arguments
from warpvox.cli.exports import check_formats, check_size
from warpvox.cli.play import play_run, write_results
from warpvox.cli.runs import check_name
from warpvox.cli.train import describe
from warpvox.files import check_writable

__all__ = ["run"]


def run(words: list[str]) -> None:
    """Do what ``warpvox export`` is asked for."""
    arguments = read_arguments(words)
    if describe("export", arguments):
        return
    for overrides in expand(arguments, "export"):
        _export(load("export", overrides, arguments.config_dir), Console())


def _export(config: Any, console: Console) -> None:
    formats = check_formats(config.format, "format")
    check_size(config.size)
    check_name(config.name)
    check_writable(config.output_dir)
    if config.rollout is None:
        rollout, source = play_run(config, console)
    else:
        from warpvox.rollout import Rollout

        rollout, source = Rollout.load(config.rollout), config.rollout
        config = dataclasses.replace(config, run="")  # the run that is named by default has no part in it
    write_results(rollout, config, source, "export", formats, console, keep=config.rollout is None)
