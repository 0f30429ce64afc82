"""The co-design loop: the search proposes designs, the executor evaluates them, the archive stores results.

A search depends on its settings, its seed and the fitness it was told, and a training on the seed of its candidate. So
an experiment resumes from its archive alone: the search is replayed, and candidates without a result are evaluated.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from typing import Any, Protocol, cast

from warpvox.algos.archive import Archive, Finished, body_text, repair_hint
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
from warpvox.algos.codesign.stored_policies import StoredPolicies
from warpvox.algos.interrupt import Interrupt, deferred_interrupts
from warpvox.algos.listener import Listener
from warpvox.devices.startup import own_torch
from warpvox.errors import DivergenceError, RunError, SearchError


@dataclass
class Loop:
    """Runs a design search: asks for designs, evaluates them and stores the results, until it ends or is interrupted.

    Attributes:
        search: must not have been asked yet.
        archive: a new one or that of a search to resume; open for writing.
        policies: stores the policies; None: they are not kept.
        batch: number of designs evaluated together; None: all of a generation.
        reuse: copy the result of a body that was evaluated before instead of evaluating it again.
        inherit: give the evaluator the policies of the parents.
        generation: number of the current generation.
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
        """Run generations until the search has spent its budget.

        The first interrupt waits until the evaluation next reports; the batch under way is evaluated again, to the
        same bits, when the search goes on.

        Raises:
            KeyboardInterrupt: interrupted; all that was finished is in the archive.
            RunError: the archive is not one of this search or cannot be written, an evaluation has failed, or the
                learning of a whole generation has diverged (DivergenceError).
        """
        with deferred_interrupts() as interrupt:
            self._replay()

            while candidates := self.search.ask():
                # Store the proposals; a resumed search compares them with the stored ones.
                self._store_proposals(candidates)

                # Evaluate what has no result yet, and store each batch when it is finished.
                stored = self.archive.records(self.generation)
                finished = {record.id for record in stored if record.finished}
                originals = self._originals(candidates)
                work = self._unfinished_batches(candidates, originals, finished)
                waiting = [candidate for batch in work for candidate in batch.candidates]
                for listener in self.listeners:
                    listener.proposed(self.generation, waiting, len(candidates))
                began = time.perf_counter()
                for batch, outcomes in self._evaluate(work, interrupt):
                    now = time.perf_counter()
                    self._store(batch, outcomes, now - began)
                    began = now
                    if interrupt:
                        interrupt.raise_interrupt()

                # Copy the results of bodies that were evaluated before.
                copied = {number: original for number, original in originals.items() if number not in finished}
                self.archive.finish([self._copy(number, original) for number, original in copied.items()])
                self._rank_diverged()
                self._notify_finished(list(copied))

                # Tell
                fitness = [cast(float, record.fitness) for record in self.archive.records(self.generation)]
                self.search.tell(fitness)
                self.archive.back_up()
                for listener in self.listeners:
                    listener.told(self.generation, True)

                self.generation += 1
                if interrupt:
                    interrupt.raise_interrupt()

    def _replay(self) -> None:
        """Restore the search and ``generation`` from the finished generations in the archive."""
        history = []
        for row in self.archive.generations():
            if row["evaluated"] == row["designs"]:
                records = self.archive.records(row["generation"])
                fitness = [cast(float, record.fitness) for record in records]
                history.append(([record.candidate for record in records], fitness))
        if history:
            try:
                self.search.replay(history)
            except SearchError as error:
                raise SearchError(f"{error}{repair_hint(self.archive.path)}") from None
        for generation in range(len(history)):
            for listener in self.listeners:
                listener.told(generation, False)
        self.generation = len(history)

    def _store_proposals(self, candidates: Sequence[Candidate]) -> None:
        """Store new ``candidates``; RunError if a resumed search proposes others than before."""
        stored = self.archive.records(self.generation)
        if stored:
            proposed = [_reproducible_parts(candidate) for candidate in candidates]
            if proposed != [_reproducible_parts(record.candidate) for record in stored]:
                raise RunError(
                    f"The search now proposes other designs for generation {self.generation} than the archive holds: it"
                    " was made on another machine, by another version of warpvox or of the library that the search"
                    f" uses, or its rows were changed.{repair_hint(self.archive.path)}"
                )
            return
        for candidate in candidates:
            if candidate.generation != self.generation:
                right = self.generation
                raise RunError(f"Candidate {candidate.id} belongs to generation {right}, not {candidate.generation}.")
        self.archive.propose(candidates, self.seed)

    def _unfinished_batches(
        self, candidates: Sequence[Candidate], originals: Mapping[int, int], finished: Container[int]
    ) -> list[Batch]:
        """Return the batches with at least one candidate still to evaluate.

        All candidates are cut into batches before finished batches are dropped, so that a resumed generation trains the
        same designs together.
        """
        fresh = [candidate for candidate in candidates if candidate.id not in originals]
        unfinished = []
        for batch in batches(fresh, self.batch):
            if any(candidate.id not in finished for candidate in batch.candidates):
                unfinished.append(batch)
        return unfinished

    def _evaluate(self, work: Sequence[Batch], interrupt: Interrupt) -> Iterator[tuple[Batch, list[Outcome]]]:
        """Evaluate the batches in ``work``; yield each with its outcomes once finished."""

        def report(index: int, event: dict[str, Any]) -> None:
            for listener in self.listeners:
                listener.progress(work[index].candidates, event)
            if interrupt:
                interrupt.raise_interrupt()

        for index, outcomes in self.executor.run(work, self._parents(work), report):
            batch = work[index]
            yield batch, checked_outcomes(outcomes, len(batch.candidates))

    def _store(self, batch: Batch, outcomes: Sequence[Outcome], seconds: float) -> None:
        """Store a batch's outcomes and policies; ``seconds``: wall-clock time of its evaluation."""
        results = []
        for candidate, outcome in zip(batch.candidates, outcomes, strict=True):
            file = sha256 = None
            if self.policies is not None and outcome.policy is not None:
                # Write the policy first, so that the archive never names a missing file.
                file, sha256 = self.policies.save(candidate, outcome)
            results.append(Finished(candidate.id, outcome, file, sha256))
        self.archive.finish(results, seconds=seconds)
        self._notify_finished([result.id for result in results])

    def _notify_finished(self, numbers: Sequence[int]) -> None:
        """Pass the records of the candidates with these ids to all listeners."""
        records = [self.archive.record(number) for number in numbers]
        for listener in self.listeners:
            listener.finished(records)

    def _rank_diverged(self) -> None:
        """Give diverged candidates the worst fitness so far; DivergenceError if the whole generation diverged."""
        records = self.archive.records(self.generation)
        if all(record.diverged for record in records) and (len(records) > 1 or not self.archive.best()):
            raise DivergenceError(
                f"The learning of all {len(records)} designs of generation {self.generation} diverged before their"
                " first evaluation: its settings do not suit the task. Begin a new search with a lower"
                " training.ppo.learning_rate."
            )
        self.archive.rank_diverged(self.generation)

    def _originals(self, candidates: Sequence[Candidate]) -> dict[int, int]:
        """Map each candidate with an earlier proposed body to the id of the first candidate with this body."""
        if not self.reuse:
            return {}
        first_ids: dict[str, int] = {}
        for record in self.archive.records():
            if record.candidate.generation < self.generation:
                first_ids.setdefault(body_text(record.candidate.body), record.id)
        originals = {}
        for candidate in candidates:
            if candidate.origin == FINALIST:  # its body was evaluated in another way
                continue
            original = first_ids.setdefault(body_text(candidate.body), candidate.id)
            if original != candidate.id:
                originals[candidate.id] = original
        return originals

    def _copy(self, number: int, original: int) -> Finished:
        """Build a result for candidate ``number`` from ``original``, a candidate with the same body."""
        record = self.archive.record(original)
        # 0 steps, because none were simulated: all steps must sum to the cost of the experiment
        fitness = -math.inf if record.diverged else cast(float, record.fitness)
        outcome = Outcome(fitness, steps=0, stopped=bool(record.stopped))
        return Finished(number, outcome, record.policy_file, record.policy_sha256, reused=original)

    def _parents(self, work: Sequence[Batch]) -> Parents:
        """Load the parents of the candidates in ``work`` with their policies; empty without inheritance."""
        if not self.inherit or self.policies is None:
            return {}
        numbers = {number for batch in work for candidate in batch.candidates for number in candidate.parents}
        parents = {}
        for number in sorted(numbers):
            record = self.archive.record(number)
            # Earlier generations only: a resumed search would know more policies of its own than an uninterrupted one.
            if record.policy_file is not None and record.candidate.generation < self.generation:
                policy = self.policies.load(record.policy_file)
                parents[number] = Parent(record.candidate.body, policy, cast(float, record.fitness))
        return parents


