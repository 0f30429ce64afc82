"""Results of a design search: report, pictures and summary in its folder, and the returned object."""

import dataclasses
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from warpvox import __version__
from warpvox.algos.archive import FILE as ARCHIVE, Archive, Record
from warpvox.algos.candidate import FINALIST
from warpvox.algos.checkpoints.policy import Policy
from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.find import find_run
from warpvox.algos.listener import Listener
from warpvox.algos.protocols import NOMINAL
from warpvox.algos.report import FILE as REPORT, FILM, report_page
from warpvox.algos.report.charts import picture
from warpvox.algos.report.members import fresh_interval, read_members
from warpvox.algos.training.playing import Playing, load_result, own_code
from warpvox.algos.training.policy_table import evaluate_run
from warpvox.design import Design
from warpvox.envs.registry import get_task
from warpvox.errors import WarpvoxError, counted
from warpvox.io.text import duration
from warpvox.io.writing import atomic_path, write_text
from warpvox.palette import body_svg
from warpvox.runs import read_summary, write_summary
from warpvox.view.body_picture import draw_bodies
from warpvox.view.painter import save_png
from warpvox.view.render import Film
from warpvox.view.rollout import record

FRESH = 64
"""Number of episodes with unused seeds for the final evaluation of the winner of a random task."""


class Results(Listener):
    """Listener that keeps a search's pictures, ``report.html`` and ``summary.json`` up to date."""

    def __init__(self, folder: Path, archive: Archive, settings: Codesign) -> None:
        """Open the results in ``folder``, continuing from an existing ``summary.json``."""
        self.folder = folder
        self.archive = archive
        self.settings = settings
        summary = read_summary(folder)
        self.fresh = summary.get("fresh_seeds")
        self._began = time.monotonic() - summary.get("elapsed_seconds", 0.0)  # continue the time of a resumed search

    def told(self, generation: int, fresh: bool) -> None:
        """Draw the best designs, and write report and summary after a new generation."""
        self.draw(generation, keep=not fresh)
        if fresh:
            self.write("running")

    def draw(self, generation: int, keep: bool = True) -> Path:
        """Draw the best designs up to ``generation`` as PNG; return its path. ``keep``: do not overwrite."""
        path = self.folder / "generations" / f"{generation:03}.png"
        best = self.archive.best(self.settings.top, generation)
        if not best or (keep and path.is_file()):
            return path
        captions = [(f"{one.fitness:.3f}", f"#{one.id}  generation {one.candidate.generation}") for one in best]
        title = f"{self.settings.task} · {self.settings.search.title} · best designs after generation {generation}"
        return save_png(draw_bodies([record.candidate.body for record in best], captions, title), path)

    def write(self, status: str) -> dict[str, Any]:
        """Write report and summary; return the summary as a dictionary."""
        rows = self.archive.generations()
        best = next(iter(self.archive.best()), None)
        steps = sum(row["steps"] or 0 for row in rows)
        elapsed = time.monotonic() - self._began
        summary = {
            "command": "codesign",
            "task": self.settings.task,
            "search": self.settings.search.algorithm,
            "status": status,
            "seed": self.settings.seed,
            "evaluations": self.archive.trained(),
            "generations": sum(row["evaluated"] == row["designs"] for row in rows),
            "steps": steps,
            "best_fitness": best and best.fitness,
            "best_design": best and best.id,
            "design": best and best.candidate.body.tolist(),
            **({"fresh_seeds": self.fresh} if self.fresh else {}),
            **(self._screening() if self.settings.fitness.finalists else {}),
            "elapsed_seconds": round(elapsed, 3),
            "steps_per_second": round(steps / elapsed, 1) if steps else None,
        }
        write_summary(self.folder, summary)
        self.report(summary)
        return summary

    def _screening(self) -> dict[str, Any]:
        """Return summary entries for searches that compare designs without training each."""
        screened = [record for record in self.archive.records() if record.candidate.origin != FINALIST]
        known = [record.fitness for record in screened if record.fitness is not None]
        return {
            "fitness": self.settings.fitness.name,
            "finalists": self.archive.finalists(),
            "screened_fitness": max(known, default=None),
            "screening_steps": sum(record.steps or 0 for record in screened),
        }

    def report(self, summary: Mapping[str, Any]) -> None:
        """Write ``report.html`` from the archive and ``summary``."""
        facts = {
            "task": self.settings.task,
            "search": self.settings.search.title,
            "status": str(summary.get("status", "unknown")),
            "time": duration(summary.get("elapsed_seconds", 0.0)),
            "seed": str(self.settings.seed),
            "version": __version__,
        }
        if summary.get("fresh_seeds"):
            facts["winner on fresh seeds"] = fresh_text(summary["fresh_seeds"])
        if self.settings.fitness.finalists:
            facts["fitness"] = self.settings.fitness.name
        write_text(self.folder / REPORT, report_page(self.archive, facts, self.folder))

    def film(self, settings: Any) -> None:
        """Write a short animation of each of the best designs beside its policy, unless there is one.

        Designs without a policy, or whose policy is gone or damaged, are left out. ``settings`` have the code that the
        user has named.
        """
        for one in self.archive.best(self.settings.top):
            policy = self.folder / str(one.policy_file)
            file = policy.with_name(FILM)
            if file.is_file() or not policy.is_file():
                continue
            with suppress(WarpvoxError):  # skip this design only
                # At most 300 control steps; every fifth is shown for 0.1 s
                rollout = record(*load_result(find_run(str(file.parent), ""), settings), 300)
                film = Film(rollout, 0, (320, 150), hud=False, voxels=13.0)
                first, *more = film.frames(range(0, rollout.num_frames, 5))
                with atomic_path(file) as temporary:
                    first.save(temporary, "WEBP", save_all=True, append_images=more, duration=100, loop=0, quality=40)


