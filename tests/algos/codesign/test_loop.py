"""The loop: what is trained, what is reused, and that an interrupted experiment is the undisturbed one."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from codesign_toys import GENERATIONS, POPULATION, SEED, ToyEvaluator, ToySearch, make_loop

from warpvox.algos.candidate import Candidate, Listener, Outcome, Parent
from warpvox.algos.codesign.archive import FILE, Archive
from warpvox.algos.codesign.loop import LocalExecutor, batches
from warpvox.errors import RunError, StorageError

PROGRAM = Path(__file__).parents[2] / "helpers" / "codesign_toys.py"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The digest of the whole experiment."""
    loop = make_loop(tmp_path_factory.mktemp("whole"))
    loop.run()
    return loop.archive.digest()


def _digest(path: Path) -> str:
    with Archive.read(path) as archive:
        return archive.digest()


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
            assert (record.fitness, record.policy, record.steps) == (other.fitness, other.policy, 0)
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
                    assert parent.policy == store.load(record.policy)
                    assert parent.fitness == record.fitness
                    assert np.array_equal(parent.body, record.candidate.body)
            assert any(given)
    fitness = [_fitness(tmp_path / name / FILE) for name in ("True", "False")]
    assert fitness[0][:POPULATION] == fitness[1][:POPULATION]
    assert fitness[0] != fitness[1]


def _fitness(path: Path) -> list[float]:
    with Archive.read(path) as archive:
        return [record.fitness for record in archive.records()]


@pytest.mark.parametrize("size", [1, 2, 4, 6, 9, None])
def test_batches_cut_a_generation_in_order(size: int | None) -> None:
    items = [Candidate(k, np.ones((1, 1))) for k in range(6)]
    cut = batches(items, size)
    assert [item.id for batch in cut for item in batch.candidates] == list(range(6))
    assert all(len(batch.candidates) == min(size or 6, 6) for batch in cut[:-1])
    assert batches([], size) == []


def test_the_batch_does_not_change_the_results(tmp_path: Path, undisturbed: str) -> None:
    loop = make_loop(tmp_path, batch=4)
    loop.run()
    assert loop.archive.digest() == undisturbed


@pytest.mark.parametrize(
    ("stop", "number"), [(0, signal.SIGTERM), (POPULATION - 2, signal.SIGINT), (2 * POPULATION + 1, signal.SIGTERM)]
)
def test_an_interrupt_keeps_what_is_finished(tmp_path: Path, undisturbed: str, stop: int, number: int) -> None:
    class Interrupting(Listener):
        def __init__(self) -> None:
            self.seen: list[int] = []

        def finished(self, records: Sequence[Any]) -> None:
            self.seen += [record.id for record in records]
            if len(self.seen) > stop:
                signal.raise_signal(number)

    listener = Interrupting()
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


@pytest.mark.slow  # tests/faults kills a search of real trainings in the default run
@pytest.mark.parametrize("batch", [1, 0])
def test_killed_three_times_it_is_the_undisturbed_experiment(tmp_path: Path, undisturbed: str, batch: int) -> None:
    pause = 0.03
    whole = pause * POPULATION * GENERATIONS
    rng = random.Random(batch)
    kills = 0
    while kills < 3:
        process = subprocess.Popen([sys.executable, PROGRAM, tmp_path, str(pause), str(batch)], stdout=subprocess.PIPE)
        assert process.stdout.readline() == b"begun\n"
        time.sleep(rng.uniform(0.1, 0.35) * whole)
        if process.poll() is not None:
            break  # a machine that stalls may be late for the last one
        process.kill()
        process.communicate()
        kills += 1
        with Archive.read(tmp_path / FILE) as archive:
            for record in archive.records():
                if record.policy is not None:
                    assert (tmp_path / record.policy).is_file()
    assert kills
    subprocess.run([sys.executable, PROGRAM, tmp_path, "0", str(batch)], check=True, stdout=subprocess.DEVNULL)
    assert _digest(tmp_path / FILE) == undisturbed
    assert list((tmp_path / "training").iterdir()) == []


def test_an_experiment_that_is_done_stays_as_it_is(tmp_path: Path, undisturbed: str) -> None:
    for _ in range(2):
        loop = make_loop(tmp_path)
        loop.run()
        loop.archive.close()
    assert loop.executor.evaluator.trained == []
    assert _digest(tmp_path / FILE) == undisturbed


def test_another_search_is_refused_in_its_first_generation(tmp_path: Path) -> None:
    class Interrupting(Listener):
        def proposed(self, *words: Any) -> None:
            raise KeyboardInterrupt

    loop = make_loop(tmp_path, listeners=[Interrupting()])
    with pytest.raises(KeyboardInterrupt):
        loop.run()
    loop.archive.close()
    with pytest.raises(RunError, match="other designs for generation 0"):
        make_loop(tmp_path, search=ToySearch(seed=SEED + 1)).run()


def test_wrong_answers_of_search_and_evaluator_are_refused(tmp_path: Path) -> None:
    class Short(ToyEvaluator):
        def evaluate(self, *words: Any) -> list[Outcome]:
            return super().evaluate(*words)[1:]

    class Astray(ToySearch):
        def ask(self) -> list[Candidate]:
            return [Candidate(item.id, item.body, generation=1) for item in super().ask()]

    for name, phrase, change in (
        ("short", "0 outcomes for 1", {"executor": LocalExecutor(Short())}),
        ("astray", "belongs to generation 0", {"search": Astray()}),
    ):
        with pytest.raises(RunError, match=phrase):
            make_loop(tmp_path / name, **change).run()


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
    with pytest.raises(StorageError, match="cannot be written: database or disk is full"):
        loop.run()
    loop.archive.close()
    again = make_loop(tmp_path)
    again.run()
    assert again.archive.digest() == undisturbed
