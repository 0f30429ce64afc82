"""Gaits that grow stage by stage: what is found is what a whole episode gives, and nothing good is lost."""

import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from population_cases import LIMIT, candidates, factory

from warpvox.algos.candidate import START
from warpvox.algos.codesign import gait_evaluator
from warpvox.algos.codesign.gait_actions import actions_of_gaits
from warpvox.algos.codesign.gait_beam import KEPT, SIBLINGS, _Search
from warpvox.algos.codesign.gait_evaluator import GaitEvaluator
from warpvox.algos.codesign.gaits import Gait, draw_gait
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.evaluate import evaluate
from warpvox.errors import RunError
from warpvox.robots import Gait as RobotGait
from warpvox.types import Cell

pytestmark = pytest.mark.usefixtures("narrow_packs")
COUNT, LANES, STEPS = 8, 8, 5


def evaluator(where: EnvFactory, **changes: object) -> GaitEvaluator:
    how = {"passes": 1, "beam": COUNT, "stage_steps": STEPS, "rounds": 0} | changes
    return GaitEvaluator(where, count=COUNT, **how)


def policy_gait(policy: dict[str, torch.Tensor]) -> Gait:
    return Gait(**{name: value.numpy() for name, value in policy.items() if name != "cells"})


def by_cell_order(gait: Gait, body: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the actuators alone, row by row."""
    return {name: getattr(gait, name)[:, body >= Cell.H_ACT] for name in ("amplitude", "phase", "rest")}


@pytest.mark.parametrize(
    ("task", "dtype", "limit", "episodes"),
    [
        ("Walker-v0", "float32", LIMIT, 1),
        ("Walker-v0", "float64", LIMIT, 1),
        ("Catcher-v0", "float32", LIMIT, 3),  # draws at random, and has an object of its own
        ("Balancer-v0", "float32", 60, 1),
    ],
)
def test_the_value_of_a_gait_is_the_return_of_its_episode(task: str, dtype: str, limit: int, episodes: int) -> None:
    found = [candidate for candidate in candidates(3) if (candidate.body > 0).sum() > 4]
    where = dataclasses.replace(factory(task, dtype), max_episode_steps=limit).computed(lanes=LANES)
    outcomes = evaluator(where, passes=2, episodes=episodes).evaluate(found, {})
    for candidate, outcome in zip(found, outcomes, strict=True):
        env = where.make([candidate.body], episodes, [0], auto_reset=False)
        gait = policy_gait(outcome.policy)
        policy = RobotGait(gait.begin, gait.period, **by_cell_order(gait, candidate.body))
        time = itertools.count()

        def act(obs: torch.Tensor, policy=policy, time=time) -> torch.Tensor:
            return torch.as_tensor(policy(np.full((len(obs), 1), float(next(time)))))  # numpy's, as the zoo has it

        played = evaluate(env, act, seed=0)  # which all designs have in common
        assert played.returns.mean().item() == outcome.fitness
        assert len(gait.begin) > 1
        # no step is taken twice, and none after the end of an episode
        assert outcome.steps <= 2 * COUNT * episodes * limit
        assert outcome.curve[0][1] <= outcome.curve[1][1] == outcome.fitness


def test_a_known_gait_is_kept_unless_a_better_one_is_found() -> None:
    (candidate,) = candidates(1)
    (first,) = evaluator(factory(), passes=6, beam=32).evaluate([candidate], {})
    known = {candidate.body.tobytes(): policy_gait(first.policy)}
    start = dataclasses.replace(candidate, origin=START)
    for count in 1, COUNT:
        (again,) = evaluator(factory(), beam=count, known=known, seed=3).evaluate([start], {})
        assert again.fitness >= first.fitness
        if count == 1:  # nothing else is tried
            assert again.fitness == first.fitness
    (other,) = evaluator(factory(), seed=3).evaluate([candidate], {})
    assert other.fitness < first.fitness


def test_passes_come_before_rounds_and_go_on_after_an_interrupt(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(gait_evaluator, "SAVE_INTERVAL", 0.0)
    found, checkpoint = candidates(2), tmp_path / "batch.pt"
    how = evaluator(factory(), passes=2, beam=2 * COUNT, rounds=1)

    def stop_in(iteration: int):
        def stop(event: dict) -> None:
            assert event["iterations"] == 3
            if event["iteration"] == iteration:
                raise KeyboardInterrupt

        return stop

    whole = how.evaluate(found, {})
    assert [steps for steps, _ in whole[0].curve] == [2 * COUNT * LIMIT, 4 * COUNT * LIMIT, 5 * COUNT * LIMIT]
    for iteration in 1, 2:
        with pytest.raises(KeyboardInterrupt):
            how.evaluate(found, {}, stop_in(iteration), checkpoint)
    resumed = how.evaluate(found, {}, None, checkpoint)
    for one, other in zip(whole, resumed, strict=True):
        assert (one.fitness, one.curve, one.steps) == (other.fitness, other.curve, other.steps)
        assert all(torch.equal(value, other.policy[name]) for name, value in one.policy.items())
    (saved,) = tmp_path.iterdir()
    assert json.loads(saved.read_text(encoding="utf-8"))["round"] == 3
    with pytest.raises(RunError, match="other candidates"):
        how.evaluate(found[:1], {}, None, checkpoint)


def test_the_best_go_on_but_not_all_from_one() -> None:
    (candidate,) = candidates(1)
    rng, count = np.random.default_rng(0), 64
    known = draw_gait(rng, candidate.body, 100, 4)
    search = _Search(candidate.body, count, [known], rng)
    search.continued(0, 10)
    search.choose([float(place) for place in range(count)], [False] * count)
    kept = round(KEPT * count)
    # all continue the same; the known one has the lowest value
    assert [beginning.place for beginning in search.beginnings] == [
        0,
        *range(count - 1, count - round(SIBLINGS * kept), -1),
    ]
    assert search.beginnings[0].is_known
    gaits = search.continued(10, 20)
    assert len(gaits) == len(search.sources) == count
    assert set(search.sources) == {beginning.place for beginning in search.beginnings}
    assert search.best is None
    search.choose([1.0] * count, [place < 2 for place in range(count)])
    assert search.best[0] == 1.0
    search.continued(20, 30)
    search.choose([0.5] * count, [True] * count)
    assert search.best[0] == 1.0
    assert search.beginnings == []
    assert len(search.continued(30, 40)) == count  # of episodes that have ended


def test_gaits_with_different_numbers_of_stages_act_together() -> None:
    rng, (candidate,) = np.random.default_rng(0), candidates(1)
    gaits = [draw_gait(rng, candidate.body, LIMIT, stages) for stages in (3, 1)]
    env = factory().make([candidate.body], 2, [0], auto_reset=False)
    alone = factory().make([candidate.body], 1, [0], auto_reset=False)
    both = torch.stack(list(actions_of_gaits(env, [candidate.body], [gaits], 1)))
    assert both.shape == (LIMIT, 2, env.num_actions)
    for place, gait in enumerate(gaits):
        each = torch.stack(list(actions_of_gaits(alone, [candidate.body], [[gait]], 1)))
        assert torch.equal(both[:, place], each[:, 0])
        late = torch.stack(list(actions_of_gaits(alone, [candidate.body], [[gait]], 1, 5, 9)))
        assert torch.equal(late, each[5:9])
