"""The co-design loop: a search proposes designs, an executor evaluates them, the archive stores the results.

A search depends on its settings, its seed and the fitness it was told, and a training on the seed of its candidate. So
an experiment resumes from its archive alone: the search is replayed, and candidates without a result are evaluated.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from typing import Any, Protocol, cast

from warpvox.algos.archive import Archive, Finished, Record, body_text, repair_hint
from warpvox.algos.candidate import (
    FINALIST,
    Candidate,
    DesignEvaluator,
    Outcome,
    Parent,
    Parents,
    Search,
    checked_outcomes,
)
from warpvox.algos.codesign.listener import Listener
from warpvox.algos.codesign.stored_policies import StoredPolicies
from warpvox.algos.interrupt import Interrupt, deferred_interrupts
from warpvox.devices.startup import own_torch
from warpvox.errors import DivergenceError, RunError, SearchError


@dataclass
class Loop:
    """Runs a search to its end, or until it is interrupted.

    Attributes:
        search: must not have been asked yet.
        archive: new or of an experiment to go on with; open for writing.
        policies: where policies go; None: they are not kept.
        batch: designs trained together; None: all of a generation.
        reuse: a body that was evaluated before is not trained again.
        inherit: a training may start from the policies of the parents.
    """

    search: Search
    executor: Executor
    archive: Archive
    _: KW_ONLY
    seed: int
    policies: StoredPolicies | None = None
    batch: int | None = None
    reuse: bool = True
    inherit: bool = False
    listeners: Sequence[Listener] = ()
    generation: int = field(default=0, init=False)

    def run(self) -> None:
        """Go on until the search has spent its evaluations.

        The first interrupt waits until the evaluation next reports; the batch under way is evaluated again, to the
        same bits, when the search goes on.

        Raises:
            KeyboardInterrupt: interrupted; all that was finished is in the archive.
            RunError: the archive is not one of this search or cannot be written, an evaluation has failed, or the
                learning of a whole generation has diverged (DivergenceError).
        """
        with deferred_interrupts() as interrupt:
            self._replay()
            while asked := self.search.ask():
                known = self.archive.records(self.generation)
                if known:
                    self._check_same(asked, known)
                else:
                    for one in asked:
                        if one.generation != self.generation:
                            right = self.generation
                            raise RunError(f"Candidate {one.id} belongs to generation {right}, not {one.generation}.")
                    self.archive.propose(asked, self.seed)
                self._evaluate(asked, interrupt)
                self.search.tell([cast(float, record.fitness) for record in self.archive.records(self.generation)])
                self.archive.back_up()
                self._tell("told", self.generation, True)
                self.generation += 1
                if interrupt:
                    interrupt.stop()

    def _tell(self, what: str, *news: Any) -> None:
        for listener in self.listeners:
            getattr(listener, what)(*news)

    def _replay(self) -> None:
        """Restore the state of the search from the archive."""
        whole = [row["generation"] for row in self.archive.generations() if row["evaluated"] == row["designs"]]
        known = [self.archive.records(generation) for generation in whole]
        history = [
            ([one.candidate for one in records], [cast(float, one.fitness) for one in records]) for records in known
        ]
        if history:
            try:
                self.search.replay(history)
            except SearchError as error:
                raise SearchError(f"{error}{repair_hint(self.archive.path)}") from None
        for self.generation in range(len(history)):
            self._tell("told", self.generation, False)
        self.generation = len(history)

    def _check_same(self, asked: Sequence[Candidate], known: Sequence[Record]) -> None:
        """Raise RunError unless the search repeats its earlier proposals."""
        several = asked, [record.candidate for record in known]
        now, before = ([(c.id, body_text(c.body), tuple(c.parents), c.origin) for c in each] for each in several)
        if now != before:
            raise RunError(
                f"The search now proposes other designs for generation {self.generation} than the archive holds: it was"
                " made on another machine, by another version of warpvox or of the library that the search uses, or its"
                f" rows were changed.{repair_hint(self.archive.path)}"
            )

    def _evaluate(self, asked: Sequence[Candidate], interrupt: Interrupt) -> None:
        done = {record.id for record in self.archive.records(self.generation) if record.finished}
        originals = self._originals(asked)
        # batches are cut before what is done is left out: a resumed generation trains the same designs together
        work = batches([item for item in asked if item.id not in originals], self.batch)
        work = [batch for batch in work if any(item.id not in done for item in batch.candidates)]
        self._tell("proposed", self.generation, [item for batch in work for item in batch.candidates], len(asked))
        self._train(work, interrupt)
        copies = [self._copy(number, original) for number, original in originals.items() if number not in done]
        self.archive.finish(copies)
        self._rank_diverged()
        self._tell("finished", [self.archive.record(copy.id) for copy in copies])

    def _rank_diverged(self) -> None:
        """Rank diverged candidates below all others. DivergenceError: the whole generation diverged."""
        records = self.archive.records(self.generation)
        if all(record.diverged for record in records) and (len(records) > 1 or not self.archive.best()):
            raise DivergenceError(
                f"The learning of all {len(records)} designs of generation {self.generation} diverged before their"
                " first evaluation: its settings do not suit the task. Begin a new search with a lower"
                " training.ppo.learning_rate."
            )
        self.archive.rank_diverged(self.generation)

    def _originals(self, asked: Sequence[Candidate]) -> dict[int, int]:
        """The candidates whose body was proposed before, with the id of the first that had it."""
        if not self.reuse:
            return {}
        first: dict[str, int] = {}
        for record in self.archive.records():
            if record.candidate.generation < self.generation:
                first.setdefault(body_text(record.candidate.body), record.id)
        originals = {}
        for candidate in asked:
            if candidate.origin == FINALIST:  # its body was evaluated in another way
                continue
            original = first.setdefault(body_text(candidate.body), candidate.id)
            if original != candidate.id:
                originals[candidate.id] = original
        return originals

    def _copy(self, number: int, original: int) -> Finished:
        record = self.archive.record(original)
        # nothing was spent: the sum of all steps is what the experiment has cost
        fitness = -math.inf if record.diverged else cast(float, record.fitness)
        outcome = Outcome(fitness, steps=0, stopped=bool(record.stopped))
        return Finished(number, outcome, record.policy, record.policy_sha256, reused=original)

    def _train(self, work: Sequence[Batch], interrupt: Interrupt) -> None:
        def report(place: int, event: dict[str, Any]) -> None:
            self._tell("progress", work[place].candidates, event)
            if interrupt:
                interrupt.stop()

        began = time.perf_counter()
        for place, outcomes in self.executor.run(work, self._parents(work), report):
            batch = work[place]
            outcomes = checked_outcomes(outcomes, len(batch.candidates))
            results = []
            for one, outcome in zip(batch.candidates, outcomes, strict=True):
                file = sha256 = None
                if self.policies is not None and outcome.policy is not None:
                    # the policy first: the archive never names a missing file
                    file, sha256 = self.policies.save(one, outcome)
                results.append(Finished(one.id, outcome, file, sha256))
            now = time.perf_counter()
            self.archive.finish(results, seconds=now - began)
            began = now
            self._tell("finished", [self.archive.record(result.id) for result in results])
            if interrupt:
                interrupt.stop()

    def _parents(self, work: Sequence[Batch]) -> Parents:
        if not self.inherit or self.policies is None:
            return {}
        wanted = sorted({parent for batch in work for item in batch.candidates for parent in item.parents})
        return {
            record.id: Parent(record.candidate.body, self.policies.load(record.policy), cast(float, record.fitness))
            for record in map(self.archive.record, wanted)
            # of its own generation a search that is resumed would know more policies than one that was not interrupted
            if record.policy is not None and record.candidate.generation < self.generation
        }


Report = Callable[[int, dict[str, Any]], None]
"""Called with the index of a batch and the progress of its evaluation."""


@dataclass(frozen=True)
class Batch:
    """Candidates that are evaluated together."""

    candidates: Sequence[Candidate]


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


class LocalExecutor(Executor):
    """Evaluates in this process, in order.

    Args:
        alone: whether other threads that train or evaluate wait meanwhile.
    """

    def __init__(self, evaluator: DesignEvaluator, alone: bool = True) -> None:
        self.evaluator, self.alone = evaluator, alone

    def run(self, work: Sequence[Batch], parents: Parents, report: Report) -> Iterator[tuple[int, list[Outcome]]]:
        for place, batch in enumerate(work):
            with own_torch() if self.alone else nullcontext():
                outcomes = self.evaluator.evaluate(batch.candidates, parents, partial(report, place))
            yield place, outcomes


def batches(candidates: Sequence[Candidate], size: int | None) -> list[Batch]:
    """The candidates of a generation cut into batches that are trained together; None: one batch.

    The cut depends on nothing but the candidates, so that a resumed experiment, or one on other machines, trains the
    same designs together.
    """
    size = size or len(candidates)
    return [Batch(candidates[start : start + size]) for start in range(0, len(candidates), size or 1)]
