"""What a training run leaves behind for plots: ``metrics.csv`` and TensorBoard events."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from pathlib import Path

from warpvox.files import write_text

__all__ = ["COLUMNS", "Metrics", "read_metrics"]

COLUMNS = (
    "iteration",  # iterations complete
    "steps",  # control steps of all environments since the start
    "episodes",  # that ended in this iteration
    "return_mean",  # of those, exploring; empty if none ended
    "length_mean",  # of those, in control steps
    "eval_return",  # deterministic; empty if there was no evaluation
    "best_return",  # the best evaluation so far
    "value_loss",
    "surrogate_loss",
    "entropy",
    "learning_rate",
    "action_std",  # mean standard deviation of the policy's output
    "steps_per_second",  # of this iteration, learning included, evaluation not
    "elapsed",  # seconds of all iterations and evaluations so far
)
FILE = "metrics.csv"

TAGS = {
    "return_mean": "Train/return",
    "length_mean": "Train/length",
    "eval_return": "Eval/return",
    "best_return": "Eval/best",
    "value_loss": "Loss/value",
    "surrogate_loss": "Loss/surrogate",
    "entropy": "Loss/entropy",
    "learning_rate": "Loss/learning_rate",
    "action_std": "Policy/std",
    "steps_per_second": "Perf/steps_per_second",
}


class Metrics:
    """Writes one row an iteration; rows that a resumed run will write again are dropped first.

    Args:
        folder: of the run; must exist.
        iteration: iterations complete when writing begins.
    """

    def __init__(self, folder: Path, iteration: int = 0) -> None:
        # the import takes a second or two
        from torch.utils.tensorboard import SummaryWriter

        self.path = folder / FILE
        kept = [row for row in read_metrics(folder) if row["iteration"] <= iteration]
        write_text(self.path, "".join([_line(COLUMNS), *(_line(_cells(row)) for row in kept)]))
        self._writer = SummaryWriter(str(folder), purge_step=iteration + 1, flush_secs=10)

    def write(self, row: Mapping[str, float], log: Mapping[str, float] | None = None) -> None:
        """Append a row (keys of :data:`COLUMNS`); ``log`` goes to TensorBoard only, under its own tags."""
        with self.path.open("a", encoding="utf-8", newline="") as file:
            file.write(_line(_cells(row)))
        for name, tag in TAGS.items():
            if _known(row.get(name)):
                self._writer.add_scalar(tag, row[name], row["iteration"])
        for tag, value in (log or {}).items():
            self._writer.add_scalar(tag, value, row["iteration"])

    def close(self) -> None:
        """Flush everything to disk."""
        self._writer.close()


def read_metrics(folder: Path) -> list[dict[str, float]]:
    """The rows of a run's ``metrics.csv``, empty cells as NaN; no rows if there is no such file.

    A last line that was cut short by a crash is left out.
    """
    path = folder / FILE
    if not path.is_file():
        return []
    rows = []
    for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
        if None in row or None in row.values():
            continue
        rows.append({name: float(text) if text else math.nan for name, text in row.items()})
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
