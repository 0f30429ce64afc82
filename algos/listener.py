"""Callbacks of trainings and design searches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from warpvox.algos.archive import Record
from warpvox.algos.candidate import Candidate


class Listener:
    """Callbacks of a training or a design search; the methods of this class do nothing."""

    def preparing(self, what: str) -> AbstractContextManager[object]:
        """Enter the block in which ``what`` is done before a training begins."""
        return nullcontext()

    def begun(self, run: Any) -> None:
        """It begins, or goes on; everything has been checked and made.

        ``run``: of a training a :class:`warpvox.algos.training.job.Job`, of a search a
        :class:`warpvox.algos.codesign.run.SearchRun`.
        """

    def ended(self, summary: Mapping[str, Any]) -> None:
        """It has ended, one way or another; ``summary`` is what ``summary.json`` says.

        It is empty before the first iteration of a training, and if that of a search could not be written.
        """

    def iterated(self, row: Mapping[str, float]) -> None:
        """An iteration of a training is complete; ``row``: of ``metrics.csv``."""

    def proposed(self, generation: int, waiting: Sequence[Candidate], total: int) -> None:
        """``waiting`` of the ``total`` candidates of a search's generation will be evaluated."""

    def progress(self, batch: Sequence[Candidate], event: dict[str, Any]) -> None:
        """Take what an evaluator reports of these candidates; see :data:`warpvox.algos.candidate.Report`."""

    def finished(self, records: Sequence[Record]) -> None:
        """These candidates are evaluated and stored."""

    def told(self, generation: int, fresh: bool) -> None:
        """The search has learned from a generation; not ``fresh``: it had been complete before this run."""
