"""Several runs one after another (``--multirun``): what they differ by, and their results."""

from __future__ import annotations

import hashlib
import re
import traceback
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from warpvox.cli.config import Arguments, expand
from warpvox.cli.quoting import parse
from warpvox.errors import RunError, WarpvoxError
from warpvox.io.console import echo, literal
from warpvox.io.writing import write_table
from warpvox.runs import STAMP, label, read_summary

__all__ = ["INTERRUPTED", "Member", "Sweep", "attempt", "member_of", "members"]

LONGEST_LABEL = 80
"""Characters of a folder's name that say what its run differs by."""
UNSAFE = re.compile(r"[^A-Za-z0-9.+]+")
INTERRUPTED = "interrupted"
"""Status of a run that was ended by a signal."""
FIGURES = ("best_return", "best_fitness", "mean_return", "evaluations", "steps", "elapsed_seconds")
"""Entries of ``summary.json`` that the table shows, where there are any."""


@dataclass(frozen=True)
class Member:
    """One run of a sweep.

    ``overrides``: all of it; ``varied``: keys that have other values in other runs, with the values of this one.
    """

    overrides: list[str]
    varied: dict[str, str] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """``seed-1_ppo.gamma-0.9``: for the name of a folder, in which the task has a place already."""
        parts = [f"{key}-{_safe(value)}" for key, value in self.varied.items() if key != "task"]
        text = "_".join(parts)
        if len(text) <= LONGEST_LABEL:
            return text
        return f"{text[: LONGEST_LABEL - 9]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _safe(value: str) -> str:
    place = Path(value)
    short = place.stem if place.suffix and len(place.parts) > 1 else value  # of a file: its name
    return UNSAFE.sub("-", short).strip("-") or "x"


def members(arguments: Arguments, command: str) -> list[Member]:
    """The runs that are asked for: one, or with ``--multirun`` one for each combination of listed values.

    Raises:
        ConfigError: see :func:`warpvox.cli.config.expand`.
    """
    runs = expand(arguments, command)
    return [member_of(words, set(runs[0]).intersection(*runs[1:])) for words in runs]


def member_of(overrides: Sequence[str], common: Collection[str]) -> Member:
    """A run whose overrides are ``common`` to all runs but for some."""
    return Member(list(overrides), {_key(word): _value(word) for word in overrides if word not in common})


def _key(word: str) -> str:
    return word.partition("=")[0]


def _value(word: str) -> str:
    value = parse(word).value()
    return value if isinstance(value, str) else word.partition("=")[2]


def attempt(
    row: dict[str, Any], member: Member, do: Callable[[], Path | None], console: Console, total: str = ""
) -> None:
    """Make one run of several and note its result in ``row``; only an interrupt is passed on."""
    values = " ".join(f"{key}={value}" for key, value in member.varied.items())
    console.rule(literal(f"run {row['run']}{total}: {values}"))
    row |= {**member.varied, "status": INTERRUPTED}
    token = label.set(member.label)
    try:
        folder = do()
    except BrokenPipeError:
        raise
    except WarpvoxError as error:
        row |= {"status": "failed", "error": " ".join(str(error).split())}
        echo(console, f"failed: {row['error']}")
    except Exception as error:  # a defect; the others have nothing to do with it
        row |= {"status": "failed", "error": f"{type(error).__name__}: {error}"}
        traceback.print_exc()
    else:
        summary = {} if folder is None else read_summary(folder)
        figures = {name: summary[name] for name in FIGURES if summary.get(name) is not None}
        row |= {"status": "done", **figures, "folder": "" if folder is None else str(folder)}
    finally:
        label.reset(token)


class Sweep:
    """The runs of a sweep: a table at the end, and after every run ``<output_dir>/<command>/sweep_<date_time>.csv``.

    A context manager; at its end the table is complete and printed.

    Raises:
        RunError: runs have failed; the others are made all the same.
    """

    def __init__(self, command: str, console: Console, output_dir: str, total: int | None = None) -> None:
        self.console, self.total = console, total
        self.rows: list[dict[str, Any]] = []
        folder, stamp = Path(output_dir) / command, datetime.now().strftime(STAMP)
        names = (f"sweep_{stamp}{'' if number == 1 else f'-{number}'}.csv" for number in range(1, 1000))
        self.file = next(folder / name for name in names if not (folder / name).exists())

    def __enter__(self) -> Sweep:
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        if not self.rows:
            return
        self.write()
        self._print()
        failed = [row for row in self.rows if row["status"] == "failed"]
        if failed and kind is None:
            raise RunError(
                f"{len(failed)} of {self.total or len(self.rows)} runs failed, the first of them with:"
                f" {failed[0]['error'].rstrip('.')}. All are listed in {self.file}."
            )

    @property
    def columns(self) -> list[str]:
        """Those that some row has something in, results behind settings."""
        known = dict.fromkeys(name for row in self.rows for name in row)
        last = ("status", *FIGURES, "folder", "error")
        return [*(name for name in known if name not in last), *(name for name in last if name in known)]

    def write(self) -> None:
        """Write the table as CSV."""
        columns = self.columns
        write_table(self.file, columns, ([row.get(name) for name in columns] for row in self.rows))

    def _print(self) -> None:
        columns = [name for name in self.columns if name not in ("folder", "error")]
        table = Table(title=f"{len(self.rows)} of {self.total or len(self.rows)} runs", title_justify="left")
        for name in columns:
            table.add_column(literal(name), justify="right" if name in ("run", *FIGURES) else "left", overflow="fold")
        for row in self.rows:
            table.add_row(*(literal(_shown(row.get(name))) for name in columns))
        self.console.print(table)
        echo(self.console, f"table: {self.file}")


def _shown(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:,.3f}"
    return f"{value:,}" if isinstance(value, int) else str(value)
