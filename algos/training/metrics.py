"""Metrics of a training run: ``metrics.csv``, TensorBoard events, Weights & Biases, Neptune."""

from __future__ import annotations

import csv
import io
import itertools
import math
import os
import socket
import time
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from warpvox.errors import ConfigError, RunError, listing
from warpvox.io.writing import write_text, writing

__all__ = ["COLUMNS", "Events", "Metrics", "check_logger", "read_metrics"]

COLUMNS = (
    "iteration",  # iterations complete
    "steps",  # control steps of all environments since the start
    "episodes",  # that ended in this iteration
    "return_mean",  # of those, exploring; empty if none ended
    "length_mean",  # of those, in control steps
    "unstable",  # episodes that were stopped in this iteration, by self-folding or divergence
    "diverged",  # those of them that diverged
    "eval_return",  # deterministic; empty if there was no evaluation
    "best_return",  # the best evaluation so far
    "eval_q10",  # quantiles of the evaluation's mean returns by body, where there are several bodies
    "eval_q50",
    "eval_q90",
    "value_loss",
    "surrogate_loss",
    "entropy",
    "learning_rate",
    "action_std",  # mean standard deviation of the policy's output
    "steps_per_second",  # of this iteration, learning included, evaluation not
    "elapsed",  # seconds of all iterations and evaluations so far
)
NEEDED = ("iteration", "steps", "eval_return", "elapsed")
"""Columns that something is made of; others may be missing from a file that an earlier version has written."""
FILE = "metrics.csv"
WRITERS = {"wandb": "WandbLogWriter", "neptune": "NeptuneLogWriter"}
"""rsl-rl's writers, which write TensorBoard events, too."""
PROJECT = "warpvox"
"""Name of the project in Weights & Biases and Neptune."""

TAGS = {
    "return_mean": "Train/return",
    "length_mean": "Train/length",
    "eval_return": "Eval/return",
    "best_return": "Eval/best",
    "eval_q10": "Eval/q10",
    "eval_q50": "Eval/q50",
    "eval_q90": "Eval/q90",
    "value_loss": "Loss/value",
    "surrogate_loss": "Loss/surrogate",
    "entropy": "Loss/entropy",
    "learning_rate": "Loss/learning_rate",
    "action_std": "Policy/std",
    "steps_per_second": "Perf/steps_per_second",
}


class Metrics:
    """Writes one row an iteration; rows that a resumed run will write again are dropped first.

    Every row is with the system before the next iteration begins, in ``metrics.csv`` and in the TensorBoard events.

    Args:
        folder: of the run; must exist.
        iteration: iterations complete when writing begins.
        logger: one of :data:`warpvox.algos.settings.LOGGERS`, checked by :func:`check_logger`.

    Raises:
        StorageError: the folder cannot be written; so do all methods.
    """

    def __init__(self, folder: Path, iteration: int = 0, logger: str = "tensorboard") -> None:
        self.path = folder / FILE
        kept = [row for row in read_metrics(folder) if row["iteration"] <= iteration]
        text = "".join([_line(COLUMNS), *(_line(_cells(row)) for row in kept)])
        write_text(self.path, text, make_folders=False)
        self._events = self._writer = None
        if logger == "tensorboard":
            self._events = Events(folder, purge_step=iteration + 1)
        elif logger in WRITERS:
            from rsl_rl.utils import resolve_callable

            self._writer = resolve_callable(WRITERS[logger])(log_dir=str(folder), project_name=PROJECT)

    def write(self, row: Mapping[str, float], log: Mapping[str, float] | None = None) -> None:
        """Append a row (keys of :data:`COLUMNS`); ``log`` goes to the logger only, under its own tags."""
        with writing(self.path), self.path.open("a", encoding="utf-8", newline="") as file:
            if not file.tell():  # somebody has moved it away
                file.write(_line(COLUMNS))
            file.write(_line(_cells(row)))
        known = {tag: row[name] for name, tag in TAGS.items() if _known(row.get(name))}
        scalars, step = known | dict(log or {}), int(row["iteration"])
        if self._events is not None:
            self._events.write(scalars, step)
        if self._writer is not None:
            for tag, value in scalars.items():
                self._writer.add_scalar(tag, value, step)

    def close(self) -> None:
        """Close the files and the run of the logger."""
        if self._events is not None:
            self._events.close()
        if self._writer is not None:
            self._writer.stop()


def check_logger(name: str) -> None:
    """Raise ConfigError if a logger needs a package that is not installed."""
    if name in WRITERS and find_spec(name) is None:
        raise ConfigError(f"logger={name} needs the package {name}, which is not installed: pip install {name}")


class Events:
    """TensorBoard's file of scalars, written in the thread that calls.

    TensorBoard's own writer has a thread, which on a full disk would die with a traceback, and take with it what had
    not been written.

    Args:
        purge_step: what other files of the folder say of this step and later ones no longer holds.
    """

    def __init__(self, folder: Path, purge_step: int) -> None:
        # the import takes half a second
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog
        from tensorboard.compat.proto.summary_pb2 import Summary
        from tensorboard.summary.writer.record_writer import RecordWriter

        self._event, self._summary = Event, Summary
        name = f"events.out.tfevents.{time.time_ns() // 10**9:010}.{socket.gethostname()}.{os.getpid()}"
        self.path = next(path for k in itertools.count() if not (path := folder / f"{name}.{k}").exists())
        with writing(self.path):
            # without a buffer: what cannot be written would be tried again, and complained of, at the end of Python
            self._file = self.path.open("wb", buffering=0)
        self._buffer = io.BytesIO()
        self._records = RecordWriter(self._buffer)
        self._add(file_version="brain.Event:2", step=purge_step)
        self._add(session_log=SessionLog(status=SessionLog.START), step=purge_step)

    def write(self, scalars: Mapping[str, float], step: int) -> None:
        """Add values by their tags."""
        values = [self._summary.Value(tag=tag, simple_value=value) for tag, value in scalars.items()]
        self._add(summary=self._summary(value=values), step=step)

    def _add(self, **content: Any) -> None:
        self._buffer.seek(0)
        self._buffer.truncate()
        self._records.write(self._event(wall_time=time.time(), **content).SerializeToString())
        left = self._buffer.getbuffer()
        with left, writing(self.path):
            done = 0
            while done < len(left):
                done += self._file.write(left[done:])

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_metrics(folder: Path) -> list[dict[str, float]]:
    """The rows of a run's ``metrics.csv``, empty cells as NaN; no rows if there is no such file.

    A last line that was cut short by a crash is left out.

    Raises:
        RunError: the file holds something else.
    """
    path = folder / FILE
    if not path.is_file():
        return []
    rows = []
    try:
        for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
            if None in row or None in row.values():
                continue
            rows.append({name: float(text) if text else math.nan for name, text in row.items()})
    except (ValueError, csv.Error) as error:
        raise RunError(
            f"{path} is damaged ({error}); move it away, and a run that is resumed will begin a new one."
        ) from None
    if rows and not set(NEEDED) <= rows[0].keys():
        missing = listing([name for name in NEEDED if name not in rows[0]])
        raise RunError(f"{path} has no column {missing}; move it away, and the run will begin a new one.")
    return rows


def _cells(row: Mapping[str, float]) -> list[str]:
    return [_text(row.get(name)) for name in COLUMNS]


def _text(value: float | None) -> str:
    if not _known(value):
        return ""
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(f"{value:.9g}"))


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def _line(cells: tuple[str, ...] | list[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()
