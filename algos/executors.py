"""Where designs are evaluated: one batch after another in this process, or elsewhere (:mod:`warpvox.algos.on_ray`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol

from warpvox.algos.candidate import Candidate, DesignEvaluator, Outcome

__all__ = ["Executor", "LocalExecutor", "Report", "batches"]

Report = Callable[[dict[str, Any]], None]
"""Is told of progress by an evaluator."""


class Executor(Protocol):
    """Evaluates batches of candidates. The results must not depend on where and in what order that happens."""

    def run(
        self, work: Sequence[Sequence[Candidate]], parents: Mapping[int, dict[str, Any]], report: Report
    ) -> Iterator[tuple[int, list[Outcome]]]:
        """Yield the place of each batch in ``work`` with its outcomes, as they are done.

        ``parents`` and ``report`` as for :class:`warpvox.algos.candidate.DesignEvaluator`.
        """

    def close(self) -> None:
        """Let go of workers."""


class LocalExecutor:
    """Evaluates in this process, in order."""

    def __init__(self, evaluator: DesignEvaluator) -> None:
        self.evaluator = evaluator

    def run(
        self, work: Sequence[Sequence[Candidate]], parents: Mapping[int, dict[str, Any]], report: Report
    ) -> Iterator[tuple[int, list[Outcome]]]:
        """See :class:`Executor`."""
        for place, batch in enumerate(work):
            yield place, self.evaluator.evaluate(batch, parents, report)

    def close(self) -> None:
        """Nothing to let go of."""


def batches(candidates: Sequence[Candidate], size: int | None) -> list[Sequence[Candidate]]:
    """The candidates of a generation cut into batches that are trained together; None: one batch.

    The cut depends on nothing but the candidates, so that a resumed experiment, or one on other machines, trains the
    same designs together.
    """
    if not candidates:
        return []
    size = size or len(candidates)
    return [candidates[start : start + size] for start in range(0, len(candidates), size)]
