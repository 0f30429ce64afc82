"""A generation trained at once: in any company, however often it is killed or halved."""

import dataclasses
import math
import signal
from pathlib import Path
from typing import Any

import pytest
import torch
from codesign_toys import Killed
from population_cases import candidates, factory, small, training_preset

from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.checkpoints.files import Controller, PolicySpec, build_actor
from warpvox.algos.codesign.population_evaluator import PopulationEvaluator
from warpvox.algos.codesign.sequential_evaluator import SequentialEvaluator
from warpvox.algos.evaluate import evaluate
from warpvox.errors import RunError
from warpvox.keys import MISSING

TASKS = pytest.mark.parametrize("task", ["Walker-v0", "Catcher-v0"])
PRESETS = pytest.mark.parametrize(("preset", "task"), [("paper", "Walker-v0"), ("fast", "Catcher-v0")])
DOUBLE = pytest.mark.usefixtures("double")
SAME = 1e-6
"""Of trainings in float64 that differ in rounding alone: in other company a design's matrix products have other sizes.
How they are rounded is up to the library and the CPU. Contacts and Adam let differences grow by orders of magnitude."""

pytestmark = pytest.mark.usefixtures("one_thread")


def assert_equal(one: Outcome, other: Outcome) -> None:
    """Bit for bit."""
    assert (one.fitness, one.curve, one.steps, one.stopped) == (other.fitness, other.curve, other.steps, other.stopped)
    assert one.policy.keys() == other.policy.keys()
    for name, value in one.policy.items():
        assert torch.equal(value, other.policy[name]), name


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
            actor = build_actor(spec)
            actor.load_state_dict(outcome.policy)
            again = evaluate(env, Controller(actor.eval(), spec), seed=5)
            assert float(again.returns[0]) == outcome.fitness


@DOUBLE
@pytest.mark.parametrize("preset", ["paper", "fast"])
def test_the_batched_evaluator_equals_the_sequential_one(preset: str) -> None:
    found, how = candidates(3), small(preset)
    batched, separate = (
        evaluator(factory(dtype="float64"), how, 7).evaluate(found, {})
        for evaluator in (PopulationEvaluator, SequentialEvaluator)
    )
    for ours, theirs in zip(batched, separate, strict=True):
        assert_close(ours, theirs)


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
    for evaluator in (PopulationEvaluator, SequentialEvaluator):
        evaluator(factory(), small(iterations=2), 0).evaluate(candidates(1), {})
        assert torch.equal(torch.get_rng_state(), before)


def killed_at(iteration: int):
    def report(event: dict[str, Any]) -> None:
        if event["iteration"] == iteration:
            raise Killed

    return report


@pytest.mark.parametrize(
    ("preset", "changes", "task"),
    [("paper", {}, "Catcher-v0"), ("fast", {"rungs": [0.34, 0.67]}, "Walker-v0")],
    ids=["plain", "halving"],
)
def test_a_killed_evaluation_goes_on_to_the_same_outcomes(tmp_path, preset: str, changes: dict, task: str) -> None:
    found, file = candidates(4), tmp_path / "state.pt"
    how = small(preset, save_interval=1, **changes)
    whole = PopulationEvaluator(factory(task), how, 2).evaluate(found, {})
    for iteration in (1, 3, 5):
        with pytest.raises(Killed):
            PopulationEvaluator(factory(task), how, 2).evaluate(found, {}, killed_at(iteration), file)
        torch.manual_seed(iteration)  # whatever happens between
    for ours, theirs in zip(
        PopulationEvaluator(factory(task), how, 2).evaluate(found, {}, None, file), whole, strict=True
    ):
        assert_equal(ours, theirs)


def test_an_interrupted_evaluation_is_saved_and_goes_on(tmp_path: Path) -> None:
    found, file, seen = candidates(2), tmp_path / "state.pt", []
    how = small(save_interval=100)

    def interrupt(event: dict[str, Any]) -> None:
        seen.append(event["iteration"])
        if event["iteration"] == 3:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        PopulationEvaluator(factory(), how, 0).evaluate(found, {}, interrupt, file)
    assert seen == [1, 2, 3]
    whole = PopulationEvaluator(factory(), how, 0).evaluate(found, {})
    resumed = PopulationEvaluator(factory(), how, 0).evaluate(
        found, {}, lambda event: seen.append(event["iteration"]), file
    )
    assert seen == [1, 2, 3, 4, 5, 6]
    for ours, theirs in zip(resumed, whole, strict=True):
        assert_equal(ours, theirs)


@pytest.mark.parametrize("evaluator", [PopulationEvaluator, SequentialEvaluator])
def test_the_checkpoint_of_others_is_refused(tmp_path: Path, evaluator: type) -> None:
    file, found = tmp_path / "state.pt", candidates(2)
    how = small(save_interval=1, iterations=2)
    evaluator(factory(), how, 0).evaluate(found, {}, None, file)
    assert file.exists()
    others = ((how, 1, found), (small(save_interval=1, iterations=3), 0, found), (how, 0, found[:1]))
    for settings, seed, part in others:
        with pytest.raises(RunError, match="other candidates or settings"):
            evaluator(factory(), settings, seed).evaluate(part, {}, None, file)


@pytest.mark.parametrize("iteration", [4, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 6))])
def test_one_by_one_a_killed_training_goes_on_within_a_design(tmp_path: Path, monkeypatch, iteration: int) -> None:
    """The second design of two is killed after so many of its 6 iterations, saved every 2."""
    from warpvox.algos.training.runner import Runner

    file, found, how = tmp_path / "training" / "state.pt", candidates(2), small(save_interval=2)
    whole = SequentialEvaluator(factory(), how, 0).evaluate(found, {})
    report, count = Runner._report, []

    def counted(runner: Runner, row: dict[str, float], end: int) -> None:
        report(runner, row, end)
        count.append(runner.current_learning_iteration)
        if len(count) == 6 + iteration:
            raise Killed

    monkeypatch.setattr(Runner, "_report", counted)
    with pytest.raises(Killed):
        SequentialEvaluator(factory(), how, 0).evaluate(found, {}, None, file)
    torch.manual_seed(iteration)  # whatever happens between
    count.clear()
    for ours, theirs in zip(SequentialEvaluator(factory(), how, 0).evaluate(found, {}, None, file), whole, strict=True):
        assert_equal(ours, theirs)
    saved = {1: 0, 4: 4, 6: 4}[iteration]
    assert count == list(range(saved + 1, 7))  # and nothing is done twice but what was not saved


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


@pytest.mark.parametrize("evaluator", [PopulationEvaluator, SequentialEvaluator])
def test_a_learning_rate_that_is_much_too_high_ends_no_evaluation(evaluator: type) -> None:
    how = small(iterations=4)
    how.ppo.learning_rate, how.ppo.schedule = 1e30, "fixed"
    results = evaluator(factory(), how, 0).evaluate(candidates(2), {})
    assert [(outcome.diverged, outcome.stopped, outcome.steps) for outcome in results] == [(True, True, 16)] * 2


def test_an_interrupt_while_the_last_designs_diverge_is_saved_as_well(tmp_path: Path) -> None:
    how = small(iterations=4)
    how.ppo.learning_rate, how.ppo.schedule = 1e30, "fixed"
    evaluate, file = PopulationEvaluator(factory(), how, 0).evaluate, tmp_path / "state.pt"
    with pytest.raises(KeyboardInterrupt):
        evaluate(candidates(2), {}, lambda event: signal.raise_signal(signal.SIGINT), file)
    assert evaluate(candidates(2), {}, None, file) == evaluate(candidates(2), {})
