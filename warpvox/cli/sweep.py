"""Several runs by Hydra's sweeper and launcher (``--multirun``): what they differ by, and their results."""

import argparse
import functools
import hashlib
import json
import os
import re
import sys
import time
import traceback
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any
from unittest.mock import patch

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from rich.console import Console
from rich.table import Table

from warpvox.cli.config import load_start
from warpvox.cli.help import options_of
from warpvox.cli.overrides import key_and_value
from warpvox.configs.composition import hydras_errors, quoted, register
from warpvox.configs.schema import COMMANDS, PRESET
from warpvox.errors import ConfigError, RunError, WarpvoxError
from warpvox.io.console import echo, literal, make_console
from warpvox.io.text import duration, shell_argument
from warpvox.io.writing import write_table, write_text
from warpvox.runs import CODESIGN, STAMP, TRAINING, label, make_folder, read_summary
from warpvox.system import safe_start

LONGEST_LABEL = 80
"""Characters of a folder's name that say what its run differs by."""
UNSAFE = re.compile(r"[^A-Za-z0-9.+]+")
INTERRUPTED = "interrupted"
"""Status of a run that was ended by a signal."""
FIGURES = ("best_return", "best_fitness", "mean_return", "evaluations", "steps", "elapsed_seconds")
"""Entries of ``summary.json`` that the table shows, where there are any."""
NUMBER, RESULTS = "run", ("status", *FIGURES, "folder", "error")
"""Columns of the table beside the keys that differ; a key with the name of one of them has the prefix ``key_``."""
QUIET = ("hydra/job_logging=none", "hydra/hydra_logging=none", "hydra.output_subdir=null", "hydra.sweep.subdir=.")
Make = Callable[[list[str], Console], "Path | None"]


def make_runs(
    command: str,
    overrides: Sequence[Override],
    plugins: list[str],
    config_dir: Path | None,
    make: Make,
    runs: Sequence[list[str]],
) -> None:
    """Have Hydra make the runs of a sweep; their table is ``<output_dir>/<command>/sweep_<date_time>.csv``.

    Args:
        overrides: those of all runs, and those that list several values.
        runs: the overrides of each; none if the sweeper chooses them.

    Raises:
        RunError: runs have failed; the others are made all the same.
    """
    fixed, total = [str(override.input_line) for override in overrides if not override.is_sweep_override()], len(runs)
    output_dir = getattr(load_start(command, runs[0] if runs else fixed, config_dir), "output_dir", "outputs")
    folder = Path(output_dir).absolute() / command
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    table = make_folder(folder, f"sweep_{datetime.now().strftime(STAMP)}")
    words = [*QUIET, f"hydra.sweep.dir={quoted(str(table))}", *plugins, *(str(one.input_line) for one in overrides)]
    task = functools.partial(_run, frozenset(key_and_value(word)[0] for word in fixed), table, make, total, time.time())
    try:
        run_hydra(command, ["--multirun"], words, config_dir, task)
    except RunError:
        pass  # of a run; its row has the error
    finally:
        rows = _write(table)
        if rows:
            _print(rows, total, table)
            if command in (*TRAINING, CODESIGN):
                echo(make_console(), f"compare: warpvox curves {shell_argument('runs', table)}")
        for empty in () if rows else (table, *made):
            with suppress(OSError):
                empty.rmdir()
    failed = [row for row in rows if row["status"] == "failed"]
    if failed:
        raise RunError(
            f"{len(failed)} of {total or len(rows)} runs failed, the first of them with:"
            f" {failed[0]['error'].rstrip('.')}. All are listed in {table}.csv."
        )


