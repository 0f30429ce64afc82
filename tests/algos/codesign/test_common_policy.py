"""Designs compared by one policy: what it learns and keeps, and that a killed search is the undisturbed one."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest
import torch
from codesign_toys import Killed, ToySearch
from population_cases import candidates, factory, small

from warpvox.algos.candidate import Candidate, Outcome, candidate_seed
from warpvox.algos.checkpoints.files import Controller, build_actor, spec_of
from warpvox.algos.codesign.archive import FILE, Archive
from warpvox.algos.codesign.common_policy import SharedEvaluator
from warpvox.algos.codesign.evaluations import FewShot
from warpvox.algos.codesign.loop import LocalExecutor, Loop
from warpvox.algos.evaluate import evaluate
from warpvox.algos.policies.registry import layout_for
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.errors import DivergenceError, RunError

pytestmark = pytest.mark.usefixtures("one_thread", "narrow_packs")
FACTORY = dataclasses.replace(factory(), obs="voxel").computed(grid=(3, 3))


def how(iterations: int = 3, network: dict[str, int] | None = None, **ppo: Any) -> FewShot:
    settings = dataclasses.asdict(small().ppo) | ppo
    return FewShot(network=network, envs=4, iterations=iterations, save_interval=1, ppo=settings)


def shared(**changes: Any) -> SharedEvaluator:
    return SharedEvaluator(FACTORY, how(**changes), 0)


def later(found: list[Candidate], generation: int) -> list[Candidate]:
    """The same designs in a later generation, with ids of their own."""
    return [dataclasses.replace(item, id=item.id + generation * len(found), generation=generation) for item in found]


@pytest.fixture(scope="module")
def pretrained() -> dict[str, Any]:
    """What `warpvox train` would have left."""
    torch.manual_seed(3)
    env = adapt(FACTORY.make([item.body for item in candidates(3)], 4, [0, 1, 2], auto_reset=True), small().ppo)
    voxels = {"network": "grid", "settings": {}, "layout": layout_for("grid", env.env).dict()}
    runner = Runner(env, small().ppo, Schedule(3), voxels=voxels)
    runner.run()
    return runner.state()


def few_shot(pretrained: dict[str, Any], **changes: Any) -> SharedEvaluator:
    return SharedEvaluator(FACTORY, how(**changes), 0, pretrained)


def values(outcomes: list[Outcome]) -> list[float]:
    return [outcome.fitness for outcome in outcomes]


def test_fitness_is_that_of_the_common_policy_after_the_iterations_of_the_generation() -> None:
    found = candidates(3)
    outcomes = shared(network={"width": 8}).evaluate(found, {})
    for candidate, outcome in zip(found, outcomes, strict=True):
        seeds = [candidate_seed(0, candidate.id)]
        alone = FACTORY.make([candidate.body], 2, seeds, auto_reset=False)  # no matter in which company
        actor = build_actor(spec_of(outcome.spec))
        actor.load_state_dict(outcome.policy)
        again = evaluate(alone, Controller(actor.eval(), spec_of(outcome.spec)), seed=seeds)
        assert again.returns.tolist() == [outcome.fitness] * 2
        assert outcome.curve == [(3 * 4 * 4, outcome.fitness)]
        assert outcome.steps == 3 * 4 * 4 + int(again.lengths[0])  # its evaluation included
    assert len({id(outcome.policy) for outcome in outcomes}) == 1


def test_the_policy_goes_on_learning_from_generation_to_generation() -> None:
    found, evaluator = candidates(2), shared()
    first = evaluator.evaluate(found, {})
    second = evaluator.evaluate(later(found, 1), {})
    alone = shared().evaluate(later(found, 1), {})
    name = "network.moving"
    assert not torch.equal(second[0].policy[name], first[0].policy[name])
    assert not torch.equal(second[0].policy[name], alone[0].policy[name])
    samples = [float(one[0].policy["obs_normalizer.count"]) for one in (first, second, alone)]
    assert samples == [samples[0], 2 * samples[0], samples[0]]


def test_few_shot_begins_each_generation_with_the_pretrained_policy(pretrained: dict[str, Any]) -> None:
    found, evaluator = candidates(3), few_shot(pretrained)
    first = evaluator.evaluate(found, {})
    evaluator.evaluate(later(found, 1), {})
    assert values(evaluator.evaluate(found, {})) == values(first)
    before = float(pretrained["actor_state_dict"]["obs_normalizer.count"])
    assert float(first[0].policy["obs_normalizer.count"]) == before + 3 * 4 * 3 * 4


def test_zero_shot_is_the_pretrained_policy_itself_in_any_company(pretrained: dict[str, Any]) -> None:
    found, evaluator = candidates(3), few_shot(pretrained, iterations=0)
    outcomes = evaluator.evaluate(found, {})
    for name, value in outcomes[0].policy.items():
        assert torch.equal(value, pretrained["actor_state_dict"][name])
    assert [evaluator.evaluate([item], {})[0].fitness for item in found] == values(outcomes)
    assert [outcome.steps for outcome in outcomes] == [16] * 3  # that of the evaluation


def test_a_pretrained_policy_for_other_bodies_is_refused(pretrained: dict[str, Any]) -> None:
    larger = FACTORY.computed(grid=(3, 4))
    with pytest.raises(RunError, match="another layout"):
        SharedEvaluator(larger, how(), 0, pretrained).evaluate(candidates(1), {})


@pytest.mark.parametrize(
    ("kind", "moment"),
    [
        ("shared", "second"),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("shared", "first"), ("few_shot", "second"))),
        ("shared", "stored"),
    ],
)
def test_killed_at_any_moment_it_is_the_undisturbed_search(tmp_path, monkeypatch, pretrained, kind, moment) -> None:
    """Two generations of 3 iterations; killed in the first, the second, or before the second's results are stored."""

    def run(folder: Path) -> str:
        folder.mkdir(exist_ok=True)
        path = folder / FILE
        archive = Archive.open(path) if path.exists() else Archive.create(path, {})
        with archive:
            evaluator = shared() if kind == "shared" else few_shot(pretrained)
            search = ToySearch(population=3, generations=2)
            Loop(search, LocalExecutor(evaluator), archive, seed=0, checkpoints=folder / "training").run()
            return archive.digest()

    whole = run(tmp_path / "whole")
    iterate, finish, count = Runner._iterate, Archive.finish, []

    def iterated(runner: Runner, end: int) -> Any:
        if len(count) == {"first": 2, "second": 5}.get(moment):
            raise Killed
        count.append(None)
        return iterate(runner, end)

    def finished(archive: Archive, results: list[Any], *more: Any, **named: Any) -> None:
        if moment == "stored" and len(count) == 6:
            raise Killed
        finish(archive, results, *more, **named)

    with monkeypatch.context() as patched:
        patched.setattr(Runner, "_iterate", iterated)
        patched.setattr(Archive, "finish", finished)
        with pytest.raises(Killed):
            run(tmp_path / "killed")
    torch.manual_seed(9)  # whatever happens between
    assert run(tmp_path / "killed") == whole
    left = sorted(file.name for file in (tmp_path / "killed" / "training").rglob("*.pt"))
    assert left == (["000000.pt", "000001.pt"] if kind == "shared" else [])


def test_divergence_is_explained() -> None:
    with pytest.raises(DivergenceError, match="all designs has diverged in generation 0"):
        shared(learning_rate=1e30, schedule="fixed").evaluate(candidates(2), {})
