"""Final stage of a search without training: the best designs are trained."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from warpvox.algos.candidate import FINALIST, Candidate, DesignEvaluator, Outcome, Parents, Report, Search, best_so_far


class Finalists:
    """Search that wraps another one and proposes its best designs again as a last generation.

    These finalists are new candidates with the same body as their parent and the origin :data:`FINALIST`. The inner
    search is not told their fitness.

    Args:
        search: the inner search; must not have been asked yet.
        count: number of finalists, of different bodies; there are fewer if the search has found no more.
    """

    def __init__(self, search: Search, count: int) -> None:
        self.search = search
        self.count = count
        self._known: list[tuple[Candidate, float]] = []
        self._asked: list[Candidate] = []

    def ask(self) -> list[Candidate]:
        """Return the inner search's next generation, then the finalists once, then an empty list."""
        if self._asked and self._asked[0].origin == FINALIST:
            return []
        self._asked = self.search.ask() or self._finalists()
        return self._asked

    def _finalists(self) -> list[Candidate]:
        """Create candidates for the last generation from the best distinct bodies."""
        best: dict[bytes, Candidate] = {}
        for candidate, _ in sorted(self._known, key=lambda pair: (-pair[1], pair[0].id)):
            best.setdefault(candidate.body.tobytes(), candidate)
        generation = max((candidate.generation for candidate, _ in self._known), default=-1) + 1
        finalists = []
        for number, parent in enumerate(list(best.values())[: self.count], start=len(self._known)):
            finalists.append(Candidate(number, parent.body, (parent.id,), FINALIST, generation))
        return finalists

    def tell(self, fitness: Sequence[float]) -> None:
        """Pass fitness to the inner search, except that of the finalists."""
        if self._asked[0].origin != FINALIST:
            self.search.tell(fitness)
            self._known += zip(self._asked, fitness, strict=True)

    def replay(self, history: Sequence[tuple[Sequence[Candidate], Sequence[float]]]) -> None:
        """Restore the state after ``history``; the inner search replays all but the finalists."""
        searched = [pair for pair in history if pair[0][0].origin != FINALIST]
        self.search.replay(searched)
        self._known = [pair for generation in searched for pair in zip(*generation, strict=True)]
        self._asked = list(history[-1][0])


@dataclasses.dataclass(frozen=True)
class TwoStages:
    """Evaluator by gaits that gives finalists more gaits and a training each.

    A finalist gets the better of both results. Gaits start from those of the parents, trainings with new networks.
    """

    gaits: DesignEvaluator
    final_gaits: DesignEvaluator
    training: DesignEvaluator

    def evaluate(self, candidates: Sequence[Candidate], parents: Parents, report: Report = None) -> list[Outcome]:
        """Evaluate ``candidates``, either all finalists or none, and return their outcomes."""
        if candidates[0].origin != FINALIST:
            return self.gaits.evaluate(candidates, parents, report)

        # Gaits, then a training
        moved = self.final_gaits.evaluate(candidates, parents, report)
        spent = sum(outcome.steps for outcome in moved)

        def report_training(event: dict[str, Any]) -> None:
            if report is not None:
                report(event | {"steps": spent + event["steps"]})

        trained = self.training.evaluate(candidates, {}, report_training)

        # The better outcome, with the control steps of both; its curve is the best return so far of either.
        outcomes = []
        for first, second in zip(moved, trained, strict=True):
            best = first if first.fitness >= second.fitness else second
            later = [(first.steps + steps, value) for steps, value in second.curve]
            curve = best_so_far([*first.curve, *later])
            outcomes.append(dataclasses.replace(best, curve=curve, steps=first.steps + second.steps))
        return outcomes
