"""Options and help of the commands."""

import argparse
import dataclasses
from collections.abc import Collection
from pathlib import Path
from typing import Any, NoReturn

from warpvox.cli.config import load, read_words, settings_of
from warpvox.cli.help import add_keys, flat_values, keys_of
from warpvox.errors import ConfigError, did_you_mean, listing
from warpvox.io.writing import to_yaml
from warpvox.runs import check_output

OPTIONS: dict[tuple[str, str], dict[str, Any]] = {
    ("-h", "--help"): {"action": "store_true", "help": "this text"},
    ("-m", "--multirun"): {
        "action": "store_true",
        "help": "run all combinations of listed values: seed=1,2,3 task=Walker-v0,Climber-v0; hydra/launcher=NAME and"
        " hydra/sweeper=NAME take plugins of Hydra that are installed",
    },
    ("-c", "--cfg"): {
        "choices": ("job",),
        "metavar": "job",
        "help": "print the settings as config=FILE takes them",
    },
    ("-cd", "--config-dir"): {
        "type": Path,
        "metavar": "FOLDER",
        "help": "folder with YAML files of your own, for instance FOLDER/ppo/mine.yaml for ppo=mine",
    },
}


def read_command(command: str, summary: str, words: list[str]) -> tuple[Any, Collection[str]] | None:
    """Parse a command line into settings and the keys given; None after ``--help``, ``--cfg`` and ``--multirun``.

    Args:
        summary: what the command does.

    Raises:
        WarpvoxError: something that is asked for is not valid, or a run of a sweep has failed.
    """
    options = read_options(command, words)
    if options.help:
        parser = _parser(command, f"{summary[0].upper()}{summary[1:]}.")
        add_keys(parser, command, flat_values(command, dataclasses.asdict(load(command, []))))
        parser.print_help()
        return None
    if options.multirun:
        from warpvox.cli.sweep import sweep

        sweep(command, options.overrides, options.config_dir)
        return None
    given = read_words(command, options.overrides)
    settings = settings_of(command, given, options.config_dir)
    if options.cfg:
        print(to_yaml(settings), end="")
        return None
    check_output(settings)
    return settings, given


def read_options(command: str, words: list[str]) -> argparse.Namespace:
    """Separate options such as ``--multirun`` from KEY=VALUE words; ConfigError: unknown or incomplete option."""
    parser = _parser(command, "")
    parser.add_argument("overrides", nargs="*")
    options, unknown = parser.parse_known_intermixed_args(words)
    if unknown:
        flags = [flag for flags in OPTIONS for flag in flags]
        name = unknown[0].lstrip("-").partition("=")[0].replace("-", "_")
        hint = f" Keys have no dashes: {name}=VALUE." if name in keys_of(command) else did_you_mean(unknown[0], flags)
        raise ConfigError(f"Unknown option '{unknown[0]}'; there are {listing(flags)}.{hint}")
    if options.config_dir is not None:
        if not options.config_dir.is_dir():
            raise ConfigError(f"--config-dir needs an existing folder, got '{options.config_dir}'.")
        options.config_dir = options.config_dir.resolve()
    if command in ("tasks", "zoo"):  # warpvox tasks Walker-v0
        options.overrides = [word if "=" in word else f"task={word}" for word in options.overrides]
    return options


def _parser(command: str, description: str) -> argparse.ArgumentParser:
    """Build the argparse parser of a command."""
    parser = argparse.ArgumentParser(
        usage=f"warpvox {command} [KEY=VALUE ...]",
        description=description,
        add_help=False,
        allow_abbrev=False,
        formatter_class=lambda prog: argparse.HelpFormatter(prog, max_help_position=34),
    )
    parser.error = _raise_config_error
    group = parser.add_argument_group("options")
    for flags, arguments in OPTIONS.items():
        group.add_argument(*flags, **arguments)
    return parser


def _raise_config_error(message: str) -> NoReturn:
    """Raise a ConfigError with the message of argparse."""
    raise ConfigError(f"{message[0].upper()}{message[1:]}.")
