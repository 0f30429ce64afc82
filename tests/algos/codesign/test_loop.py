"""The loop: what is trained, what is reused, and that an interrupted experiment is the undisturbed one."""

import math
import os
import shutil
import signal
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from codesign_toys import GENERATIONS, POPULATION, SEED, ToyEvaluator, ToySearch, make_loop
from refusals import refused

from warpvox.algos.archive import BACKUP, FILE, Archive
from warpvox.algos.candidate import Candidate, Outcome, Parent
from warpvox.algos.codesign.loop import LocalExecutor, Loop
from warpvox.algos.listener import Listener
from warpvox.algos.report import report_page
from warpvox.algos.search import BO, GA, CppnNeat, MapElites, RandomDesigns, make_search
from warpvox.errors import DivergenceError, RunError, StorageError, WarpvoxError


def test_equal_bodies_are_trained_once(tmp_path: Path) -> None:
    loop = make_loop(tmp_path)
    loop.run()
    first: dict[str, int] = {}
    for record in loop.archive.records():
        text = str(record.candidate.body.tolist())
        original = first.setdefault(text, record.id)
        assert record.reused == (None if original == record.id else original)
        if record.reused is not None:
            other = loop.archive.record(original)
            assert (record.fitness, record.policy_file, record.steps) == (other.fitness, other.policy_file, 0)
    assert sorted(loop.executor.evaluator.trained) == sorted(first.values())
    assert loop.archive.trained() == len(first) < POPULATION * GENERATIONS


def test_equal_bodies_within_a_generation_are_trained_once(tmp_path: Path) -> None:
    class Twins(ToySearch):
        def ask(self) -> list[Candidate]:
            asked = super().ask()
            return [Candidate(item.id, asked[0].body, item.parents, item.origin, item.generation) for item in asked]

    loop = make_loop(tmp_path, search=Twins(generations=1))
    loop.run()
    assert [record.reused for record in loop.archive.records()] == [None] + [0] * (POPULATION - 1)
    other = make_loop(tmp_path / "all", search=Twins(generations=1), reuse=False)
    other.run()
    assert other.archive.trained() == POPULATION
    assert len({record.fitness for record in other.archive.records()}) == POPULATION


def test_children_start_from_the_policies_of_their_parents(tmp_path: Path) -> None:
    class Watching(ToyEvaluator):
        def evaluate(self, candidates: Sequence[Candidate], parents: Any, *more: Any) -> list[Outcome]:
            given.append({parent: parents[parent] for item in candidates for parent in item.parents})
            return super().evaluate(candidates, parents, *more)

    for inherit in (True, False):
        given: list[dict[int, Parent]] = []
        evaluator = Watching() if inherit else ToyEvaluator()
        loop = make_loop(tmp_path / str(inherit), inherit=inherit, executor=LocalExecutor(evaluator))
        loop.run()
        if inherit:
            store = loop.policies
            for parents in given:
                for number, parent in parents.items():
                    record = loop.archive.record(number)
                    assert parent.policy == store.load(record.policy_file)
                    assert parent.fitness == record.fitness
                    assert np.array_equal(parent.body, record.candidate.body)
            assert any(given)
    fitness = [_fitness(tmp_path / name / FILE) for name in ("True", "False")]
    assert fitness[0][:POPULATION] == fitness[1][:POPULATION]
    assert fitness[0] != fitness[1]


def _fitness(path: Path) -> list[float]:
    with Archive.read(path) as archive:
        return [record.fitness for record in archive.records()]


def test_the_batch_does_not_change_the_results(tmp_path: Path, undisturbed: str) -> None:
    loop = make_loop(tmp_path, batch=4)
    loop.run()
    assert loop.archive.digest() == undisturbed


class Interrupting(Listener):
    """Interrupts once more than so many designs are evaluated."""

    def __init__(self, stop: int, number: int = signal.SIGINT) -> None:
        self.stop, self.number = stop, number
        self.seen: list[int] = []

    def finished(self, records: Sequence[Any]) -> None:
        self.seen += [record.id for record in records]
        if len(self.seen) > self.stop:
            signal.raise_signal(self.number)


@pytest.mark.parametrize(
    ("stop", "number"), [(0, signal.SIGTERM), (POPULATION - 2, signal.SIGINT), (2 * POPULATION + 1, signal.SIGTERM)]
)
def test_an_interrupt_keeps_what_is_finished(tmp_path: Path, undisturbed: str, stop: int, number: int) -> None:
    listener = Interrupting(stop, number)
    loop = make_loop(tmp_path, listeners=[listener])
    with pytest.raises(KeyboardInterrupt):
        loop.run()
    done = [record.id for record in loop.archive.records() if record.fitness is not None]
    assert done == listener.seen
    loop.archive.close()
    again = make_loop(tmp_path)
    again.run()
    assert not set(again.executor.evaluator.trained) & set(done)
    assert again.archive.digest() == undisturbed


