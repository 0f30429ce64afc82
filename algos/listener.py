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
        """Handle the start or resumption of a training or search, after all checks.

        ``run``: of a training a :class:`warpvox.algos.training.job.Job`, of a search a
        :class:`warpvox.algos.codesign.run.SearchRun`.
        """

    def ended(self, summary: Mapping[str, Any]) -> None:
        """Handle the end or failure of a training or search; ``summary``: the content of ``summary.json``.

        It is empty before the first iteration of a training, and if that of a search could not be written.
        """

    def iterated(self, row: Mapping[str, float]) -> None:
        """Handle the end of a training's iteration, given the new row of ``metrics.csv``."""

    def proposed(self, generation: int, waiting: Sequence[Candidate], total: int) -> None:
        """Handle the start of evaluating the candidates in ``waiting``, of ``total`` in the generation."""

    def progress(self, batch: Sequence[Candidate], event: dict[str, Any]) -> None:
        """Handle progress in evaluating ``batch``; see :data:`warpvox.algos.candidate.Report`."""

    def finished(self, records: Sequence[Record]) -> None:
        """Handle the end of evaluating the candidates of ``records``, which are stored by now."""

    def told(self, generation: int, fresh: bool) -> None:
        """Handle the end of a generation, after the search learned from it; ``fresh``: False for stored generations."""
