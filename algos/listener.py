"""Callbacks of trainings and design searches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from warpvox.algos.archive import Record
from warpvox.algos.candidate import Candidate


class Listener:
    """Base class of callbacks for a training or design search; all methods do nothing."""

    def preparing(self, what: str) -> AbstractContextManager[object]:
        """Return a context manager, entered while ``what`` (a message) is prepared before training."""
        return nullcontext()

    def begun(self, run: Any) -> None:
        """Called when a training or search begins or resumes, after all checks.

        ``run``: of a training a :class:`warpvox.algos.training.job.Job`, of a search a
        :class:`warpvox.algos.codesign.run.SearchRun`.
        """

    def ended(self, summary: Mapping[str, Any]) -> None:
        """Called when a training or search has ended or failed; ``summary``: the content of ``summary.json``.

        It is empty before the first iteration of a training, and if that of a search could not be written.
        """

    def iterated(self, row: Mapping[str, float]) -> None:
        """Called after each iteration of a training with the new row of ``metrics.csv``."""

    def proposed(self, generation: int, waiting: Sequence[Candidate], total: int) -> None:
        """Called before the candidates in ``waiting``, of ``total`` in the generation, are evaluated."""

    def progress(self, batch: Sequence[Candidate], event: dict[str, Any]) -> None:
        """Called with the progress of evaluating ``batch``; see :data:`warpvox.algos.candidate.Report`."""

    def finished(self, records: Sequence[Record]) -> None:
        """Called after the candidates of ``records`` were evaluated and stored."""

    def told(self, generation: int, fresh: bool) -> None:
        """Called after a search has learned from a generation; ``fresh`` is False for stored generations."""
