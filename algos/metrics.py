"""Metrics of a training run: ``metrics.csv``, TensorBoard events, and rsl-rl's writers for other services."""

import csv
import math
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeGuard

from warpvox.errors import ConfigError, RunError, listing
from warpvox.io.reading import read_table
from warpvox.io.writing import write_text, writing

COLUMNS = {
    "iteration": "",  # iterations complete
    "steps": "",  # control steps of all environments since the start
    "episodes": "",  # that ended in this iteration
    "return_mean": "Train/return",  # of those, exploring; empty if none ended
    "length_mean": "Train/length",  # of those, in control steps
    "unstable": "",  # episodes that were stopped in this iteration, by self-folding or divergence
    "diverged": "",  # those of them that diverged
    "eval_return": "Eval/return",  # deterministic; empty if there was no evaluation
    "best_return": "Eval/best",  # the best evaluation so far
    "eval_q10": "Eval/q10",  # quantiles of the evaluation's mean returns by body, where there are several bodies
    "eval_q50": "Eval/q50",
    "eval_q90": "Eval/q90",
    "value_loss": "Loss/value",
    "surrogate_loss": "Loss/surrogate",
    "entropy": "Loss/entropy",
    "learning_rate": "Loss/learning_rate",
    "action_std": "Policy/std",  # mean standard deviation of the policy's output
    "steps_per_second": "Perf/steps_per_second",  # of this iteration, learning included, evaluation not
    "elapsed": "",  # seconds of all iterations and evaluations so far
}
"""Columns of ``metrics.csv`` and their logger tags (empty: not logged)."""
FILE = "metrics.csv"
SERVICES = ("wandb", "neptune")
"""Loggers that need a package of their own; TensorBoard events are written as well."""


class Metrics:
    """Writes each iteration to ``metrics.csv`` and a logger; a resumed run drops rows that will be repeated.

    Every row is with the system before the next iteration begins, in ``metrics.csv`` and in the TensorBoard events.
    ``logger``: one of :data:`warpvox.algos.settings.LOGGERS`, checked by :func:`check_logger`.
    """

    def __init__(self, folder: Path, iteration: int = 0, logger: str = "tensorboard") -> None:
        self.path = folder / FILE
        kept = [row for row in read_metrics(folder) if row["iteration"] <= iteration]
        self._header = ",".join(COLUMNS) + "\n"
        write_text(self.path, self._header + "".join(map(_row_line, kept)), make_folders=False)
        self._writer: Any = None
        # these imports take half a second
        if logger in ("tensorboard", "wandb"):  # :class:`warpvox.progress.tracking.Tracker` sends the rows
            from torch.utils.tensorboard import SummaryWriter

            with writing(folder):
                self._writer = SummaryWriter(str(folder), purge_step=iteration + 1)
        elif logger == "neptune":
            from rsl_rl.utils import resolve_callable

            self._writer = resolve_callable("NeptuneLogWriter")(log_dir=str(folder), project_name="warpvox")

    def write(self, row: Mapping[str, float], log: Mapping[str, float] | None = None) -> None:
        """Append a row (keys of :data:`COLUMNS`); ``log`` holds further values for the logger, by tag."""
        with writing(self.path), self.path.open("a", encoding="utf-8", newline="") as file:
            if not file.tell():  # the file was moved away: begin a new one
                file.write(self._header)
            file.write(_row_line(row))
        if self._writer is not None:
            with writing(self.path.parent):
                for tag, value in (tagged(row) | dict(log or {})).items():
                    self._writer.add_scalar(tag, value, int(row["iteration"]))
                self._writer.flush()

    def close(self) -> None:
        if self._writer is not None:
            with writing(self.path.parent):
                self._writer.close()
            if hasattr(self._writer, "stop"):  # the logger's service has to be stopped as well
                self._writer.stop()


def tagged(row: Mapping[str, float]) -> dict[str, float]:
    """Return the known values of a row by logger tag."""
    return {tag: row[name] for name, tag in COLUMNS.items() if tag and _known(row.get(name))}


def check_logger(name: str) -> None:
    """Raise ConfigError if the package of a logger is not installed."""
    if name in SERVICES and find_spec(name) is None:
        raise ConfigError(f"logger={name} needs the package {name}, which is not installed: pip install {name}")


def read_metrics(folder: Path) -> list[dict[str, float]]:
    """Read a run's ``metrics.csv``, empty cells as NaN; no rows if the file is missing.

    A last line that was cut short by a crash is left out.
    """
    path = folder / FILE
    rows = []
    try:
        # A file of 1 GiB holds seven million iterations.
        for row in read_table(path, 1 << 30):
            if None in row or None in row.values():
                continue
            rows.append({name: float(text) if text else math.nan for name, text in row.items()})
    except (ValueError, csv.Error) as error:
        raise RunError(
            f"{path} is damaged ({error}); move it away, and a run that is resumed will begin a new one."
        ) from None
    # Columns that are used; files of earlier versions may lack others.
    needed = ("iteration", "steps", "eval_return", "elapsed")
    if rows and not set(needed) <= rows[0].keys():
        missing = listing([name for name in needed if name not in rows[0]])
        raise RunError(f"{path} has no column {missing}; move it away, and the run will begin a new one.")
    return rows


def _row_line(row: Mapping[str, float]) -> str:
    """Format a row as a line of ``metrics.csv``; unknown values are empty."""
    cells = []
    for name in COLUMNS:
        value = row.get(name)
        if not _known(value):
            cells.append("")
        elif float(value).is_integer() and abs(value) < 1e15:
            cells.append(str(int(value)))
        else:
            cells.append(repr(float(f"{value:.9g}")))
    return ",".join(cells) + "\n"


def _known(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)