class Chained(ToySearch):
    """Each design descends from the one before it, of the same generation; numbers are numpy's."""

    def ask(self) -> list[Candidate]:
        for place, one in enumerate(super().ask()):
            numbers = np.arange(max(0, one.id - 1), one.id + 1)
            parents = tuple(numbers[:-1])
            self.asked[place] = Candidate(numbers[-1], one.body, parents, one.origin, np.int64(one.generation))
        return self.asked if self.generation < self.generations else []


def test_a_search_may_number_its_candidates_by_numpy(tmp_path: Path) -> None:
    loop = make_loop(tmp_path, search=Chained(generations=2))
    loop.run()
    records = loop.archive.records()
    assert [one.candidate.parents for one in records] == [(), *((number,) for number in range(2 * POPULATION - 1))]
    assert [one.candidate.generation for one in records] == [0] * POPULATION + [1] * POPULATION


def test_no_parent_of_the_same_generation_is_known_after_an_interrupt(tmp_path: Path) -> None:
    whole = make_loop(tmp_path / "whole", search=Chained(generations=2))
    whole.run()
    loop = make_loop(tmp_path / "stopped", search=Chained(generations=2), listeners=[Interrupting(POPULATION)])
    with pytest.raises(KeyboardInterrupt):
        loop.run()
    loop.archive.close()
    again = make_loop(tmp_path / "stopped", search=Chained(generations=2))
    again.run()
    assert again.archive.digest() == whole.archive.digest()


def test_another_search_is_refused_in_its_first_generation(tmp_path: Path) -> None:
    class Interrupting(Listener):
        def proposed(self, *words: Any) -> None:
            raise KeyboardInterrupt

    loop = make_loop(tmp_path, listeners=[Interrupting()])
    with pytest.raises(KeyboardInterrupt):
        loop.run()
    loop.archive.close()
    with refused(RunError, "other designs for generation 0"):
        make_loop(tmp_path, search=ToySearch(seed=SEED + 1)).run()


@pytest.mark.parametrize("gone", ["id >= 4 AND generation = 0", "id = 29"])
def test_where_rows_were_deleted_the_backup_is_named(tmp_path: Path, gone: str) -> None:
    def search() -> Any:
        return make_search(RandomDesigns(population=6, max_designs=30), (3, 3), SEED)

    loop = make_loop(tmp_path, search=search())
    loop.run()
    digest = loop.archive.digest()
    loop.archive.close()
    with closing(sqlite3.connect(tmp_path / FILE)) as db, db:
        for table, number in (("curves", "candidate"), ("parents", "child"), ("candidates", "id")):
            db.execute(f"DELETE FROM {table} WHERE {number} IN (SELECT id FROM candidates WHERE {gone})")
    damaged = make_loop(tmp_path, search=search())
    with refused(WarpvoxError, f"{BACKUP} beside it", f"copy it over {FILE}"):
        damaged.run()
    damaged.archive.close()
    shutil.copy(tmp_path / BACKUP, tmp_path / FILE)
    loop = make_loop(tmp_path, search=search())
    loop.run()
    assert loop.archive.digest() == digest


def test_wrong_answers_of_search_and_evaluator_are_refused(tmp_path: Path) -> None:
    class Short(ToyEvaluator):
        def evaluate(self, *words: Any) -> list[Outcome]:
            return super().evaluate(*words)[1:]

    class Astray(ToySearch):
        def ask(self) -> list[Candidate]:
            return [Candidate(item.id, item.body, generation=1) for item in super().ask()]

    for name, change in ("short", {"executor": LocalExecutor(Short())}), ("astray", {"search": Astray()}):
        with pytest.raises(RunError):
            make_loop(tmp_path / name, **change).run()


@pytest.mark.parametrize(
    "outcomes",
    [
        (Outcome(1.0) for _ in range(1)),
        None,
        [1.0],
        *([Outcome(fitness)] for fitness in ("1", None, math.nan, math.inf)),
        *([Outcome(1.0, steps=steps)] for steps in (10**30, -5, None)),
        *([Outcome(1.0, curve=curve)] for curve in (None, [(1, 2, 3)], [("a", 1.0)], [(1, math.nan)])),
        [Outcome(1.0, policy=[1])],
    ],
)
def test_outcomes_that_cannot_be_stored_are_refused(tmp_path: Path, outcomes: Any) -> None:
    class Wrong(ToyEvaluator):
        def evaluate(self, candidates: Sequence[Candidate], *_: Any) -> Any:
            assert len(candidates) == 1
            return outcomes

    with pytest.raises(RunError):
        make_loop(tmp_path, executor=LocalExecutor(Wrong())).run()


