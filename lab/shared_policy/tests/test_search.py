"""Tests of the search by one policy: continued learning, resumption after a kill, and fitness."""

from pathlib import Path
from typing import Any

import pytest

import warpvox as wv
from lab.shared_policy.search import CommonPolicy, search
from warpvox.algos.candidate import Candidate, Outcome

HOW: dict[str, Any] = {
    "iterations": 2,
    "envs": 2,
    "network": {"width": 8},
    "ppo": wv.Ppo(steps=4, epochs=1),
    "device": "cpu",
    "threads": 1,
}


def candidates(generation: int) -> list[Candidate]:
    ids = range(3 * generation, 3 * generation + 3)
    return [Candidate(k, wv.sample_design((3, 3), seed=k), generation=generation) for k in ids]


def values(outcomes: list[Outcome]) -> list[float]:
    return [outcome.fitness for outcome in outcomes]


def test_a_training_that_was_killed_is_made_again_to_the_same_results(tmp_path: Path) -> None:
    def kill(event: dict[str, Any]) -> None:
        raise KeyboardInterrupt

    undisturbed = CommonPolicy(tmp_path / "a", **HOW)
    expected = [values(undisturbed.evaluate(candidates(generation), {})) for generation in (0, 1)]

    found = [values(CommonPolicy(tmp_path / "b", **HOW).evaluate(candidates(0), {}))]
    with pytest.raises(KeyboardInterrupt):
        CommonPolicy(tmp_path / "b", **HOW).evaluate(candidates(1), {}, kill)
    found.append(values(CommonPolicy(tmp_path / "b", **HOW).evaluate(candidates(1), {})))
    assert found == expected


def test_the_policy_goes_on_or_begins_with_a_pretrained_one(tmp_path: Path) -> None:
    alone = values(CommonPolicy(tmp_path / "alone", **HOW).evaluate(candidates(1), {}))
    after = CommonPolicy(tmp_path / "after", **HOW)
    after.evaluate(candidates(0), {})
    assert values(after.evaluate(candidates(1), {})) != alone

    begin = tmp_path / "after" / "from_000000" / "model_2.pt"
    tuned = CommonPolicy(tmp_path / "tuned", pretrained=begin, **HOW)
    first = values(tuned.evaluate(candidates(1), {}))
    assert values(tuned.evaluate(candidates(1), {})) == first  # not what it has learned meanwhile


def test_a_search_ends_with_finalists(tmp_path: Path) -> None:
    training = wv.DesignTraining(envs=4, iterations=1, eval_interval=1, ppo=wv.Ppo(steps=4, epochs=1))
    settings = wv.GA(population=3, max_designs=6, min_survivors=1)
    found, finals = search(tmp_path, shape=(3, 3), settings=settings, finalists=2, training=training, **HOW)
    assert (len(found.designs), len(finals.designs)) == (6, 2)
    ranked = sorted(found.designs, key=lambda record: -record.fitness)
    trained = {record.candidate.body.tobytes() for record in finals.designs}
    assert trained == {record.candidate.body.tobytes() for record in ranked[:2]}
    assert finals.best.policy_file is not None
