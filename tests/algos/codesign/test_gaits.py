"""Designs compared by open-loop gaits: the formula, what descends from what, and that no design depends on others."""

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from population_cases import LIMIT, candidates, factory

from warpvox.algos.candidate import START, Candidate, Outcome, Parent, candidate_seed
from warpvox.algos.codesign import gait_evaluator
from warpvox.algos.codesign.finalists import BestOf
from warpvox.algos.codesign.gait_evaluator import GaitEvaluator
from warpvox.algos.codesign.gaits import LONGEST, SHORTEST, Gait, draw_gait, mutate_gait, mutate_motion, with_stages
from warpvox.algos.policies.gait import gait_outputs
from warpvox.errors import RunError
from warpvox.types import Cell

pytestmark = pytest.mark.usefixtures("narrow_packs")
COUNT, LANES = 8, 8


def evaluator(rounds: int = 1, seed: int = 0) -> GaitEvaluator:
    return GaitEvaluator(factory(), COUNT, rounds, seed=seed)


def parent_of(candidate: Candidate, outcome: Outcome) -> Parent:
    return Parent(candidate.body, outcome.policy, outcome.fitness)


def test_fitness_is_the_return_of_the_gait_that_is_kept() -> None:
    (candidate,) = candidates(1)
    (outcome,) = evaluator(rounds=2).evaluate([candidate], {})
    env = factory().make([candidate.body], 1, [candidate_seed(0, 0)], auto_reset=False)
    gait = {name: value.numpy() for name, value in outcome.policy.items()}
    driven = [cell for cell in np.ndindex(3, 3) if candidate.body[cell] in (Cell.H_ACT, Cell.V_ACT)]
    assert gait["cells"].tolist() == [3 * row + column for row, column in driven]
    env.reset()
    total = 0.0
    for step in range(env.max_episode_steps):
        stage = sum(1 for begin in gait["begin"] if begin <= step) - 1
        wave = [
            gait["rest"][(stage, *cell)]
            + gait["amplitude"][(stage, *cell)]
            * math.sin(2 * math.pi * step / gait["period"][stage] + gait["phase"][(stage, *cell)])
            for cell in driven
        ]
        actions = torch.tensor([[1.1 + 0.5 * min(1.0, max(-1.0, value)) for value in wave]], dtype=torch.float32)
        total += float(env.step(actions)[1])
    assert outcome.fitness == pytest.approx(total, abs=1e-4)
    assert outcome.steps == 2 * COUNT * env.max_episode_steps
    assert [steps for steps, _ in outcome.curve] == [outcome.steps // 2, outcome.steps]
    assert outcome.curve[0][1] <= outcome.curve[1][1] == outcome.fitness


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


def gait_of(policy: dict) -> dict[str, np.ndarray]:
    return {name: value.numpy() for name, value in policy.items() if name != "cells"}


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


def test_rounds_go_on_after_an_interrupt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gait_evaluator, "SAVE_INTERVAL", 0.0)
    found, checkpoint = candidates(2), tmp_path / "batch.pt"

    def stop(event: dict) -> None:
        if event["iteration"] == 2:
            raise KeyboardInterrupt

    whole = evaluator(rounds=4).evaluate(found, {})
    with pytest.raises(KeyboardInterrupt):
        evaluator(rounds=4).evaluate(found, {}, stop, checkpoint)
    (saved,) = tmp_path.iterdir()
    events: list[dict] = []
    resumed = evaluator(rounds=4).evaluate(found, {}, events.append, checkpoint)
    assert [event["iteration"] for event in events] == [2, 3, 4]
    for one, other in zip(whole, resumed, strict=True):
        assert (one.fitness, one.curve, one.steps) == (other.fitness, other.curve, other.steps)
        assert all(torch.equal(value, other.policy[name]) for name, value in one.policy.items())
    with pytest.raises(RunError, match="other candidates"):
        evaluator(rounds=4).evaluate(candidates(1), {}, None, checkpoint)
    state = json.loads(saved.read_text(encoding="utf-8"))
    for damage in '{"seeds": 1', json.dumps(state | {"best": [[1.0, []]] * 2}), json.dumps(state | {"random": [{}]}):
        saved.write_text(damage, encoding="utf-8")
        with pytest.raises(RunError, match="damaged"):
            evaluator(rounds=4).evaluate(found, {}, None, checkpoint)


def test_a_known_body_begins_with_its_gait() -> None:
    (candidate,) = candidates(1)
    (outcome,) = evaluator(rounds=3).evaluate([candidate], {})
    gait = Gait(**gait_of(outcome.policy))
    known = dataclasses.replace(evaluator(), known={candidate.body.tobytes(): gait}, seed=5, stages=7)
    start = dataclasses.replace(candidate, origin=START)
    for how in known, dataclasses.replace(known, count=1):
        (again,) = how.evaluate([start], {})
        assert again.fitness >= outcome.fitness
        assert len(again.policy["begin"]) == 7
    (other,) = known.evaluate([candidate], {})
    assert other.fitness < outcome.fitness


class Fixed:
    """An evaluator whose outcomes are known."""

    def __init__(self, *fitness: float) -> None:
        self.outcomes = [Outcome(value, [(10, value)], 10) for value in fitness]

    def evaluate(self, candidates, parents, report=None, checkpoint=None):
        self.parents = parents
        if report is not None:
            report({"steps": 20})
        return self.outcomes


def test_of_gait_and_training_the_better_one_counts() -> None:
    found, events = candidates(2), []
    gaits, training = Fixed(1.0, 4.0), Fixed(3.0, 2.0)
    parents = {0: Parent(found[0].body, {}, 0.0)}
    outcomes = BestOf(gaits, training).evaluate(found, parents, events.append)
    assert [outcome.fitness for outcome in outcomes] == [3.0, 4.0]
    assert [outcome.steps for outcome in outcomes] == [20, 20]
    assert outcomes[0].curve == [(10, 1.0), (20, 3.0)]
    assert (gaits.parents, training.parents) == (parents, {})
    assert [event["steps"] for event in events] == [20, 40]
