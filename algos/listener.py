"""Callbacks of trainings and design searches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from warpvox.algos.archive import Record
from warpvox.algos.candidate import Candidate


class Listener:
    """Base class of callbacks of a training or design search; its methods do nothing."""

    def preparing(self, what: str) -> AbstractContextManager[object]:
        """Return a context that is entered while ``what`` is done before a training begins."""
        return nullcontext()

    def begun(self, run: Any) -> None:
        """Called when the training or search begins or resumes; everything has been checked.

        ``run``: of a training a :class:`warpvox.algos.training.job.Job`, of a search a
        :class:`warpvox.algos.codesign.run.SearchRun`.
        """

    def ended(self, summary: Mapping[str, Any]) -> None:
        """Called when the training or search has ended or failed; ``summary`` is the content of ``summary.json``.

        It is empty before the first iteration of a training, and if that of a search could not be written.
        """

    def iterated(self, row: Mapping[str, float]) -> None:
        """Called after each iteration of a training, with its row of ``metrics.csv``."""

    def proposed(self, generation: int, waiting: Sequence[Candidate], total: int) -> None:
        """Called when the candidates in ``waiting``, of ``total`` in the generation, are about to be evaluated."""

    def progress(self, batch: Sequence[Candidate], event: dict[str, Any]) -> None:
        """Called with an evaluator's progress on ``batch``; see :data:`warpvox.algos.candidate.Report`."""

    def finished(self, records: Sequence[Record]) -> None:
        """Called when the candidates of ``records`` have been evaluated and stored."""

    def told(self, generation: int, fresh: bool) -> None:
        """Called when a search has learned from a generation; not ``fresh``: it was complete before this run."""