def _run(fixed: frozenset[str], table: Path, make: Make, total: int, began: float, _: Any) -> float | None:
    """Make the run whose overrides Hydra gives; returns what a sweeper that optimises looks at.

    Its result is noted in the table, whatever happens; only an interrupt is passed on.
    """
    hydra, console = HydraConfig.get(), make_console()
    words, number = list(hydra.overrides.task), hydra.job.num + 1
    varied = {key: value for key, value in map(key_and_value, words) if key not in fixed}
    done, of = len(list(table.glob("run_*.json"))), f" of {total}" if total else ""
    if done and total:
        of += f", left {duration((time.time() - began) / done * (total - done))}"
    console.rule(literal(f"run {number}{of}: {' '.join(f'{key}={value}' for key, value in varied.items())}"))
    settings = {f"key_{key}" if key in (NUMBER, *RESULTS) else key: value for key, value in varied.items()}
    row: dict[str, Any] = {NUMBER: number, **settings, "status": INTERRUPTED}
    token = label.set(label_of(varied))
    try:
        folder = make(words, console)
        summary = {} if folder is None else read_summary(folder)
        figures = {name: summary[name] for name in FIGURES if summary.get(name) is not None}
        row |= {"status": "done", **figures, "folder": "" if folder is None else str(folder)}
    except BrokenPipeError:
        raise
    except WarpvoxError as error:
        row |= {"status": "failed", "error": " ".join(str(error).split())}
        echo(console, f"failed: {row['error']}")
    except Exception as error:  # a defect; the others have nothing to do with it
        row |= {"status": "failed", "error": f"{type(error).__name__}: {error}"}
        traceback.print_exc()
    finally:
        label.reset(token)
        write_text(table / f"run_{number:05}.json", json.dumps(row))
        _write(table)
    if row["status"] == "failed" and hydra.runtime.choices["hydra/sweeper"] != "basic":
        raise RunError(row["error"])
    return next((row[name] for name in ("best_return", "best_fitness", "mean_return") if name in row), None)


def label_of(varied: dict[str, str]) -> str:
    """``seed-1_ppo.gamma-0.9``: for the name of a folder, in which the task has a place already."""
    text = "_".join(f"{key}-{_safe(value)}" for key, value in varied.items() if key != "task")
    if len(text) <= LONGEST_LABEL:
        return text
    return f"{text[: LONGEST_LABEL - 9]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _safe(value: str) -> str:
    place = Path(value)
    short = place.stem if place.suffix and len(place.parts) > 1 else value  # of a file: its name
    return UNSAFE.sub("-", short).strip("-") or "x"


def _write(table: Path) -> list[dict[str, Any]]:
    """Write the table of the runs that have been made, results behind settings; returns its rows."""
    rows = [json.loads(file.read_text(encoding="utf-8")) for file in sorted(table.glob("run_*.json"))]
    names = dict.fromkeys(name for row in rows for name in row)
    columns = sorted(names, key=lambda name: RESULTS.index(name) if name in RESULTS else -1)
    rows = [{name: row.get(name) for name in columns} for row in rows]
    if rows:
        write_table(table.with_name(f"{table.name}.csv"), columns, (row.values() for row in rows))
    return rows


def _print(rows: list[dict[str, Any]], total: int, file: Path) -> None:
    table, console = Table(title=f"{len(rows)} of {total or len(rows)} runs", title_justify="left"), make_console()
    columns = [name for name in rows[0] if name not in ("folder", "error")]
    for name in columns:
        table.add_column(literal(name), justify="right" if name in FIGURES else "left", overflow="fold")
    for row in rows:
        values = ("" if row[name] is None else row[name] for name in columns)
        table.add_row(*(literal(f"{value:,.3f}" if isinstance(value, float) else value) for value in values))
    console.print(table)
    echo(console, f"table: {file}.csv")


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
        # From Python 3.14 on argparse refuses an object as a help text, which Hydra 1.3 has.
        lenient = patch.object(argparse.ArgumentParser, "_check_help", lambda *_: None, create=True)
        with hydras_errors(), lenient, safe_start(move=False):  # of launchers' processes
            hydra.main(version_base="1.3", config_path="pkg://warpvox.configs", config_name=command)(task)()
    finally:
        sys.argv = words


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
