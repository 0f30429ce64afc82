"""Tests of training by gradients: improvement, agreement with the environment, and refusal of flat rewards."""

from pathlib import Path

import numpy as np
import pytest
import torch

from lab.gradients.ascent import Ascent, Motion, Targets, judge, load_network, make_env, roll_out
from lab.gradients.cpg import CpgNetwork
from lab.gradients.search import Tuned
from lab.gradients.train import read_arguments, train
from warpvox import ConfigError, DesignError, SimulationError, TaskError, example_design, sample_design
from warpvox.algos.candidate import Candidate

ENVS, SHAPE, STEPS = 8, (3, 3), 40
BODIES = [sample_design(SHAPE, seed=k) for k in range(ENVS)]
OPTIONS = dict(device="cpu", threads=1, lanes=8)


def make(task: str = "Walker-v0", steps: int = STEPS, **changes: object) -> Ascent:
    torch.manual_seed(0)
    env = make_env(task, BODIES, SHAPE, **{"max_episode_steps": 60, **OPTIONS, **changes})
    return Ascent(CpgNetwork(*SHAPE, width=8, heads=2, layers=1), env, steps, 8, 0.01)


def test_returns_rise_and_repeat() -> None:
    ascent = make()
    returns = [ascent.iterate()["return"] for _ in range(8)]
    assert returns[-1] > returns[0] + 0.01
    again = make()
    assert [again.iterate()["return"] for _ in range(2)] == returns[:2]


def test_the_rollout_is_what_the_environment_does() -> None:
    ascent = make()
    bodies, weights = ascent.look()
    ascent.env.reset()
    returns, _, stopped = roll_out(ascent.env, ascent.gradients, weights, bodies, STEPS)
    motion, (obs, _) = Motion(weights, bodies), ascent.env.reset()
    for _ in range(STEPS):
        obs, _, _, _, info = ascent.env.step(motion(obs))
    assert not stopped.any()
    torch.testing.assert_close(returns.float(), info["episode"]["return"].float(), rtol=0, atol=1e-6)


def test_bodies_that_are_exchanged_are_looked_at() -> None:
    ascent = make()
    before = ascent.look()[0]
    ascent.env.set_designs([np.full(SHAPE, 3, np.int8)], torch.arange(ENVS) == 0)
    after = ascent.look()[0]
    assert not torch.equal(after[0], before[0])
    assert torch.equal(after[1:], before[1:])


def test_what_has_no_derivative_is_refused() -> None:
    with pytest.raises(TaskError, match="not of hull_area"):
        make("AreaMaximizer-v0")
    with pytest.raises(ConfigError, match="memory"):
        make("BidirectionalWalker-v0")
    with pytest.raises(ConfigError, match="no derivative"):
        make("Lifter-v0")
    with pytest.raises(SimulationError, match="layout='lanes'"):
        make(layout="group", lanes=None)
    with pytest.raises(ConfigError, match="an episode has, 5"):
        make(max_episode_steps=5)


def test_the_policy_that_lies_here_is_tuned_for_a_body(tmp_path: Path) -> None:
    walker = example_design("walker")
    env = make_env("Walker-v0", [walker], (5, 5), **OPTIONS)
    assert judge(load_network(), env, [walker])[0] > 5
    with pytest.raises(DesignError, match="does not fit"):
        judge(load_network(), env, [np.full((6, 6), 3)])
    out = tmp_path / "policy.pt"
    words = "--designs walker --begin lab/gradients/universal.pt --iterations 1 --steps 10 --updates 2 --threads 1"
    words = words.replace("lab/gradients", str(Path(__file__).parents[1]))
    found = train(read_arguments([*words.split(), "--out", str(out)]))
    assert len(found) == 2
    assert judge(load_network(out), env, [walker]).tolist() == pytest.approx(found[1:])


def test_an_evaluation_of_designs_tunes_for_them() -> None:
    candidates = [Candidate(k, sample_design((5, 5), seed=k)) for k in range(2)]
    zero, tuned, again = (
        Tuned(iterations=count, steps=10, updates=2, max_episode_steps=20, **OPTIONS).evaluate(candidates, {})
        for count in (0, 1, 1)
    )
    assert [one.fitness for one in tuned] == [one.fitness for one in again]
    assert [one.fitness for one in tuned] != [one.fitness for one in zero]
    assert [one.steps for one in tuned] == [30, 30]


def numbered(*numbers: int) -> torch.Tensor:
    return torch.tensor([[[float(number)]] for number in numbers])


def test_the_last_targets_stay_and_a_body_has_its_newest() -> None:
    targets = Targets(4)
    targets.add(numbered(1, 2, 3), numbered(10, 20, 30))
    targets.add(numbered(2, 4, 2), numbered(21, 40, 22))
    targets.add(numbered(5), numbered(50))
    assert len(targets) == 4
    bodies, wanted = targets.draw(200)
    pairs = set(zip(bodies.flatten().tolist(), wanted.flatten().tolist(), strict=True))
    assert pairs == {(3, 30), (2, 22), (4, 40), (5, 50)}
