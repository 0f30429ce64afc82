"""The last generation of a search: its best designs, evaluated once more."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from codesign_toys import EVERY, HASTY, SEED, ToyEvaluator, ToySearch, make_loop, run

from warpvox.algos.candidate import FINALIST, Candidate, Outcome
from warpvox.algos.codesign.finalists import Finalists
from warpvox.algos.codesign.loop import LocalExecutor
from warpvox.algos.report.members import read_members
from warpvox.algos.search import ALGORITHMS, make_search


def fitness(body: np.ndarray) -> float:
    return float((body * np.arange(1, body.size + 1).reshape(body.shape)).sum())


@EVERY
def test_after_every_search_the_best_come_again(algorithm: str) -> None:
    def search() -> Finalists:
        settings = ALGORITHMS[algorithm](population=3, max_designs=6, **HASTY.get(algorithm, {}))
        return Finalists(make_search(settings, (3, 3), 0), 2)

    history = run(search(), fitness)
    searched = [pair for generation in history[:-1] for pair in zip(*generation, strict=True)]
    best = sorted(searched, key=lambda pair: (-pair[1], pair[0].id))[:2]
    finals = history[-1][0]
    assert [item.parents for item in finals] == [(item.id,) for item, _ in best]
    assert all(np.array_equal(a.body, b.body) for a, (b, _) in zip(finals, best, strict=True))
    assert [(item.id, item.generation) for item in finals] == [(len(searched) + k, len(history) - 1) for k in (0, 1)]
    assert all((item.origin == FINALIST) == (item in finals) for asked, _ in history for item in asked)
    for done in (len(history) - 1, len(history)):  # resumed at any point, it goes on to the same end
        again = search()
        again.replay(history[:done])
        rest = run(again, fitness)
        assert [[item.id for item in asked] for asked, _ in rest] == [[c.id for c in a] for a, _ in history[done:]]


def test_bodies_that_come_twice_are_one_finalist() -> None:
    class Twins(ToySearch):
        def ask(self) -> list[Candidate]:
            return [dataclasses.replace(item, body=np.full((1, 1), 3 + item.id % 2)) for item in super().ask()]

    history = run(Finalists(Twins(generations=2), 5), fitness)
    assert [item.body.item() for item in history[-1][0]] == [4, 3]


def test_finalists_are_evaluated_again_and_ranked_with_all_others(tmp_path: Path) -> None:
    class Better(ToyEvaluator):
        """The fitness of a finalist is higher than before."""

        def evaluate(self, candidates: Sequence[Candidate], *more: Any) -> list[Outcome]:
            outcomes = super().evaluate(candidates, *more)
            for candidate, outcome in zip(candidates, outcomes, strict=True):
                outcome.fitness = float(outcome.fitness) + 100 * (candidate.origin == FINALIST)
            return outcomes

    executor = LocalExecutor(Better(seed=SEED))
    loop = make_loop(tmp_path, search=Finalists(ToySearch(), 3), executor=executor, batch=None, inherit=False)
    loop.run()

    records = loop.archive.records()
    finals = [record for record in records if record.candidate.origin == FINALIST]
    assert [record.reused for record in finals] == [None] * 3  # though their bodies were evaluated before
    assert all(record.fitness > records[record.candidate.parents[0]].fitness for record in finals)
    ranked = sorted(finals, key=lambda record: -record.fitness)
    best = loop.archive.best(5)
    assert [record.id for record in best[:3]] == [record.id for record in ranked]
    assert len({record.candidate.body.tobytes() for record in best}) == 5
    (member,) = read_members([tmp_path])
    assert member.steps.tolist() == np.cumsum([record.steps for record in records if record.reused is None]).tolist()
    assert member.evaluations[-1] == loop.archive.trained()
