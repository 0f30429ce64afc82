"""Callbacks of a design search, and its state as they see it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpvox.algos.archive import Archive, Record
from warpvox.algos.candidate import Candidate
from warpvox.algos.codesign.settings import Codesign


@dataclass(frozen=True)
class SearchRun:
    """A design search that is under way.

    Attributes:
        folder: of the run.
        archive: designs and results so far.
        settings: with what their names stand for.
        total: evaluations that it may spend, those of finalists included, which come last.
        costs: about how many control steps a design takes, and a finalist; None: not known.
        workers: of Ray; 0: this process.
    """

    folder: Path
    archive: Archive
    settings: Codesign
    total: int
    finalists: int
    costs: tuple[float, float] | None
    workers: int
    resumed: bool


class Listener:
    """Callbacks of a search; the methods of this class do nothing."""

    def begun(self, run: SearchRun) -> None:
        """The search begins, or goes on."""

    def ended(self, summary: Mapping[str, Any]) -> None:
        """The search has ended; ``summary`` is what ``summary.json`` says, empty if it could not be written."""

    def proposed(self, generation: int, waiting: Sequence[Candidate], total: int) -> None:
        """``waiting`` of the ``total`` candidates of a generation will be trained."""

    def progress(self, batch: Sequence[Candidate], event: dict[str, Any]) -> None:
        """Take what an evaluator reports of these candidates; see :data:`warpvox.algos.candidate.Report`."""

    def finished(self, records: Sequence[Record]) -> None:
        """These candidates are evaluated and stored."""

    def told(self, generation: int, fresh: bool) -> None:
        """The search has learned from a generation; not ``fresh``: it had been complete before this run."""
