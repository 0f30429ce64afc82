"""Designs compared by open-loop gaits: what is found is what a whole episode gives, and no design depends on others."""

import dataclasses
import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
import torch
from population_cases import LIMIT, candidates, factory

from warpvox.algos.candidate import FINALIST, START, Candidate, Outcome, Parent
from warpvox.algos.codesign.finalists import TwoStages
from warpvox.algos.codesign.fitness import Gaits
from warpvox.algos.codesign.gait_actions import actions_of_gaits
from warpvox.algos.codesign.gait_evaluator import GaitEvaluator
from warpvox.algos.codesign.gaits import LONGEST, SHORTEST, Gait, draw_gait, mutate_gait, mutate_motion, with_stages
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.evaluate import evaluate
from warpvox.algos.policies.gait import gait_outputs
from warpvox.algos.robots import gait_policy
from warpvox.types import Cell

pytestmark = pytest.mark.usefixtures("narrow_packs")
COUNT = 8


def evaluator(rounds: int = 1, seed: int = 0) -> GaitEvaluator:
    return GaitEvaluator(factory(), Gaits(gaits=COUNT, rounds=rounds, stages=2), seed)


def parent_of(candidate: Candidate, outcome: Outcome) -> Parent:
    return Parent(candidate.body, outcome.policy, outcome.fitness)


def test_a_design_does_not_depend_on_its_company() -> None:
    found, events = candidates(3), []
    together = [outcome.fitness for outcome in evaluator(seed=1).evaluate(found, {}, events.append)]
    assert together == [evaluator(seed=1).evaluate([candidate], {})[0].fitness for candidate in found]
    assert len(set(together)) == 3
    assert [event["steps"] for event in events] == [0, 3 * COUNT * LIMIT]
    assert (events[1]["best"], events[1]["training"]) == (together, [False] * 3)
    assert [outcome.fitness for outcome in evaluator(seed=2).evaluate(found, {})] != together


def test_a_child_is_never_worse_for_having_its_parents_gait() -> None:
    mother, father = candidates(2)
    outcomes = evaluator(rounds=3).evaluate([mother, father], {})
    parents = {0: parent_of(mother, outcomes[0]), 1: parent_of(father, outcomes[1])}
    best = max(parents, key=lambda number: parents[number].fitness)
    same = Candidate(2, parents[best].body, (0, 1), "mutation", 1)
    (outcome,) = evaluator().evaluate([same], parents)
    assert outcome.fitness >= parents[best].fitness
    assert outcome.fitness > evaluator().evaluate([dataclasses.replace(same, parents=())], {})[0].fitness


@pytest.mark.parametrize("seed", range(5))
def test_gaits_and_mutants_stay_within_their_limits(seed: int) -> None:
    rng, body = np.random.default_rng(seed), candidates(1)[0].body
    gait = draw_gait(rng, body, 100, 3)
    for _ in range(200):
        before = gait
        gait = mutate_gait(rng, gait, body, 100)
        assert gait.begin[0] == 0
        assert (np.diff(gait.begin) >= 0).all()
        assert gait.begin[-1] <= 100
        assert (gait.begin == gait.begin.round()).all()
        assert SHORTEST <= gait.period.min() <= gait.period.max() <= LONGEST
        assert np.abs(gait.rest).max() <= 2
        assert gait.amplitude.min() >= 0
        for name, values in vars(gait).items():
            assert values.shape == getattr(before, name).shape
            np.testing.assert_array_equal(values, values.astype(np.float32))


def test_a_wave_with_another_period_begins_its_stage_as_before() -> None:
    rng, body, begin = np.random.default_rng(0), candidates(1)[0].body, 400
    motion = draw_gait(rng, body, 500, 1)
    period, amplitude, phase, rest = motion.period[0], motion.amplitude[0], motion.phase[0], motion.rest[0]
    mutants = [mutate_motion(rng, (period, amplitude, phase, rest), body, begin) for _ in range(400)]
    others = [one for one in mutants if one[0] != period and np.ptp(one[2] - phase) < 1e-4]
    assert len(others) > 20
    for other in others:
        turned = (begin / other[0] - begin / period) + (other[2] - phase) / (2 * np.pi)
        np.testing.assert_allclose(turned, turned.round(), atol=1e-4)
    assert max(np.ptp(begin / np.array([one[0], period])) for one in others) > 0.25  # which would be seen