def _reproducible_parts(candidate: Candidate) -> tuple[int, str, tuple[int, ...], str]:
    """Return the parts of a candidate that a resumed search must reproduce."""
    return candidate.id, body_text(candidate.body), tuple(candidate.parents), candidate.origin


Report = Callable[[int, dict[str, Any]], None]
"""Callback with the index of a batch and the progress of its evaluation."""


@dataclass(frozen=True)
class Batch:
    """Candidates that are evaluated together."""

    candidates: Sequence[Candidate]


class Executor(Protocol):
    """Protocol of executors: evaluate batches of candidates, with results independent of place and order."""

    def run(self, work: Sequence[Batch], parents: Parents, report: Report) -> Iterator[tuple[int, list[Outcome]]]:
        """Evaluate the batches in ``work``; yield each one's index and outcomes as they finish.

        Args:
            parents: as for :class:`warpvox.algos.candidate.DesignEvaluator`.
        """
        ...

    def close(self) -> None:
        """Stop the workers."""


class LocalExecutor(Executor):
    """Executor that evaluates batches one after another in this process.

    Args:
        alone: make other threads of this process that train or evaluate wait meanwhile.
    """

    def __init__(self, evaluator: DesignEvaluator, alone: bool = True) -> None:
        self.evaluator = evaluator
        self.alone = alone

    def run(self, work: Sequence[Batch], parents: Parents, report: Report) -> Iterator[tuple[int, list[Outcome]]]:
        for index, batch in enumerate(work):
            with own_torch() if self.alone else nullcontext():
                outcomes = self.evaluator.evaluate(batch.candidates, parents, partial(report, index))
            yield index, outcomes


def batches(candidates: Sequence[Candidate], size: int | None) -> list[Batch]:
    """Split ``candidates`` into batches of ``size`` that are trained together; None: a single batch.

    The cut depends on nothing but the candidates, so that a resumed experiment, or one on other machines, trains the
    same designs together.
    """
    size = size or len(candidates)
    return [Batch(candidates[start : start + size]) for start in range(0, len(candidates), size or 1)]