def test_numbers_of_numpy_and_torch_are_numbers(tmp_path: Path) -> None:
    class Numbers(ToyEvaluator):
        def evaluate(self, candidates: Sequence[Candidate], *_: Any) -> Any:
            curve = [(np.int64(3), torch.tensor(0.25))]
            return tuple(Outcome(np.float32(0.5), curve, np.int64(3), stopped=np.True_) for _ in candidates)

    loop = make_loop(tmp_path, executor=LocalExecutor(Numbers()))
    loop.run()
    found = loop.archive.records()[0]
    assert (found.fitness, found.curve, found.steps, found.stopped) == (0.5, [(3, 0.25)], 3, True)


def test_the_listener_hears_of_everything_once(tmp_path: Path) -> None:
    class Ear(Listener):
        def __init__(self) -> None:
            self.heard: list[tuple] = []

        def proposed(self, generation: int, waiting: Sequence[Candidate], total: int) -> None:
            self.heard.append(("proposed", generation, len(waiting), total))

        def progress(self, batch: Sequence[Candidate], event: dict) -> None:
            self.heard.append(("progress", event["id"]))

        def finished(self, records: Sequence[Any]) -> None:
            self.heard += [("finished", record.id) for record in records]

        def told(self, generation: int, fresh: bool) -> None:
            self.heard.append(("told", generation, fresh))

    ear = Ear()
    loop = make_loop(tmp_path, listeners=[ear])
    loop.run()
    everyone = list(range(POPULATION * GENERATIONS))
    assert sorted(item[1] for item in ear.heard if item[0] == "finished") == everyone
    assert [item[1] for item in ear.heard if item[0] == "progress"] == loop.executor.evaluator.trained
    assert [item for item in ear.heard if item[0] == "told"] == [("told", k, True) for k in range(GENERATIONS)]
    assert [item[1] for item in ear.heard if item[0] == "proposed"] == list(range(GENERATIONS))
    loop.archive.close()
    ear = Ear()
    make_loop(tmp_path, listeners=[ear]).run()
    assert ear.heard == [("told", k, False) for k in range(GENERATIONS)]


def test_a_full_disk_is_one_clear_error_and_nothing_is_lost(tmp_path: Path, undisturbed: str) -> None:
    loop = make_loop(tmp_path)
    page_size, pages = (
        loop.archive._db.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_size", "page_count")
    )
    assert page_size * pages == os.stat(tmp_path / FILE).st_size
    loop.archive._db.execute(f"PRAGMA max_page_count = {pages + 1}")
    with pytest.raises(StorageError):
        loop.run()
    loop.archive.close()
    again = make_loop(tmp_path)
    again.run()
    assert again.archive.digest() == undisturbed


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
            assert (record.stopped, record.curve, record.policy_file) == (True, [], None)
    assert [record.fitness for record in records] == [value for value, _ in loop.search.all]
    assert not any(record.diverged for record in loop.archive.best(len(records)))
    page = report_page(loop.archive, {}, tmp_path)
    assert page.count("<td>diverged</td>") == len(lost)
    assert "<dt>diverged</dt><dd>3</dd>" in page


def test_the_batch_does_not_matter(tmp_path: Path) -> None:
    one, other = (lossy(tmp_path / str(batch), [0, 3, 9], batch=batch) for batch in (2, None))
    one.run()
    other.run()
    assert one.archive.digest() == other.archive.digest()


def test_a_generation_of_nothing_else_ends_the_search_and_does_so_again(tmp_path: Path) -> None:
    for attempt in range(2):
        loop = lossy(tmp_path, range(POPULATION))
        with pytest.raises(DivergenceError):
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
        search = make_search(settings(population=4, max_designs=BUDGET), (3, 3), seed=1)
        Loop(search, LocalExecutor(Diverging([0, 2, 5, 6])), archive, seed=0, batch=1).run()
        records = archive.records()
        assert len(records) >= BUDGET
        assert sum(record.diverged for record in records) >= 4
        assert all(math.isfinite(record.fitness) for record in records)
        digests.append(archive.digest())
    assert digests[0] == digests[1]
