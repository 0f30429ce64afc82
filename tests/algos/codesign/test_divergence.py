"""Designs whose learning diverges: the search goes on, they rank last, and nothing of it depends on the order."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from codesign_toys import GENERATIONS, POPULATION, ToyEvaluator, make_loop

from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.codesign.archive import Archive, Finished
from warpvox.algos.codesign.loop import LocalExecutor, Loop
from warpvox.algos.report import report_page
from warpvox.algos.search import BO, GA, CppnNeat, MapElites, RandomDesigns, make_search
from warpvox.design import sample_design
from warpvox.errors import DivergenceError, RunError

BUDGET = 8


class Diverging(ToyEvaluator):
    """The toys' evaluator; of some candidates nothing comes."""

    def __init__(self, lost: Sequence[int]) -> None:
        super().__init__()
        self.lost = set(lost)

    def evaluate(self, candidates: Sequence[Candidate], *more: Any) -> list[Outcome]:
        outcomes = super().evaluate(candidates, *more)
        return [
            Outcome(-math.inf, steps=16, stopped=True) if candidate.id in self.lost else outcome
            for candidate, outcome in zip(candidates, outcomes, strict=True)
        ]


def lossy(folder: Path, lost: Sequence[int], **changes: Any) -> Loop:
    return make_loop(folder, executor=LocalExecutor(Diverging(lost)), **changes)


def test_they_are_written_down_with_the_worst_fitness_so_far(tmp_path: Path) -> None:
    lost = {1, POPULATION, POPULATION + 1}
    loop = lossy(tmp_path, lost)
    loop.run()
    records = loop.archive.records()
    assert len(records) == POPULATION * GENERATIONS
    assert {record.id for record in records if record.diverged and record.reused is None} == lost
    for record in records:
        until = [other.fitness for other in records if other.candidate.generation <= record.candidate.generation]
        assert math.isfinite(record.fitness)
        if record.diverged:
            assert record.fitness == min(until)
            assert (record.stopped, record.curve, record.policy) == (True, [], None)
    assert [record.fitness for record in records] == [value for value, _ in loop.search.all]
    assert not any(record.diverged for record in loop.archive.best(len(records)))
    page = report_page(loop.archive, {}, tmp_path)
    assert page.count("<td>diverged</td>") == len(lost)
    assert "<dt>diverged</dt><dd>3</dd>" in page


@pytest.mark.parametrize("batch", [1, 4, None])
def test_the_batch_does_not_matter(tmp_path: Path, batch: int | None) -> None:
    one, other = lossy(tmp_path / "one", [0, 3, 9], batch=2), lossy(tmp_path / "other", [0, 3, 9], batch=batch)
    one.run()
    other.run()
    assert one.archive.digest() == other.archive.digest()


def test_a_generation_of_nothing_else_ends_the_search_and_does_so_again(tmp_path: Path) -> None:
    for attempt in range(2):
        loop = lossy(tmp_path, range(POPULATION))
        with pytest.raises(
            DivergenceError, match=r"all \d designs of generation 0 .*lower training\.ppo\.learning_rate"
        ):
            loop.run()
        assert bool(loop.executor.evaluator.trained) == (attempt == 0)
        loop.archive.close()


@pytest.mark.parametrize("settings", [GA, RandomDesigns, BO, CppnNeat, MapElites])
def test_every_search_goes_on(tmp_path: Path, settings: type) -> None:
    """Whatever was told of them, the searches propose new valid bodies, and find the same again."""
    if settings is MapElites:
        pytest.importorskip("ribs", reason="pyribs is not installed")
    digests = []
    for attempt in ("one", "other"):
        (tmp_path / attempt).mkdir()
        archive = Archive.create(tmp_path / attempt / "a.sqlite", {})
        search = make_search(settings(population=4, max_evaluations=BUDGET), (3, 3), seed=1)
        Loop(search, LocalExecutor(Diverging([0, 2, 5, 6])), archive, seed=0, batch=1).run()
        records = archive.records()
        assert len(records) >= BUDGET
        assert sum(record.diverged for record in records) >= 4
        assert all(math.isfinite(record.fitness) for record in records)
        digests.append(archive.digest())
    assert digests[0] == digests[1]


def test_there_must_be_something_to_compare_with(tmp_path: Path) -> None:
    with Archive.create(tmp_path / "a.sqlite", {}) as archive:
        archive.propose([Candidate(0, sample_design((3, 3), 0))], 0)
        archive.finish([Finished(0, Outcome(-math.inf, steps=5, stopped=True))])
        with pytest.raises(RunError, match="No design has a fitness yet"):
            archive.rank_diverged(0)
        record = archive.record(0)
        assert (record.fitness, record.diverged, record.finished) == (None, True, True)
        with pytest.raises(RunError, match="waits for its evaluation"):
            archive.finish([Finished(0, Outcome(1.0))])
