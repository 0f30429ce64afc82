"""What all commands with keys have in common: options, help, checked configurations, one run or a sweep of them."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.console import Console

from warpvox.cli import COMMANDS
from warpvox.cli.config import Arguments, composition, expand, load, parse_overrides, read_arguments, to_yaml
from warpvox.cli.help import command_help, flat_values
from warpvox.cli.hydra_parts import multirun, show
from warpvox.cli.sweep import Member, Sweep, attempt, member_of, members
from warpvox.errors import RunError
from warpvox.io.writing import write_text
from warpvox.runs import check_output

__all__ = ["prepared", "run_command"]

Prepare = Callable[[Any, list[str], "Path | None"], Any]
Do = Callable[[Any, Console], "Path | None"]


def _as_it_is(config: Any, overrides: list[str], config_dir: Path | None) -> Any:
    return config


def run_command(
    command: str,
    words: list[str],
    do: Do,
    prepare: Prepare = _as_it_is,
    check: Callable[[Any], object] | None = None,
) -> None:
    """Do what a command line asks for. All runs of a sweep are checked before the first begins.

    Args:
        words: what follows the command.
        do: makes a run and returns its folder.
        prepare: makes what ``do`` gets, from a configuration, its overrides and the user's folder of YAML files.
        check: finds what is wrong with one of several runs, and takes no longer than a moment.

    Raises:
        WarpvoxError: something that is asked for is not valid, or a run has failed.
        KeyboardInterrupt: interrupted; runs that have not begun are not made.
    """
    arguments = read_arguments(words)
    if arguments.help:
        defaults = dataclasses.asdict(load(command, []))
        print(command_help(command, COMMANDS[command], flat_values(defaults)))
    elif arguments.info or arguments.cfg in ("hydra", "all"):
        for overrides in expand(arguments, command):
            name, words = composition(command, overrides, arguments.config_dir)
            show(name, [*words, *arguments.plugins], arguments.config_dir, arguments.cfg, arguments.info)
    elif arguments.cfg:
        for overrides in expand(arguments, command):
            print(to_yaml(load(command, overrides, arguments.config_dir)), end="")
    elif arguments.plugins:
        _launch(command, arguments, do, prepare, check)
    else:
        _run_here(command, arguments, do, prepare, check)


def prepared(command: str, overrides: list[str], config_dir: Path | None, prepare: Prepare) -> Any:
    """What the ``do`` of a command gets for a run with these overrides."""
    config = load(command, overrides, config_dir)
    check_output(config)
    return prepare(config, overrides, config_dir)


def _run_here(command: str, arguments: Arguments, do: Do, prepare: Prepare, check: Callable | None) -> None:
    """Make the runs one after another in this process."""
    runs, jobs = _jobs(command, arguments, prepare, check)
    console = Console()
    if len(jobs) == 1:
        do(jobs[0], console)
        return
    config = load(command, runs[0].overrides, arguments.config_dir)
    with Sweep(command, console, config.output_dir, len(jobs)) as sweep:
        for number, (run, job) in enumerate(zip(runs, jobs, strict=True), start=1):
            sweep.rows.append({"run": number})
            attempt(sweep.rows[-1], run, functools.partial(do, job, console), console, f" of {len(jobs)}")
            sweep.write()


def _jobs(
    command: str, arguments: Arguments, prepare: Prepare, check: Callable | None
) -> tuple[list[Member], list[Any]]:
    """The runs that are asked for, and what ``do`` gets for each."""
    runs = members(arguments, command)
    jobs = [prepared(command, run.overrides, arguments.config_dir, prepare) for run in runs]
    for job in jobs if check and len(jobs) > 1 else []:  # a mistake in the last run should not show after a day
        check(job)
    return runs, jobs


def _launch(command: str, arguments: Arguments, do: Do, prepare: Prepare, check: Callable | None) -> None:
    """Have Hydra's launcher and sweeper make the runs: in other processes, on a cluster, in an order of their own."""
    parsed = parse_overrides(arguments, command)
    fixed = [str(override.input_line) for override in parsed if not override.is_sweep_override()]
    swept = [str(override.input_line) for override in parsed if override.is_sweep_override()]
    config = load(command, fixed, arguments.config_dir)
    if not any("sweeper" in word for word in arguments.plugins):  # which may have values of its own
        _jobs(command, arguments, prepare, check)
    with Sweep(command, Console(), config.output_dir) as sweep:
        folder = sweep.file.with_suffix("")
        task = functools.partial(_run_there, command, fixed, arguments.config_dir, folder.absolute(), do, prepare)
        try:
            multirun(command, [*arguments.plugins, *swept], folder, arguments.config_dir, task)
        except RunError:
            pass  # of a run; its row has the error
        finally:
            rows = [json.loads(file.read_text(encoding="utf-8")) for file in folder.glob("run_*.json")]
            sweep.rows = sorted(rows, key=lambda row: row["run"])


def _run_there(
    command: str, fixed: list[str], config_dir: Path | None, folder: Path, do: Do, prepare: Prepare, _: Any
) -> float | None:
    """Make one run of a launcher, with the overrides that Hydra gives it; returns what an optimiser looks at."""
    from hydra.core.hydra_config import HydraConfig

    hydra = HydraConfig.get()
    words, row, console = [*fixed, *hydra.overrides.task], {"run": hydra.job.num + 1}, Console()

    def make() -> Path | None:
        return do(prepared(command, words, config_dir, prepare), console)

    try:
        attempt(row, member_of(words, fixed), make, console)
    finally:
        write_text(folder / f"run_{row['run']}.json", json.dumps(row))
    if row["status"] == "failed":
        raise RunError(row["error"])
    return next((row[name] for name in ("best_return", "best_fitness", "mean_return") if name in row), None)
