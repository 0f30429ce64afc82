"""Parts that all commands with keys share: options, help, checked configurations, one run or a sweep of them."""

import argparse
import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console

from warpvox.cli import COMMANDS
from warpvox.cli.config import load, load_start
from warpvox.cli.help import add_keys, flat_values, keys_of
from warpvox.cli.overrides import expand, read_overrides
from warpvox.cli.sweep import make_runs, run_hydra
from warpvox.errors import ConfigError, did_you_mean, listing
from warpvox.io.console import make_console
from warpvox.runs import check_output

Prepare = Callable[[Any, list[str], "Path | None"], Any]
Do = Callable[[Any, Console], "Path | None"]
INFO = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")
PLUGINS = ("hydra/launcher", "hydra/sweeper", "hydra.launcher", "hydra.sweeper")
MULTIRUN = (
    "run all combinations of listed values: seed=1,2,3 task=Walker-v0,Climber-v0; hydra/launcher=NAME and"
    " hydra/sweeper=NAME take plugins of Hydra that are installed"
)
CFG, HOW = "print what Hydra composes: job, hydra or all", f"print how Hydra composes it: {', '.join(INFO)}"
FOLDER = "folder with YAML files of your own, for instance FOLDER/ppo/mine.yaml for ppo=mine"
OPTIONS: dict[tuple[str, str], dict[str, Any]] = {
    ("-h", "--help"): {"action": "store_true", "help": "this text"},
    ("-m", "--multirun"): {"action": "store_true", "help": MULTIRUN},
    ("-c", "--cfg"): {"choices": ("job", "hydra", "all"), "metavar": "WHAT", "help": CFG},
    ("-i", "--info"): {"choices": INFO, "nargs": "?", "const": "all", "metavar": "WHAT", "help": HOW},
    ("-cd", "--config-dir"): {"type": Path, "metavar": "FOLDER", "help": FOLDER},
}
FLAGS = [flag for flags in OPTIONS for flag in flags]
BY_ITSELF = {"tasks": "task", "zoo": "task"}
"""The key that a word without one is the value of, by command."""


def run_command(
    command: str,
    words: list[str],
    do: Do,
    prepare: Prepare = lambda config, *_: config,
    check: Callable[[Any], object] | None = None,
) -> None:
    """Do what a command line asks for. All runs of a sweep are checked before the first begins.

    Args:
        prepare: makes what ``do`` gets, from a configuration, its overrides and the user's folder of YAML files.
        check: finds what is wrong with one of several runs, and takes no longer than a moment.

    Raises:
        WarpvoxError: something that is asked for is not valid, or a run has failed.
        KeyboardInterrupt: interrupted; runs that have not begun are not made.
    """
    given = read_words(command, words)
    plugins = [word for word in given.overrides if word.startswith(PLUGINS)]
    overrides = [word for word in given.overrides if word not in plugins]
    views = [flag for name in ("cfg", "info") if (kind := getattr(given, name)) for flag in (f"--{name}", kind)]
    for word in plugins:
        if "_target_" in word:
            raise ConfigError(f"'{word:.200}': plugins are chosen by name, such as hydra/launcher=joblib.")
        if not (given.multirun or views):
            raise ConfigError(f"'{word}' is about sweeps: add --multirun.")
    if given.help:
        _parser(command, flat_values(command, dataclasses.asdict(load(command, [])))).print_help()
    elif views:
        if any(word.startswith("config=") for word in overrides):
            raise ConfigError("--cfg and --info show what Hydra composes, which config=FILE is no part of.")
        load(command, overrides, given.config_dir)
        views += ["--resolve"] if given.cfg else []
        run_hydra(command, views, [*plugins, *expand(read_overrides(command, overrides))[0]], given.config_dir)
    else:
        parsed = read_overrides(command, overrides, given.multirun)
        swept = any("sweeper" in word for word in plugins)  # which may have values of its own
        runs = [] if swept else expand(parsed)
        jobs = [prepared(command, run, given.config_dir, prepare) for run in runs]
        if len(jobs) == 1 and not plugins:
            do(jobs[0], make_console())
            return
        if check is not None:  # a mistake in the last run should not show after a day
            for job in jobs:
                check(job)
        make = functools.partial(_make, command, given.config_dir, do, prepare)
        make_runs(command, parsed, plugins, given.config_dir, make, runs)


def prepared(command: str, overrides: list[str], config_dir: Path | None, prepare: Prepare) -> Any:
    """Argument of a command's ``do`` for a run with these overrides."""
    config = load_start(command, overrides, config_dir)
    check_output(config)
    return prepare(config, overrides, config_dir)


def _make(command: str, config_dir: Path | None, do: Do, prepare: Prepare, run: list[str], console: Console) -> Any:
    """Make a run of a sweep, in this process or in one of a launcher."""
    return do(prepared(command, run, config_dir, prepare), console)


def read_words(command: str, words: list[str]) -> argparse.Namespace:
    """Sort options from overrides."""
    given, unknown = _parser(command).parse_known_intermixed_args(words)
    if unknown:
        name, hint = unknown[0].lstrip("-").partition("=")[0].replace("-", "_"), did_you_mean(unknown[0], FLAGS)
        hint = f" Keys have no dashes: {name}=VALUE." if name in keys_of(command) else hint
        raise ConfigError(f"Unknown option '{unknown[0]}'; there are {listing(FLAGS)}.{hint}")
    if given.config_dir is not None:
        if not given.config_dir.is_dir():
            raise ConfigError(f"--config-dir needs an existing folder, got '{given.config_dir}'.")
        given.config_dir = given.config_dir.resolve()
    if command in BY_ITSELF:
        given.overrides = [word if "=" in word else f"{BY_ITSELF[command]}={word}" for word in given.overrides]
    return given


def _parser(command: str, values: dict[str, Any] | None = None) -> argparse.ArgumentParser:
    """The options of a command; with the defaults of its keys also these, for its help."""
    summary = COMMANDS[command]
    parser = argparse.ArgumentParser(
        usage=f"warpvox {command} [KEY=VALUE ...]",
        description=f"{summary[0].upper()}{summary[1:]}.",
        add_help=False,
        allow_abbrev=False,
        formatter_class=lambda prog: argparse.HelpFormatter(prog, max_help_position=34),
    )
    parser.error = _complain
    if values is None:
        parser.add_argument("overrides", nargs="*")
    else:
        add_keys(parser, command, values)
    options = parser.add_argument_group("options")
    for flags, settings in OPTIONS.items():
        options.add_argument(*flags, **settings)
    return parser


def _complain(message: str) -> NoReturn:
    raise ConfigError(f"{message[0].upper()}{message[1:]}.")
