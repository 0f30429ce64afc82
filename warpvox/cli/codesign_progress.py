"""What a design search shows while it runs, and the pictures and figures it leaves in its folder."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn
from rich.text import Text

from warpvox import __version__
from warpvox.algos.candidate import FINALIST, Candidate
from warpvox.algos.codesign.archive import Archive, Record
from warpvox.algos.codesign.loop import Listener
from warpvox.algos.report import FILE as REPORT, write_report
from warpvox.checks import is_number
from warpvox.cli.cell_text import body_rows
from warpvox.cli.fresh_seeds import fresh_text
from warpvox.io.console import duration, echo, figure
from warpvox.runs import read_summary, write_summary
from warpvox.view.body_picture import write_bodies

__all__ = ["Results", "SearchProgress"]

QUIET_SECONDS = 30.0
"""Without a terminal, seconds between lines."""
NAMES = {
    "ga": "genetic algorithm",
    "bo": "Bayesian optimisation",
    "cppn_neat": "CPPN-NEAT",
    "map_elites": "MAP-Elites",
    "random": "random search",
}


class Results:
    """Keeps ``generations/<n>.png``, ``report.html`` and ``summary.json`` up to date.

    Args:
        config: of the search.
        pretraining: control steps of the pretrained policy that it begins with; None: not known, or there is none.
    """

    def __init__(self, folder: Path, archive: Archive, config: Any, pretraining: int | None = None) -> None:
        self.folder, self.archive, self.config, self.pretraining = folder, archive, config, pretraining
        self.search = NAMES.get(config.search.algorithm, config.search.algorithm)
        summary = read_summary(folder)
        before, self.fresh = summary.get("elapsed_seconds"), summary.get("fresh_seeds")
        self._began, self._before = time.monotonic(), before if is_number(before) else 0.0

    @property
    def elapsed(self) -> float:
        """Seconds that the search has run, those before a resume included."""
        return self._before + time.monotonic() - self._began

    def best(self, until: int | None = None) -> list[Record]:
        """The best designs (up to and including a generation); finalists alone, once there are some."""
        best = self.archive.best(self.config.top, until)
        finalists = [record for record in best if record.candidate.origin == FINALIST]
        return finalists or best

    def draw(self, generation: int) -> Path:
        """The best designs up to and including a generation as PNG; one that is there already stays."""
        path = self.folder / "generations" / f"{generation:03}.png"
        best = self.best(generation)
        if path.is_file() or not best:
            return path
        captions = [
            (f"{record.fitness:.3f}", f"#{record.id}  generation {record.candidate.generation}") for record in best
        ]
        title = f"{self.config.task} · {self.search} · best designs after generation {generation}"
        return write_bodies(path, [record.candidate.body for record in best], captions, title)

    def write(self, status: str) -> dict[str, Any]:
        """Write report and summary; returns the summary."""
        rows = self.archive.generations()
        best = self.archive.best()
        steps = sum(row["steps"] or 0 for row in rows)
        summary = {
            "command": "codesign",
            "task": self.config.task,
            "search": self.config.search.algorithm,
            "status": status,
            "seed": self.config.seed,
            "evaluations": self.archive.trained(),
            "generations": sum(row["evaluated"] == row["designs"] for row in rows),
            "steps": steps,
            "best_fitness": best[0].fitness if best else None,
            "best_design": best[0].id if best else None,
            "design": best[0].candidate.body.tolist() if best else None,
            **({"fresh_seeds": self.fresh} if self.fresh else {}),
            **self._screening(),
            "elapsed_seconds": round(self.elapsed, 3),
            "steps_per_second": round(steps / self.elapsed, 1) if steps else None,
        }
        write_summary(self.folder, summary)
        self.report(summary)
        return summary

    def _screening(self) -> dict[str, Any]:
        """What there is to say of a search whose designs a common policy has compared."""
        if self.config.evaluation == "specialist":
            return {}
        screened = [record for record in self.archive.records() if record.candidate.origin != FINALIST]
        known = [record.fitness for record in screened if record.fitness is not None]
        return {
            "evaluation": self.config.evaluation,
            "screened_fitness": max(known, default=None),
            "screening_steps": sum(record.steps or 0 for record in screened),
            "pretraining_steps": self.pretraining,
        }

    def report(self, summary: Mapping[str, Any]) -> Path:
        """Write the report alone."""
        facts = {
            "task": self.config.task,
            "search": self.search,
            "status": str(summary.get("status", "unknown")),
            "time": duration(float(summary.get("elapsed_seconds", 0.0))),
            "seed": str(self.config.seed),
            "version": __version__,
        }
        if summary.get("fresh_seeds"):
            facts["winner on fresh seeds"] = fresh_text(summary["fresh_seeds"])
        if self.config.evaluation != "specialist":
            facts["evaluation"] = self.config.evaluation
        if self.pretraining is not None:
            facts["pretraining"] = f"{self.pretraining:,} control steps, not counted"
        return write_report(self.archive, self.folder / REPORT, facts)


class SearchProgress(Listener):
    """Shows the search: a live block on a terminal, else a line now and then; keeps the results up to date.

    A context manager. Args:
        total: evaluations that the search may spend, those of finalists included.
        costs: control steps that a design takes at most, and a finalist.
        finalists: how many of them; they come last.
    """

    def __init__(
        self, results: Results, total: int, console: Console, costs: tuple[float, float], finalists: int = 0
    ) -> None:
        self.results, self.total, self.console = results, total, console
        self._costs, self._finalists = costs, finalists
        self.archive = results.archive
        self._work: dict[int, _Training] = {}
        self._began = self._printed = time.monotonic()
        self._start = self.archive.trained()
        self._resumed = self.archive.count() > 0  # until a generation is whole: trainings may go on
        self._spent = 0  # control steps of trainings that have ended since the beginning
        self._first: tuple[float, int] | None = None  # time and control steps of the first news of a stage
        self._last = False  # the finalists are being evaluated
        self._generation = 0
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[figures]}"),
            console=console,
        )
        self._line = self._progress.add_task("", total=total, completed=self._start, figures="")
        self._live = Live(console=console, refresh_per_second=4, transient=True) if console.is_terminal else None

    def __enter__(self) -> SearchProgress:
        if self._live is not None:
            self._live.start()
            self._show()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    # ------------------------------------------------------------------------------------------ what happens

    def proposed(self, generation: int, waiting: Sequence[Candidate], total: int) -> None:
        """See :class:`warpvox.algos.codesign.loop.Listener`."""
        self._generation, self._work = generation, {}
        last = any(candidate.origin == FINALIST for candidate in waiting)
        self._first = self._first if last == self._last else None
        self._last = last
        if self._live is None:
            reused = f", {total - len(waiting)} known" if total > len(waiting) else ""
            echo(self.console, f"generation {generation}: {len(waiting)} designs to evaluate{reused}")
        self._show()

    def progress(self, batch: Sequence[Candidate], event: dict[str, Any]) -> None:
        """See :class:`warpvox.algos.codesign.loop.Listener`."""
        training = self._work.setdefault(batch[0].id, _Training(len(batch), event["steps"] if self._resumed else 0))
        training.event = event
        now = time.monotonic()
        self._first = self._first or (now, self._steps)
        if self._live is None and now - self._printed >= QUIET_SECONDS:
            self._printed = now
            echo(self.console, f"  {self._inside()}  {self._figures()}")
        self._show()

    def finished(self, records: Sequence[Record]) -> None:
        """See :class:`warpvox.algos.codesign.loop.Listener`."""
        for record in records:
            training = self._work.pop(record.id, None)
            if training is not None:
                self._spent += training.steps
        self._show()

    def told(self, generation: int, fresh: bool) -> None:
        """See :class:`warpvox.algos.codesign.loop.Listener`."""
        self.results.draw(generation)
        if not fresh:
            return
        self._resumed = False
        self.results.write("running")
        row = self.archive.generations()[generation]
        echo(
            self.console,
            f"generation {generation} done: {self.archive.trained()}/{self.total} designs  best {row['best']:.3f}"
            f"  mean {row['mean']:.3f}  best so far {self.archive.best()[0].fitness:.3f}{self._diverged(generation)}"
            f"  {self._figures()}",
        )
        if self._live is None:
            self.console.print(self._bodies())
        self._show()

    # ------------------------------------------------------------------------------------------ what is shown

    @property
    def done(self) -> float:
        """Designs trained, those under way in part."""
        return self.archive.trained() + sum(training.share * training.designs for training in self._work.values())

    @property
    def steps_per_second(self) -> float:
        """Control steps of training per second since the beginning."""
        return self._steps / max(time.monotonic() - self._began, 1e-9)

    @property
    def _steps(self) -> int:
        """Control steps of training since the beginning."""
        return self._spent + sum(training.steps for training in self._work.values())

    @property
    def under_way(self) -> str:
        """The designs that are being evaluated, for the end of a sentence; empty if nothing is."""
        if not self._work:
            return ""
        designs = sum(training.designs for training in self._work.values())
        steps = sum(training.event["steps"] for training in self._work.values())
        return f"; {designs} more under way, {self._iteration()} and {steps:,} control steps"

    def _figures(self) -> str:
        return f"{self.steps_per_second:,.0f} steps/s  left {self._left()}"

    def _diverged(self, generation: int) -> str:
        """How many designs' learning gave nothing to judge."""
        count = sum(record.diverged for record in self.archive.records(generation))
        return f"  {count} diverged" if count else ""

    def _left(self) -> str:
        """The time until the search is done, or its finalists begin, which take another time for a control step."""
        if self._first is None or self._steps <= self._first[1]:
            return "-"
        began, before = self._first
        trained, cost = self.archive.trained(), self._costs[self._last]
        if trained and not self._last:  # fewer than at most, where episodes end early
            cost = sum(row["steps"] or 0 for row in self.archive.generations()) / trained
        designs = self.total - trained - (0 if self._last else self._finalists)
        steps = cost * designs - sum(training.event["steps"] for training in self._work.values())
        left = duration((time.monotonic() - began) / (self._steps - before) * max(steps, 0.0))
        return left if self._last or not self._finalists else f"{left}, then {self._finalists} finalists"

    def _inside(self) -> str:
        """The trainings under way in words."""
        events = [training.event for training in self._work.values()]
        if not events:
            return "starting"
        going = sum(sum(event["training"]) for event in events)
        best = max((value for event in events for value in event["best"] if math.isfinite(value)), default=math.nan)
        lost = sum(
            math.isnan(value) and not training
            for event in events
            for value, training in zip(event["best"], event["training"], strict=True)
        )
        diverged = f", {lost} diverged" if lost else ""
        return f"{self._iteration()}, {going} in training{diverged}, best of them {figure(best)}"

    def _iteration(self) -> str:
        events = [training.event for training in self._work.values()]
        done, total = (min(event[name] for event in events) for name in ("iteration", "iterations"))
        return f"iteration {done}/{total}"

    def _show(self) -> None:
        if self._live is None:
            return
        best = self.archive.best()
        figures = f"{self.archive.trained()}/{self.total}  best {figure(best[0].fitness if best else math.nan)}  "
        rows = [row for row in self.archive.generations() if row["evaluated"]]
        figures += f"mean {figure(rows[-1]['mean'] if rows else math.nan)}  {self._figures()}"
        self._progress.update(
            self._line, completed=self.done, description=f"generation {self._generation}", figures=figures
        )
        parts = [self._progress, Text(f"  {self._inside()}", "dim")]
        self._live.update(Group(*parts, *([Text(), self._bodies()] if best else [])))

    def _bodies(self) -> Text:
        best = self.results.best()
        captions = [f"{record.fitness:.3f} #{record.id}" for record in best]
        return body_rows([record.candidate.body for record in best], captions, self.console)


class _Training:
    """A batch under way; ``before``: steps that it had already spent when it was resumed."""

    def __init__(self, designs: int, first: int) -> None:
        self.designs, self.event = designs, {}
        self.first = first

    @property
    def share(self) -> float:
        return self.event["iteration"] / self.event["iterations"]

    @property
    def steps(self) -> int:
        return self.event["steps"] - self.first
