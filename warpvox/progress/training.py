"""Progress of a training: lines or a live display on a terminal, an element in a notebook."""

import html
import math
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from warpvox.algos.listener import Listener
from warpvox.algos.training.held_out import HeldOut
from warpvox.algos.training.job import Job
from warpvox.code import words_of_code
from warpvox.errors import counted
from warpvox.io.console import echo
from warpvox.io.text import duration, figure, shell_argument, shown
from warpvox.runs import STATE

QUIET_SECONDS = 10.0
"""Seconds between lines without a terminal; an evaluation always prints one."""


def with_tracker(logger: str, listeners: Sequence[Listener]) -> list[Listener]:
    """Prepend a listener for Weights & Biases to ``listeners`` if ``logger`` is ``wandb``."""
    if logger != "wandb":
        return list(listeners)
    from warpvox.progress.tracking import TrackedTraining

    return [TrackedTraining(), *listeners]


class Figures:
    """Formats metrics as a progress line, and remembers the last known returns."""

    exploring = last_eval = math.nan
    diverged = 0

    def text(self, row: Mapping[str, float]) -> str:
        """Format a row of metrics as text."""
        if math.isfinite(row["return_mean"]):
            self.exploring = row["return_mean"]
        if math.isfinite(row["eval_return"]):
            self.last_eval = row["eval_return"]
        self.diverged += int(row["diverged"])
        return (
            f"{row['steps_per_second']:,.0f} steps/s  return {figure(self.exploring, 2)}"
            f"  eval {figure(self.last_eval, 2)}  best {figure(row['best_return'], 2)}"
            + (f"  unstable {row['unstable']:.0f}" if row["unstable"] else "")
            + (f"  diverged {self.diverged} in all" if self.diverged else "")
        )


class Terminal(Listener):
    """Shows iterations, speed, returns and time left: a live line on a terminal, else occasional lines."""

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or Console()
        self._bar: Progress | None = None

    def preparing(self, what: str) -> AbstractContextManager[object]:
        return self.console.status(what)

    def begun(self, run: Job) -> None:
        """Print the announcement, and start the live line on a terminal."""
        echo(self.console, _announcement(run))
        self._job = run
        self._figures = Figures()
        self._spent = run.runner.spent
        self._total = run.runner.schedule.total
        self._start = run.runner.current_learning_iteration
        self._began = self._printed = time.monotonic()
        if self.console.is_terminal:
            wide = self.console.width >= 110  # room for a bar
            self._bar = Progress(
                TextColumn("{task.completed}/{task.total}"),
                *([BarColumn(bar_width=16)] if wide else []),
                TextColumn("{task.fields[figures]}"),
                *([TextColumn("{task.fields[spent]}")] if self.console.width >= 150 else []),
                *([TimeElapsedColumn()] if wide else []),
                TextColumn("left"),
                TimeRemainingColumn(),
                console=self.console,
                refresh_per_second=4,
            )
            self._line = self._bar.add_task("", total=self._total, completed=self._start, figures="", spent="")
            self._bar.start()

    def iterated(self, row: Mapping[str, float]) -> None:
        """Update the live line, or print a line after an evaluation or every few seconds."""
        figures = self._figures.text(row)
        done = row["iteration"]
        if self._bar is not None:
            self._bar.update(self._line, completed=done, figures=figures, spent=str(self._spent))
            return
        now = time.monotonic()
        if math.isfinite(row["eval_return"]) or now - self._printed >= QUIET_SECONDS or done == self._total:
            self._printed = now
            left = duration((now - self._began) / max(done - self._start, 1) * (self._total - done))
            echo(self.console, f"iteration {done}/{self._total}  {figures}  left {left}  {self._spent}".rstrip())

    def ended(self, summary: Mapping[str, Any]) -> None:
        if self._bar is not None:
            self._bar.stop()
        if summary:
            echo(self.console, _conclusion(self._job, time.monotonic() - self._began))


class Notebook(Listener):
    """Shows the progress of a training in one notebook element, updated in place without widgets."""

    def begun(self, run: Job) -> None:
        """Create the notebook element that shows the progress."""
        # IPython runs the notebook; it is not a dependency of ours.
        from IPython.display import HTML, display  # pyright: ignore[reportMissingImports]

        self._html = HTML
        self._job = run
        self._figures = Figures()
        self._began = time.monotonic()
        self._total = run.runner.schedule.total
        self._said = _announcement(run)
        self._place = display(HTML(""), display_id=True)
        self._show(run.runner.current_learning_iteration, "")

    def iterated(self, row: Mapping[str, float]) -> None:
        self._show(int(row["iteration"]), self._figures.text(row))

    def _show(self, done: int, line: str) -> None:
        bar = f"<progress value={done} max={self._total}></progress> {done}/{self._total} {html.escape(line)}"
        self._place.update(self._html(f"<pre>{html.escape(self._said)}</pre>{bar}"))

    def ended(self, summary: Mapping[str, Any]) -> None:
        if summary:
            text = f"{self._said}\n{_conclusion(self._job, time.monotonic() - self._began)}"
            self._place.update(self._html(f"<pre>{html.escape(text)}</pre>"))


def _announcement(job: Job) -> str:
    """Compose the lines that announce a training: task, device and folder."""
    config = job.written
    runner = job.runner
    done = runner.current_learning_iteration
    verb = f"resuming after iteration {done}" if done else "training"
    where = config.device if runner.group.size == 1 else f"{runner.group.size} processes, {config.device}"
    lines = [f"{verb}: {config.task}, {counted(config.num_envs, 'environments')} on {where}, rules {config.rules}"]
    if isinstance(job.judge, HeldOut):
        lines.append(f"evaluated on {job.judge.about}")
    if config.pretrained is not None and not done:
        lines.append(f"beginning with the policy {shown(Path(config.pretrained))}")
    if job.folder is not None:
        lines.append(f"run folder: {shown(job.folder)}")
    if done and done == runner.schedule.total:
        lines.append(
            f"all {done} iterations are made, only the summary was missing; for more of them resume with"
            f" max_iterations={2 * done}"
        )
    return "\n".join(lines)


def _conclusion(job: Job, seconds: float) -> str:
    """Compose the lines at the end of a training: status, best return, and commands to continue."""
    runner = job.runner
    folder = job.folder
    status = job.summary["status"]
    best = job.summary["best_return"]
    words = f"{status}, state saved" if status == "interrupted" else status
    if status != "done" and (folder is None or runner.saved_iteration != runner.current_learning_iteration):
        words = status if folder is None else f"{status}, the state of iteration {runner.saved_iteration} is kept,"
    text = f"{words} after {runner.steps:,} control steps in {seconds:.0f} s"
    if best is not None:
        text += f"; best evaluation {best:.2f} (iteration {runner.best_iteration})"
    if str(runner.spent):
        text += f"\nwhere time went: {runner.spent}"
    if folder is None:
        return text
    keys = words_of_code(job.settings)
    if status == "done":
        text += f"\nlook at it: warpvox play {shell_argument('run', folder)}{keys} 'export=[gif,html]'"
    if status != "done" and (folder / STATE).is_file():
        text += f"\ngo on: warpvox train {shell_argument('resume', folder)}{keys}"
    return text
