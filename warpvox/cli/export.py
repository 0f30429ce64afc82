"""``warpvox export``: a run's rollout as files, one format or several."""

from __future__ import annotations

from rich.console import Console

from warpvox.cli.config import expand, load, read_arguments
from warpvox.cli.exports import check_formats
from warpvox.cli.play import play
from warpvox.cli.train import describe

__all__ = ["run"]


def run(words: list[str]) -> None:
    """Do what ``warpvox export`` is asked for."""
    arguments = read_arguments(words)
    if describe("export", arguments):
        return
    for overrides in expand(arguments, "export"):
        config = load("export", overrides, arguments.config_dir)
        play(config, check_formats(config.format, "format"), Console(), "export")
