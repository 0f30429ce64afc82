"""What Hydra's own application offers, under our commands: ``--info``, shell completion, launchers and sweepers.

The rest of ``@hydra.main`` is not used: it makes a run's folder before the command can check its configuration,
ends with code 1 and several lines, begins a sweep before all of its runs are checked, and cannot read many paths.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hydra.errors import HydraException
from omegaconf.errors import OmegaConfBaseException

from warpvox.configs.composition import opened, quoted
from warpvox.configs.schema import COMMANDS
from warpvox.errors import ConfigError, listing

__all__ = ["CFG", "INFO", "complete", "is_plugin_key", "multirun", "one_line", "show"]

CFG = ("job", "hydra", "all")
INFO = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")
SHELLS = ("bash", "zsh", "fish")
PLUGINS = ("hydra/launcher", "hydra/sweeper", "hydra.launcher", "hydra.sweeper")
QUIET = (
    "hydra/job_logging=none",
    "hydra/hydra_logging=none",
    "hydra.output_subdir=null",
    "hydra.sweep.subdir=.",
)


def one_line(error: Exception) -> str:
    """Where and what: the first two lines of an error of Hydra; those below are its inner names."""
    return " ".join([line.strip() for line in str(error).splitlines() if line.strip()][:2])


def show(name: str, overrides: list[str], config_dir: Path | None, cfg: str | None, info: str | None) -> None:
    """Print what Hydra's own ``--cfg`` or ``--info`` prints of the configuration ``name``."""
    log = logging.getLogger()
    handlers, level = list(log.handlers), log.level
    try:
        with _errors(), opened(config_dir) as (hydra, search):
            if info:  # by messages of a log that it sends to the output
                hydra.show_info(info, name, [*overrides, *search])
            else:
                hydra.show_cfg(name, [*overrides, *search], cfg, package=None)
    finally:
        log.handlers[:] = handlers
        log.setLevel(level)


@contextmanager
def _errors() -> Iterator[None]:
    """Hydra's errors as ours."""
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(one_line(error)) from None


def complete(words: Sequence[str]) -> None:
    """``warpvox -sc install=SHELL``: print code that makes a shell complete our commands, which calls ``query``.

    Raises:
        ConfigError: another action, or a shell that Hydra does not know.
    """
    from warpvox.cli import COMMANDS as NAMES

    action, _, shell = words[0].partition("=") if len(words) == 1 else ("", "", "")
    if action not in ("install", "uninstall", "query") or shell not in SHELLS:
        raise ConfigError(
            f"-sc needs install=SHELL or uninstall=SHELL, for {listing(SHELLS)}; got '{' '.join(words)}'."
        )
    line = os.environ.get("COMP_LINE", "").split(" ", 2)
    if action == "query" and len(line) < 3:
        print("\n".join(name for name in NAMES if name.startswith(line[-1])))
        return
    command = line[1] if action == "query" else None
    if command is not None:  # Hydra knows one command only
        os.environ["COMP_LINE"] = f"{line[0]} {line[2]}"
    if command is None or command in COMMANDS:
        with opened() as (hydra, _):
            hydra.shell_completion(command, list(words))


def is_plugin_key(word: str) -> bool:
    """Whether an override names or configures a launcher or sweeper of Hydra."""
    return word.partition("=")[0].startswith(PLUGINS)


def multirun(
    command: str, overrides: Sequence[str], folder: Path, config_dir: Path | None, task: Callable[[Any], float | None]
) -> None:
    """Have Hydra's sweeper and launcher call ``task`` for each combination of values.

    Args:
        overrides: the swept keys, and those of the plugins.
        folder: for what the plugins write.
        task: can be pickled; it finds its overrides by ``HydraConfig``. A sweeper that optimises takes its value.

    Raises:
        ConfigError: a plugin or a setting of it that does not exist.
    """
    words = [*QUIET, f"hydra.sweep.dir={quoted(str(folder.absolute()))}", *overrides]
    with _errors(), opened(config_dir) as (hydra, search):
        hydra.multirun(command, task, [*words, *search], with_log_configuration=False)