def test_more_stages_do_not_change_a_motion_until_one_begins_another() -> None:
    rng, body = np.random.default_rng(0), candidates(1)[0].body
    gait = draw_gait(rng, body, 100, 3)
    time = torch.arange(100.0, dtype=torch.float64)[:, None]

    def motion(gait: Gait) -> torch.Tensor:
        values = [torch.as_tensor(values.reshape(len(gait.begin), -1)) for values in vars(gait).values()]
        return gait_outputs(time, values[0][:, 0], values[1][:, 0], *values[2:])

    longer = with_stages(gait, 9, 100)
    assert len(longer.begin) == 9
    assert (np.diff(longer.begin) >= 0).all()
    assert longer.begin[-1] < 100
    assert torch.equal(motion(longer), motion(gait))
    same = with_stages(gait, 3, 100)
    assert all(np.array_equal(values, getattr(same, name)) for name, values in vars(gait).items())
    # of many mutants some differ late in the episode alone
    first = []
    for _ in range(200):
        same = (motion(mutate_gait(rng, longer, body, 100)) == motion(longer)).all(1)
        first.append(int(same.int().argmin()) if not same.all() else 100)
    assert sum(50 < step < 100 for step in first) > 8


class Fixed:
    """An evaluator whose outcomes are known."""

    def __init__(self, *fitness: float) -> None:
        self.outcomes = [Outcome(value, [(10, value)], 10) for value in fitness]

    def evaluate(self, candidates, parents, report=None):
        self.parents = parents
        if report is not None:
            report({"steps": 20})
        return self.outcomes


def test_of_gait_and_training_the_better_one_counts() -> None:
    found, events = candidates(2), []
    gaits, training = Fixed(1.0, 4.0), Fixed(3.0, 2.0)
    parents = {0: Parent(found[0].body, {}, 0.0)}
    found = [dataclasses.replace(candidate, origin=FINALIST) for candidate in found]
    outcomes = TwoStages(Fixed(0.0, 0.0), gaits, training).evaluate(found, parents, events.append)
    assert [outcome.fitness for outcome in outcomes] == [3.0, 4.0]
    assert [outcome.steps for outcome in outcomes] == [20, 20]
    assert outcomes[0].curve == [(10, 1.0), (20, 3.0)]
    assert (gaits.parents, training.parents) == (parents, {})
    assert [event["steps"] for event in events] == [20, 40]


LANES, STEPS = 8, 5


def staged(where: EnvFactory, seed: int = 0, known: Mapping | None = None, **changes: Any) -> GaitEvaluator:
    how = {"passes": 1, "beam": COUNT, "stage_steps": STEPS, "rounds": 0, "stages": 2} | changes
    return GaitEvaluator(where, Gaits(gaits=COUNT, **how), seed, changes.get("episodes", 1), known or {})


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
    where = factory(task, dtype, limit).computed(lanes=LANES)
    outcomes = staged(where, passes=2, episodes=episodes).evaluate(found, {})
    for candidate, outcome in zip(found, outcomes, strict=True):
        env = where.make([candidate.body], episodes, [0], auto_reset=False)
        gait = policy_gait(outcome.policy)
        policy = gait_policy(candidate.body, gait.begin, gait.period, **by_cell_order(gait, candidate.body))
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
    (first,) = staged(factory(), passes=6, beam=32).evaluate([candidate], {})
    known = {candidate.body.tobytes(): policy_gait(first.policy)}
    start = dataclasses.replace(candidate, origin=START)
    for count in 1, COUNT:
        (again,) = staged(factory(), beam=count, known=known, seed=3).evaluate([start], {})
        assert again.fitness >= first.fitness
        if count == 1:  # nothing else is tried
            assert again.fitness == first.fitness
    (other,) = staged(factory(), seed=3).evaluate([candidate], {})
    assert other.fitness < first.fitness


def test_passes_come_before_rounds() -> None:
    whole = staged(factory(), passes=2, beam=2 * COUNT, rounds=1).evaluate(candidates(2), {})
    assert [steps for steps, _ in whole[0].curve] == [2 * COUNT * LIMIT, 4 * COUNT * LIMIT, 5 * COUNT * LIMIT]


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
