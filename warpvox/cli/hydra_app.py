"""Hydra's own application under our commands: its views, shell completion, sweepers and launchers."""

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import hydra

from warpvox.cli import COMMANDS as NAMES
from warpvox.configs.composition import hydras_errors, register
from warpvox.configs.schema import COMMANDS
from warpvox.errors import ConfigError


def run_hydra(
    command: str | None,
    flags: Sequence[str],
    overrides: Sequence[str] = (),
    config_dir: Path | None = None,
    task: Callable[[Any], Any] = lambda _: None,
) -> None:
    """Do what ``@hydra.main`` does of a command line with these words.

    ConfigError: what Hydra says of a configuration or plugin. Exception: what ``task`` raises.
    """
    if command is not None:
        register(command)
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors are raised, not printed
    place = ["--config-dir", str(config_dir)] if config_dir else []
    words, sys.argv = sys.argv, [sys.argv[0], *flags, *place, *overrides]
    try:
        with hydras_errors():
            hydra.main(version_base="1.3", config_path="pkg://warpvox.configs", config_name=command)(task)()
    finally:
        sys.argv = words


def complete(words: Sequence[str]) -> None:
    """``warpvox -sc install=SHELL``: print code that makes a shell complete our commands, which calls ``query``."""
    line = os.environ.get("COMP_LINE", "").split(" ", 2)
    command = line[1] if len(line) == 3 else None
    if words[:1] and words[0].startswith("query=") and command not in COMMANDS:
        print("\n".join(name for name in NAMES if command is None and name.startswith(line[-1])))
        return
    if command is not None:  # Hydra knows one command only
        os.environ["COMP_LINE"] = f"{line[0]} {line[2]}"
    try:
        run_hydra(command, ["-sc"], words)
    except ValueError as error:
        raise ConfigError(f"-sc needs install=SHELL or uninstall=SHELL. {' '.join(str(error).split())}.") from None
