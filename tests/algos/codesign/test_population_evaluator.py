"""A generation trained at once: in any company, and halved."""

import dataclasses
import math
from typing import Any

import pytest
import torch
from population_cases import candidates, factory, small, training_preset

from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.checkpoints.files import PolicySpec
from warpvox.algos.checkpoints.policy import Policy
from warpvox.algos.codesign.population_evaluator import PopulationEvaluator
from warpvox.algos.evaluate import evaluate
from warpvox.keys import MISSING

TASKS = pytest.mark.parametrize("task", ["Walker-v0", "Catcher-v0"])
PRESETS = pytest.mark.parametrize(("preset", "task"), [("paper", "Walker-v0"), ("fast", "Catcher-v0")])
DOUBLE = pytest.mark.usefixtures("double")
SAME = 1e-6
"""Of trainings in float64 that differ in rounding alone: in other company a design's matrix products have other sizes.
How they are rounded is up to the library and the CPU. Contacts and Adam let differences grow by orders of magnitude."""

pytestmark = pytest.mark.usefixtures("one_thread")


def assert_close(one: Outcome, other: Outcome) -> None:
    """But for rounding."""
    assert [at for at, _ in one.curve] == [at for at, _ in other.curve]
    assert [value for _, value in one.curve] == pytest.approx([value for _, value in other.curve], abs=SAME)
    assert one.fitness == pytest.approx(other.fitness, abs=SAME)
    assert (one.steps, one.stopped) == (other.steps, other.stopped)
    assert one.policy.keys() == other.policy.keys()
    for name, value in one.policy.items():
        torch.testing.assert_close(value, other.policy[name], rtol=0, atol=SAME)


def outcomes(
    found: list[Candidate], task: str = "Walker-v0", seed: int = 0, dtype: str = "float32", **changes: Any
) -> list[Outcome]:
    return PopulationEvaluator(factory(task, dtype), small(**changes), seed).evaluate(found, {})


@TASKS
def test_fitness_is_the_best_of_the_evaluations_and_the_policy_earns_it(task: str) -> None:
    found = candidates(3)
    how = small()
    for candidate, outcome in zip(found, outcomes(found, task, seed=5), strict=True):
        steps = [n * how.envs * how.ppo.steps for n in (2, 4, 6)]
        assert [at for at, _ in outcome.curve] == steps
        assert outcome.fitness == max(value for _, value in outcome.curve)
        assert (outcome.steps, outcome.stopped) == (steps[-1], False)
        for count in (1, 4):  # beside others, too: networks are evaluated in float64
            env = factory(task).make([candidate.body], count, [0], auto_reset=False)
            spec = PolicySpec(env.num_obs, env.num_actions, how.ppo.hidden, how.ppo.activation, True, 0.5)
            again = evaluate(env, Policy(spec, outcome.policy).double(), seed=5)
            assert float(again.returns[0]) == outcome.fitness


@pytest.mark.parametrize(("name", "samples"), [("paper", 512), ("paper_wide", 512), ("fast", 2048), ("gpu", 8192)])
def test_presets_spend_the_papers_control_steps(name: str, samples: int) -> None:
    how = training_preset(name)
    assert how.envs * how.ppo.steps == samples
    assert how.iterations == 512_000 // samples
    values = dataclasses.asdict(how)
    assert MISSING not in [*values.values(), *values["ppo"].values()]


@DOUBLE
@PRESETS
def test_an_outcome_does_not_depend_on_the_company(preset: str, task: str) -> None:
    """Other bodies, other numbers of them, another order, or a twin beside it."""
    found = candidates(5)
    how = small(preset)
    run = lambda part: PopulationEvaluator(factory(task, "float64"), how, 3).evaluate(part, {})  # noqa: E731
    together = run(found)
    for part in ([2], [3, 1, 2]):
        for k, outcome in zip(part, run([found[k] for k in part]), strict=True):
            assert_close(outcome, together[k])
    twin = Candidate(9, found[1].body)
    assert_close(run([found[1], twin, found[2]])[0], together[1])


def test_randomness_follows_from_seed_and_id() -> None:
    body = candidates(1)[0].body
    first, second = outcomes([Candidate(0, body), Candidate(1, body)])
    assert first.curve != second.curve
    assert outcomes([Candidate(0, body)], seed=1)[0].curve != first.curve


def test_the_global_random_numbers_are_left_alone() -> None:
    before = torch.get_rng_state()
    PopulationEvaluator(factory(), small(iterations=2), 0).evaluate(candidates(1), {})
    assert torch.equal(torch.get_rng_state(), before)


