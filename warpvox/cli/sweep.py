"""Sweeps over several runs by Hydra (``--multirun``), and completion of command lines by a shell."""

import argparse
import functools
import os
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import hydra
from hydra.core.hydra_config import HydraConfig

from warpvox.cli.config import read_words, settings_of
from warpvox.cli.help import keys_of, options_of
from warpvox.configs.composition import hydras_errors, quoted
from warpvox.configs.schema import COMMANDS
from warpvox.errors import ConfigError, WarpvoxError
from warpvox.io.console import echo, literal, make_console
from warpvox.runs import STAMP, as_name, check_output, label, read_summary
from warpvox.system import safe_start

LONGEST_LABEL = 80
"""Maximum length of a run's label in the name of its folder."""
_OWN = "++words."
"""Prefix of the keys passed to Hydra: they start as an empty configuration, and Hydra expands their values."""


def sweep(command: str, words: Sequence[str], config_dir: Path | None) -> None:
    """Run all combinations of values on the command line with Hydra's sweeper and launcher.

    Hydra expands the words and launches the runs; each composes its own settings. Every value that is listed is
    checked before the first run begins, those of several keys not in all combinations.

    Raises:
        WarpvoxError: a value is not valid, or a run has failed; the others are made all the same.
    """
    # Hydra's own words: launcher, sweeper and their settings
    plugins = [word for word in words if word.startswith(("hydra/", "hydra."))]
    overrides = read_words(command, [word for word in words if word not in plugins])
    fixed = {key: str(one.input_line) for key, one in overrides.items() if not one.is_sweep_override()}

    # Values that each word lists (sweepers that optimise may choose others)
    listed = {}
    for key, one in overrides.items():
        if not (one.is_discrete_sweep() or one.is_range_sweep()):
            continue
        try:
            listed[key] = [f"{one.get_key_element()}={value}" for value in one.sweep_string_iterator()]
        except ValueError:  # a range of steps of 0
            listed[key] = []
        if not listed[key]:
            raise ConfigError(f"'{one.input_line}' makes no runs.")

    # Check every listed value now, so that a mistake in the last run does not show after a day.
    first = fixed | {key: values[0] for key, values in listed.items()}
    runs = [first]
    for key, values in listed.items():
        runs += [first | {key: word} for word in values[1:]]
    check = getattr(import_module(f"warpvox.cli.commands.{command}"), "check", None)
    for run in runs:
        given = read_words(command, list(run.values()))
        settings = settings_of(command, given, config_dir)
        check_output(settings)
        if check is not None:
            check(settings, given)

    output_dir = getattr(settings, "output_dir", "outputs")
    folder = Path(output_dir).absolute() / command / f"sweep_{datetime.now().strftime(STAMP)}"
    lines = [f"{_OWN}{one.input_line}" for one in overrides.values()]
    task = functools.partial(_run, command, config_dir, frozenset(fixed))
    # Hydra neither logs nor makes folders of its own: every run has its folder and its log.
    quiet = ["hydra/job_logging=none", "hydra/hydra_logging=none", "hydra.output_subdir=null", "hydra.sweep.subdir=."]
    _run_hydra(["--multirun", *quiet, f"hydra.sweep.dir={quoted(str(folder))}", *plugins, *lines], task)


def _run(command: str, config_dir: Path | None, fixed: Collection[str], _: Any) -> float | None:
    """Run one job of a sweep; return its best return or fitness, for sweepers that optimise."""
    job = HydraConfig.get()
    words = [word.removeprefix(_OWN) for word in job.overrides.task]
    given = read_words(command, words)
    varied = {}
    for key, one in given.items():
        if key not in fixed:
            varied[key] = one.value() if isinstance(one.value(), str) else one.get_value_string()
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


def label_of(varied: Mapping[str, str]) -> str:
    """Build the part of a folder's name that identifies a run of a sweep, such as ``seed-1_ppo.gamma-0.9``."""
    return as_name("_".join(f"{key}-{value}" for key, value in varied.items() if key != "task"))[:LONGEST_LABEL]


def _run_hydra(words: Sequence[str], task: Callable[[Any], Any] = lambda _: None) -> None:
    """Run Hydra as ``@hydra.main`` does, on these words and an empty configuration.

    ConfigError: what Hydra says of a word or plugin. Exception: what ``task`` raises.
    """
    os.environ["HYDRA_FULL_ERROR"] = "1"  # errors are raised, not printed
    before = sys.argv
    sys.argv = [sys.argv[0], *words]
    try:
        # From Python 3.14 on argparse refuses an object as a help text, which Hydra 1.3 has.
        lenient = patch.object(argparse.ArgumentParser, "_check_help", lambda *_: None, create=True)
        with hydras_errors(), lenient, safe_start(move=False):  # of launchers' processes
            hydra.main(version_base="1.3", config_path="pkg://warpvox.cli", config_name=None)(task)()
    finally:
        sys.argv = before


def complete(words: Sequence[str], commands: Collection[str]) -> None:
    """Print shell completions of the line in ``COMP_LINE``, or the script that installs completion.

    Args:
        words: what follows ``-sc``: ``query=SHELL``, ``install=SHELL`` or ``uninstall=SHELL``.
        commands: names of all commands.
    """
    if not words or not words[0].startswith("query="):
        try:
            _run_hydra(["-sc", *words])
        except ValueError as error:
            raise ConfigError(f"-sc needs install=SHELL or uninstall=SHELL. {' '.join(str(error).split())}.") from None
        return

    _, *given, word = os.environ.get("COMP_LINE", "").split(" ")
    command = {"demo": "train"}.get(given[0], given[0]) if given else None
    key, has_value, _ = word.partition("=")
    options: Iterable[str] = ()
    if command is None:
        options = commands
    elif command in COMMANDS and has_value:
        options = [f"{key}={name}" for name in options_of(command, key)]
    elif command in COMMANDS:
        options = [f"{name}=" for name in keys_of(command)]
    print("\n".join(option for option in options if option.startswith(word)))
