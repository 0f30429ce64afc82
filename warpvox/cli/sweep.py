"""Several runs by Hydra's sweeper and launcher (``--multirun``), and completion of command lines by a shell."""

import argparse
import functools
import hashlib
import os
import re
import sys
from collections.abc import Callable, Collection, Sequence
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import hydra
from hydra.core.hydra_config import HydraConfig

from warpvox.cli.config import read_words, settings_of
from warpvox.cli.help import options_of
from warpvox.configs.composition import hydras_errors, quoted, register
from warpvox.configs.schema import COMMANDS, PRESET
from warpvox.errors import ConfigError, WarpvoxError
from warpvox.io.console import echo, literal, make_console
from warpvox.runs import STAMP, check_output, label, read_summary
from warpvox.system import safe_start

PLUGINS = ("hydra/", "hydra.")
"""Beginnings of words that are Hydra's own: which launcher and sweeper, and their settings."""
LONGEST_LABEL = 80
"""Characters of a folder's name that say what its run differs by."""
OWN = "++words."
"""Beginning of our words for Hydra, which adds them to an empty configuration: it is to expand them, not to compose."""
QUIET = ("hydra/job_logging=none", "hydra/hydra_logging=none", "hydra.output_subdir=null", "hydra.sweep.subdir=.")


def sweep(command: str, words: Sequence[str], config_dir: Path | None) -> None:
    """Have Hydra make the runs of all combinations of the values that words list.

    Hydra expands the words and launches the runs; each composes its own settings. Every value that is listed is
    checked before the first run begins, those of several keys not in all combinations.

    Raises:
        WarpvoxError: a value is not valid, or a run has failed; the others are made all the same.
    """
    plugins = [word for word in words if word.startswith(PLUGINS)]
    overrides = read_words(command, [word for word in words if word not in plugins])
    fixed = {key: str(one.input_line) for key, one in overrides.items() if not one.is_sweep_override()}

    # A mistake in the last run should not show after a day.
    listed = {}
    for key, one in overrides.items():
        if one.is_discrete_sweep() or one.is_range_sweep():
            listed[key] = [f"{one.get_key_element()}={value}" for value in one.sweep_string_iterator()]
    first = [values[0] for values in listed.values()]
    output_dir = "outputs"
    for values in listed.values():
        for word in values:
            others = [one for one in first if one.partition("=")[0] != word.partition("=")[0]]
            settings = _check(command, [*fixed.values(), *others, word], config_dir)
            output_dir = getattr(settings, "output_dir", output_dir)

    folder = Path(output_dir).absolute() / command / f"sweep_{datetime.now().strftime(STAMP)}"
    lines = [f"{OWN}{one.input_line}" for one in overrides.values()]
    task = functools.partial(_run, command, config_dir, frozenset(fixed))
    run_hydra(None, ["--multirun"], [*QUIET, f"hydra.sweep.dir={quoted(str(folder))}", *plugins, *lines], task)


def _check(command: str, words: Sequence[str], config_dir: Path | None) -> Any:
    """The settings of one run. WarpvoxError: it cannot be made, as far as a moment tells."""
    given = read_words(command, words)
    settings = settings_of(command, given, config_dir)
    check_output(settings)
    check = getattr(import_module(f"warpvox.cli.commands.{command}"), "check", None)
    if check is not None:
        check(settings, given)
    return settings


def _run(command: str, config_dir: Path | None, fixed: Collection[str], _: Any) -> float | None:
    """Make the run whose words Hydra gives; returns what a sweeper that optimises looks at."""
    job = HydraConfig.get()
    words = [word.removeprefix(OWN) for word in job.overrides.task]
    given = read_words(command, words)
    varied = {key: str(one.value()) for key, one in given.items() if key not in fixed}
    console = make_console()
    console.rule(literal(f"run {job.job.num + 1}: {' '.join(f'{key}={value}' for key, value in varied.items())}"))
    token = label.set(label_of(varied))
    try:
        settings = settings_of(command, given, config_dir)
        folder = import_module(f"warpvox.cli.commands.{command}").run(settings, given, console)
    except WarpvoxError as error:
        echo(console, f"failed: {error}")
        raise
    finally:
        label.reset(token)
    summary = read_summary(folder) if isinstance(folder, Path) else {}
    names = ("best_return", "best_fitness", "mean_return")
    return next((summary[name] for name in names if summary.get(name) is not None), None)


def label_of(varied: dict[str, str]) -> str:
    """``seed-1_ppo.gamma-0.9``: for the name of a folder, in which the task has a place already."""
    parts = []
    for key, value in varied.items():
        place = Path(value)
        short = place.stem if place.suffix and len(place.parts) > 1 else value  # of a file its name
        if key != "task":
            parts.append(f"{key}-{re.sub('[^A-Za-z0-9.+]+', '-', short).strip('-') or 'x'}")
    text = "_".join(parts)
    if len(text) <= LONGEST_LABEL:
        return text
    return f"{text[: LONGEST_LABEL - 9]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def run_hydra(
    command: str | None,
    flags: Sequence[str],
    words: Sequence[str] = (),
    task: Callable[[Any], Any] = lambda _: None,
) -> None:
    """Do what ``@hydra.main`` does of a command line; None: with an empty configuration.

    ConfigError: what Hydra says of a configuration or plugin. Exception: what ``task`` raises.
    """
    if command is not None:
        register(command)
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors are raised, not printed
    before = sys.argv
    sys.argv = [sys.argv[0], *flags, *words]
    try:
        # From Python 3.14 on argparse refuses an object as a help text, which Hydra 1.3 has.
        lenient = patch.object(argparse.ArgumentParser, "_check_help", lambda *_: None, create=True)
        with hydras_errors(), lenient, safe_start(move=False):  # of launchers' processes
            path = "pkg://warpvox.cli" if command is None else "pkg://warpvox.configs"  # the former holds no YAML
            hydra.main(version_base="1.3", config_path=path, config_name=command)(task)()
    finally:
        sys.argv = before


def complete(words: Sequence[str], names: Collection[str]) -> None:
    """``warpvox -sc install=SHELL``: print code that makes a shell complete our commands, which calls ``query``.

    Args:
        words: what follows ``-sc``.
        names: of all commands.
    """
    line = os.environ.get("COMP_LINE", "").split(" ", 2)
    command = {"demo": "train"}.get(line[1], line[1]) if len(line) == 3 else None
    word, options = line[-1].rpartition(" ")[2], names if command is None else ()
    if command in COMMANDS and word.startswith(f"{PRESET}="):  # Hydra knows presets by another name
        options = [f"{PRESET}={name}" for name in options_of(command, f"{PRESET}/{command}")]
    if words[:1] and words[0].startswith("query=") and (options or command not in COMMANDS):
        print("\n".join(name for name in options if name.startswith(word)))
        return
    if command is not None:  # Hydra knows one command only
        os.environ["COMP_LINE"] = f"{line[0]} {line[2]}"
    try:
        run_hydra(command, ["-sc"], words)
    except ValueError as error:
        raise ConfigError(f"-sc needs install=SHELL or uninstall=SHELL. {' '.join(str(error).split())}.") from None