@DOUBLE
def test_halving_stops_the_least_promising_and_changes_no_survivor() -> None:
    found, task = candidates(6), "Catcher-v0"
    whole = outcomes(found, task, dtype="float64")
    halved = outcomes(found, task, dtype="float64", rungs=[0.34, 0.67], keep=0.5)
    assert [outcome.stopped for outcome in halved].count(True) == 4  # 6, then 3, then 2 go on
    left = list(range(6))
    for rung, count in ((0, 3), (1, 2)):
        best = {k: max(value for _, value in whole[k].curve[: rung + 1]) for k in left}
        left = sorted(sorted(left, key=lambda k: -best[k])[:count])
    assert [k for k in range(6) if not halved[k].stopped] == left
    for k, (outcome, full) in enumerate(zip(halved, whole, strict=True)):
        if k in left:
            assert_close(outcome, full)
        else:
            values = [value for _, value in full.curve[: len(outcome.curve)]]
            assert [value for _, value in outcome.curve] == pytest.approx(values, abs=SAME)
            assert outcome.steps == outcome.curve[-1][0] < full.steps
            assert outcome.fitness == max(value for _, value in outcome.curve)


def test_a_rung_between_evaluations_brings_one_of_its_own() -> None:
    results = outcomes(candidates(2), rungs=[0.5])  # after iteration 3 of 6, evaluations every 2
    assert [len(outcome.curve) for outcome in results if outcome.stopped] == [2]
    assert [at // 16 for outcome in results if not outcome.stopped for at, _ in outcome.curve] == [2, 3, 4, 6]


@DOUBLE
def test_a_diverged_design_leaves_with_what_it_had(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its networks are spoilt after its first evaluation; the others do not notice."""
    from warpvox.algos.population.training import PopulationTraining

    found, whole = candidates(3), outcomes(candidates(3), dtype="float64")
    iterate = PopulationTraining.iterate

    def spoil(training: PopulationTraining) -> None:
        iterate(training)
        if training.iteration == 3:
            training.algorithm.actor.weights[1].data[1] = float("nan")

    monkeypatch.setattr(PopulationTraining, "iterate", spoil)
    results = outcomes(found, dtype="float64")
    assert [outcome.stopped for outcome in results] == [False, True, False]
    assert results[1].curve == whole[1].curve[:1]
    for k in (0, 2):
        assert_close(results[k], whole[k])


@DOUBLE
@pytest.mark.parametrize("moment", ["collect", "update", "evaluate"])
def test_divergence_before_the_first_evaluation_is_a_fitness_of_its_own(monkeypatch, moment: str) -> None:
    """A policy gives no numbers while it collects, after its update, or when it is judged; the others do not notice."""
    from warpvox.algos.population.training import PopulationTraining

    found, whole = candidates(3), outcomes(candidates(3), dtype="float64")
    iterate, evaluate_all = PopulationTraining.iterate, PopulationTraining.evaluate

    def spoil(training: PopulationTraining) -> None:
        if training.num_designs == 3:
            training.algorithm.actor.weights[1].data[1] = math.nan

    def iterated(training: PopulationTraining) -> None:
        if (moment, training.iteration) == ("collect", 1):
            spoil(training)
        iterate(training)
        if (moment, training.iteration) == ("update", 1):
            spoil(training)

    def evaluated(training: PopulationTraining) -> torch.Tensor:
        if moment == "evaluate":
            spoil(training)
        return evaluate_all(training)

    monkeypatch.setattr(PopulationTraining, "iterate", iterated)
    monkeypatch.setattr(PopulationTraining, "evaluate", evaluated)
    events: list[dict[str, Any]] = []
    results = PopulationEvaluator(factory(dtype="float64"), small(), 0).evaluate(found, {}, events.append)
    assert [outcome.diverged for outcome in results] == [False, True, False]
    assert (results[1].curve, results[1].policy, results[1].stopped) == ([], None, True)
    assert results[1].steps == (16 if moment == "update" else 32)
    assert math.isnan(events[-1]["best"][1])
    for k in (0, 2):
        assert_close(results[k], whole[k])


def test_a_learning_rate_that_is_much_too_high_ends_no_evaluation() -> None:
    how = small(iterations=4)
    how.ppo.learning_rate, how.ppo.schedule = 1e30, "fixed"
    results = PopulationEvaluator(factory(), how, 0).evaluate(candidates(2), {})
    assert [(outcome.diverged, outcome.stopped, outcome.steps) for outcome in results] == [(True, True, 16)] * 2