def evaluate_winner(results: Results, settings: Codesign) -> dict[str, Any]:
    """Evaluate the best design in episodes with an unused seed; return the mean return.

    Each design is judged by few episodes, always the same, and the best of many is chosen by them: that return is too
    good for what else the task, or the noise of ``protocol=noise``, may draw.

    Returns:
        ``mean``, ``low`` and ``high`` (95 % interval, Student's t), ``episodes``, ``seed``; empty if nothing is
        random, or no design has a policy.
    """
    if settings.protocol == NOMINAL and not get_task(settings.task).under(settings.rules).is_random:
        return {}
    if not any(best.policy_file for best in results.archive.best()):
        return {}
    seed = 1000 + (settings.seed == 1000)  # not the seed that the search compared its designs with
    device = settings.device if settings.executor == "local" else "cpu"
    how: dict[str, Any] = {"protocol": settings.protocol} | own_code(settings)
    play = Playing(FRESH, seed=seed, device=device, threads=settings.threads, **how)
    found = evaluate_run(find_run(str(results.folder), settings.output_dir), play)[0].interval
    return {"mean": found.mean, "low": found.low, "high": found.high, "episodes": FRESH, "seed": seed}


def fresh_text(facts: Mapping[str, Any]) -> str:
    """Format the winner's mean return over unused seeds, from the summary's ``fresh_seeds``."""
    return f"{fresh_interval(facts)} in {facts['episodes']} episodes"


def evaluated_text(summary: Mapping[str, Any]) -> str:
    """Format the number of evaluated designs, with finalists counted separately."""
    finalists = summary.get("finalists", 0)
    text = counted(summary["evaluations"] - finalists, "designs")
    return f"{text} and {counted(finalists, 'finalists')}" if finalists else text


@dataclass(frozen=True, repr=False)
class FoundDesign(Record):
    """A design of a finished search, with its policy.

    ``kept`` keeps a temporary folder of the search alive.
    """

    kept: Any = dataclasses.field(default=None, compare=False)

    @property
    def policy(self) -> Policy:
        """Policy of the design, on the CPU; see :func:`warpvox.load_policy`.

        Raises:
            RunError: none was kept.
        """
        from warpvox.algos.training.loading import load_policy

        return load_policy(self)


@dataclass(frozen=True)
class Found:
    """Result of a finished design search.

    Attributes:
        folder: archive, policies and report of the search, as ``warpvox play run=FOLDER`` takes it.
        settings: with names replaced by values.
        summary: content of ``summary.json``: ``status``, ``evaluations``, ``steps``, ``best_fitness``, ...
        kept: keeps a temporary folder alive; None: ``folder`` is not temporary.
    """

    folder: Path
    settings: Codesign
    summary: Mapping[str, Any]
    kept: Any = dataclasses.field(default=None, repr=False)

    @cached_property
    def designs(self) -> list[FoundDesign]:
        """Evaluated designs, best first: body, policy, fitness, learning curve, ancestors.

        Equal bodies come once, but for a finalist and the design that it comes from.
        """
        with Archive.read(self.folder / ARCHIVE) as archive:
            records = archive.best(max(1, archive.count()), with_parents=True)
        return [FoundDesign(**vars(record), kept=self.kept) for record in records]

    @property
    def best(self) -> FoundDesign:
        """Design with the best fitness."""
        return self.designs[0]

    @property
    def design(self) -> Design:
        """Body of the best design."""
        return self.best.design

    @property
    def policy_source(self) -> Path:
        """Folder of the search, which stands for the policy of its best design."""
        return self.folder

    @property
    def policy(self) -> Policy:
        """Policy of the best design, on the CPU; see :func:`warpvox.load_policy`."""
        return self.best.policy

    @property
    def curve(self) -> dict[str, np.ndarray]:
        """Progress of the search, ``[n]`` each: ``evaluations`` and ``steps`` (int64), ``best`` return (float64).

        The best return never falls, and ends at that of :attr:`best`. Finalists are evaluations, too; where the other
        designs were only compared by a common policy, the curve begins with the finalists, once there are some.
        """
        (member,) = read_members([self.folder])
        return {name: getattr(member, name) for name in ("evaluations", "steps", "best")}

    @property
    def report(self) -> Path:
        """Path of the page ``report.html``."""
        return self.folder / REPORT

    def __repr__(self) -> str:
        best = f"best {self.summary['best_fitness']:.3f}" if self.summary["best_fitness"] is not None else "no result"
        where = repr(str(self.folder)) if self.kept is None else "in a temporary folder"
        return f"Found({self.settings.task}, {evaluated_text(self.summary)}, {best}, {where})"

    def _repr_html_(self) -> str:
        """Show the best bodies with their returns, and the curve, as HTML for notebooks."""
        with Archive.read(self.folder / ARCHIVE) as archive:
            best = archive.best(5)
        cells = "".join(
            f"<td>{body_svg(record.candidate.body, 16)}<br>{record.fitness:.3f} #{record.id}</td>" for record in best
        )
        curve = self.curve
        points = list(zip(curve["evaluations"].tolist(), curve["best"].tolist(), strict=True))
        chart = picture(points, "designs", "best return", "step")
        return f"{escape(repr(self))}<table><tr>{cells}</tr></table>{chart}"
