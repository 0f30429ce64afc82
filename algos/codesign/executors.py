"""Where designs are evaluated: batch after batch in this process, or on Ray (:mod:`.ray_executor`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from warpvox.algos.candidate import Candidate, DesignEvaluator, Outcome, Parents

Report = Callable[[int, dict[str, Any]], None]
"""Called with the index of a batch and the progress of its evaluation."""


@dataclass(frozen=True)
class Batch:
    """Candidates that are trained together, and the checkpoint file of their training."""

    candidates: Sequence[Candidate]
    checkpoint: Path | None = None


class Executor(Protocol):
    """Evaluates batches of candidates. The results must not depend on where and in what order."""

    def run(self, work: Sequence[Batch], parents: Parents, report: Report) -> Iterator[tuple[int, list[Outcome]]]:
        """Yield the index of each batch in ``work`` with its outcomes, as they finish.

        Args:
            parents: as for :class:`warpvox.algos.candidate.DesignEvaluator`.
        """
        ...

    def close(self) -> None:
        """Release the workers."""


class LocalExecutor:
    """Evaluates in this process, in order."""

    def __init__(self, evaluator: DesignEvaluator) -> None:
        self.evaluator = evaluator

    def run(self, work: Sequence[Batch], parents: Parents, report: Report) -> Iterator[tuple[int, list[Outcome]]]:
        for place, batch in enumerate(work):

            def tell(event: dict[str, Any], place: int = place) -> None:
                report(place, event)

            yield place, self.evaluator.evaluate(batch.candidates, parents, tell, batch.checkpoint)

    def close(self) -> None:
        """Nothing to release."""


def batches(candidates: Sequence[Candidate], size: int | None, folder: Path | None = None) -> list[Batch]:
    """The candidates of a generation cut into batches that are trained together; None: one batch.

    The cut depends on nothing but the candidates, so that a resumed experiment, or one on other machines, trains the
    same designs together.
    """
    size = size or len(candidates)
    cut = [candidates[start : start + size] for start in range(0, len(candidates), size or 1)]
    return [Batch(part, folder / f"training_{part[0].id}.pt" if folder else None) for part in cut]
