"""Progress of a design search on a terminal."""

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn
from rich.text import Text

from warpvox.algos.archive import Record
from warpvox.algos.candidate import FINALIST, Candidate
from warpvox.algos.codesign.results import evaluated_text, fresh_text
from warpvox.algos.codesign.run import SearchRun
from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.find import find_run
from warpvox.algos.listener import Listener
from warpvox.algos.report import FILE as REPORT
from warpvox.code import words_of_code
from warpvox.errors import RunError, counted
from warpvox.io.console import echo
from warpvox.io.text import duration, figure, shell_argument, shown
from warpvox.view.cell_text import body_rows

QUIET_SECONDS = 30.0
"""Seconds between lines without a terminal."""


def with_tracker(settings: Codesign, listeners: Sequence[Listener]) -> list[Listener]:
    """Prepend a listener for Weights & Biases to ``listeners`` if the search uses it."""
    if settings.logger != "wandb":
        return list(listeners)
    return [_TrackedSearch(settings), *listeners]


class _TrackedSearch(Listener):
    """Logs a search to Weights & Biases: fitness and best bodies of each generation, a film at the end."""

    def __init__(self, settings: Any) -> None:
        self._settings = settings

    def begun(self, run: SearchRun) -> None:
        from warpvox.progress.tracking import Tracker

        self._run = run
        self._tracker = Tracker(run.folder, "codesign", self._settings.search.algorithm)

    def told(self, generation: int, fresh: bool) -> None:
        """Log fitness, evaluations and the picture of a new generation."""
        if fresh:
            archive = self._run.archive
            rows = archive.generations()
            figures = {"mean": rows[generation]["mean"], "best": archive.best()[0].fitness}
            figures |= {"evaluations": archive.trained(), "steps": sum(row["steps"] or 0 for row in rows)}
            tagged = {f"Search/{name}": value for name, value in figures.items()}
            self._tracker.log(tagged, generation, self._run.folder / "generations" / f"{generation:03}.png")

    def ended(self, summary: Mapping[str, Any]) -> None:
        self._tracker.end(summary, self._settings)


class SearchProgress(Listener):
    """Shows the progress of a search: a live display on a terminal, else occasional lines."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._work: dict[int, _Training] = {}
        self._live: Live | None = None

    def begun(self, run: SearchRun) -> None:
        """Start the clock, print the first lines, and start the live display on a terminal."""
        self.run = run
        self.archive = run.archive
        self._began = self._printed = time.monotonic()
        self._start = self.archive.trained()
        self._spent = 0  # control steps of the trainings that this process has completed
        self._first: tuple[float, int] | None = None  # time and control steps at the first report of a stage
        self._last = False  # whether the finalists are being evaluated
        self._generation = 0
        self._print_start()
        columns = TextColumn("{task.description}"), BarColumn(bar_width=24), TextColumn("{task.fields[figures]}")
        self._progress = Progress(*columns, console=self.console)
        self._line = self._progress.add_task("", total=run.total, completed=self._start, figures="")
        if self.console.is_terminal:
            self._live = Live(console=self.console, refresh_per_second=4, transient=True)
            self._live.start()
            self._show()

    def _print_start(self) -> None:
        """Print algorithm, task, device and folder, and the remaining work of a resumed search."""
        run = self.run
        settings = self.run.settings
        where = f"{run.workers} workers of Ray" if run.workers else settings.device
        done = f", {self._counts()} done" if run.resumed else ""
        echo(self.console, f"{run.settings.search.title} on {settings.task}, rules {settings.rules}, on {where}{done}")
        folder = run.folder
        budget = settings.search.max_designs
        echo(self.console, f"run folder: {shown(folder)}")
        files = [folder / record.policy_file for record in self.archive.records() if record.policy_file]
        if lost := [file for file in files if not file.is_file()]:
            echo(self.console, f"the policies of {len(lost)} designs are gone from {shown(folder / 'designs')}")
        if run.resumed and self._start >= run.total:
            spent = f"the search has spent its {budget} evaluations: nothing is left to do. What"
            more = " it proposes depends on them, so that more make another search (search.max_designs=N)"
            echo(self.console, spent + more)

    def ended(self, summary: Mapping[str, Any]) -> None:
        """Print the result, and the commands to view or resume the search."""
        if self._live is not None:
            self._live.stop()
        if not summary:
            return
        folder = self.run.folder
        best = summary["best_design"]
        status = summary["status"]
        text = f"{status} after {evaluated_text(summary)} and {summary['steps']:,} control steps"
        if status == "interrupted" and self._work:
            designs = sum(training.designs for training in self._work.values())
            text += f"; {designs} more were under way, to be evaluated again"
        if best is not None:
            text += f"; best fitness {summary['best_fitness']:.3f} (design {best})"
        echo(self.console, text)
        if summary.get("fresh_seeds"):
            echo(self.console, f"the best on fresh seeds: {fresh_text(summary['fresh_seeds'])}")
        if best is not None:
            echo(self.console, f"report: {(folder / REPORT).resolve().as_uri()}")
            with suppress(RunError):  # a user's own evaluator may give no policy
                keys = words_of_code(find_run(str(folder), "").config)
                echo(self.console, f"look at the best: warpvox play {shell_argument('run', folder)}{keys}")
        if status != "done":
            keys = words_of_code(self.run.settings)
            echo(self.console, f"go on: warpvox codesign {shell_argument('resume', folder)}{keys}")

    def proposed(self, generation: int, waiting: Sequence[Candidate], total: int) -> None:
        """Start a generation, and print the number of designs to evaluate."""
        self._generation = generation
        self._work = {}
        last = any(candidate.origin == FINALIST for candidate in waiting)
        self._first = self._first if last == self._last else None
        self._last = last
        if self._live is None:
            reused = f", {total - len(waiting)} known" if total > len(waiting) else ""
            echo(self.console, f"generation {generation}: {counted(len(waiting), 'designs')} to evaluate{reused}")
        self._show()

    def progress(self, batch: Sequence[Candidate], event: dict[str, Any]) -> None:
        """Record the progress of a batch, and print an occasional line without a terminal."""
        self._work[batch[0].id] = _Training(len(batch), event)
        now = time.monotonic()
        self._first = self._first or (now, self._steps)
        if self._live is None and now - self._printed >= QUIET_SECONDS:
            self._printed = now
            echo(self.console, f"  {self._training_text()}  {self._figures()}")
        self._show()

    def finished(self, records: Sequence[Record]) -> None:
        for record in records:
            if training := self._work.pop(record.id, None):
                self._spent += training.steps
        self._show()

    def told(self, generation: int, fresh: bool) -> None:
        """Print the best and mean fitness of a new generation."""
        if not fresh:
            return
        row = self.archive.generations()[generation]
        count = sum(r.diverged for r in self.archive.records(generation))
        text = f"generation {generation} done: {self._counts()}  best {row['best']:.3f}  mean {row['mean']:.3f}"
        if not self._last:  # finalists may be evaluated in another way than designs before
            text += f"  best so far {self.archive.best()[0].fitness:.3f}"
        echo(self.console, f"{text}{f'  {count} diverged' if count else ''}  {self._figures()}")
        if self._live is None:
            self.console.print(self._bodies())
        self._show()

    def _counts(self) -> str:
        """Format the numbers of evaluated designs and finalists."""
        finalists = self.archive.finalists()
        text = f"{self.archive.trained() - finalists}/{self.run.total - self.run.finalists} designs"
        if self._last or finalists:
            text += f", {finalists}/{self.run.finalists} finalists"
        return text

    @property
    def done(self) -> float:
        """Number of evaluated designs, plus fractions for those in training."""
        return self.archive.trained() + sum(training.share * training.designs for training in self._work.values())

    @property
    def _steps(self) -> int:
        """Control steps trained since this process started or resumed the search."""
        return self._spent + sum(training.steps for training in self._work.values())

    def _figures(self) -> str:
        rate = self._steps / max(time.monotonic() - self._began, 1e-9)
        return f"{rate:,.0f} steps/s  left {self._time_left()}"

    def _time_left(self) -> str:
        """Format the estimated time until the search, or its part before the finalists, is done."""
        if self._first is None or self._steps <= self._first[1]:
            return "-"
        began, before = self._first
        if self.run.costs is None:
            return "-"
        trained = self.archive.trained()
        cost = self.run.costs[self._last]
        if trained and not self._last:  # the mean so far, because episodes may end early
            cost = sum(row["steps"] or 0 for row in self.archive.generations()) / trained
        designs = self.run.total - trained - (0 if self._last else self.run.finalists)
        steps = cost * designs - sum(training.steps for training in self._work.values())
        left = duration((time.monotonic() - began) / (self._steps - before) * max(steps, 0.0))
        return left if self._last or not self.run.finalists else f"{left}, then {self.run.finalists} finalists"

    def _training_text(self) -> str:
        """Format the progress of the trainings in this generation."""
        events = [training.event for training in self._work.values()]
        if not events:
            return "starting"
        active = sum(sum(event["training"]) for event in events)
        designs = [one for event in events for one in zip(event["best"], event["training"], strict=True)]
        best = max((value for value, _ in designs if math.isfinite(value)), default=math.nan)
        lost = sum(math.isnan(value) and not training for value, training in designs)
        diverged = f", {lost} diverged" if lost else ""
        done = min(event["iteration"] for event in events)
        total = min(event["iterations"] for event in events)
        return f"iteration {done}/{total}, {active} in training{diverged}, best of them {figure(best)}"

    def _show(self) -> None:
        """Refresh the live display, if there is one."""
        if self._live is None:
            return
        best = self.archive.best()
        fitness = cast(float, best[0].fitness) if best else math.nan
        figures = f"{self._counts()}  best {figure(fitness)}  "
        rows = [row for row in self.archive.generations() if row["evaluated"]]
        figures += f"mean {figure(rows[-1]['mean'] if rows else math.nan)}  {self._figures()}"
        description = f"generation {self._generation}"
        self._progress.update(self._line, completed=self.done, description=description, figures=figures)
        parts = [self._progress, Text(f"  {self._training_text()}", "dim")]
        self._live.update(Group(*parts, *([Text(), self._bodies()] if best else [])))

    def _bodies(self) -> Text:
        best = self.archive.best(self.run.settings.top)
        captions = [f"{record.fitness:.3f} #{record.id}" for record in best]
        return body_rows([record.candidate.body for record in best], captions, self.console)


@dataclass
class _Training:
    """A batch being evaluated: number of designs, and the last progress event."""

    designs: int
    event: dict[str, Any]

    @property
    def share(self) -> float:
        return self.event["iteration"] / self.event["iterations"]

    @property
    def steps(self) -> int:
        return self.event["steps"]
