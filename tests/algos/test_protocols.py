"""Disturbed episodes: their numbers, what they change, and that searches choose by what a judgement could repeat."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from episodes import short_episodes
from population_cases import candidates, factory
from refusals import refused

import warpvox as wv
from warpvox.algos.candidate import candidate_seed
from warpvox.algos.checkpoints.files import spec_of
from warpvox.algos.checkpoints.policy import Policy, read_policy
from warpvox.algos.codesign.fitness import Gaits
from warpvox.algos.codesign.gait_evaluator import GaitEvaluator
from warpvox.algos.disturbance import JUDGED, NOISE, SEARCHED, Disturbed, Draws
from warpvox.algos.evaluate import evaluator
from warpvox.algos.protocols import COPIES, DISTURBANCES, PROTOCOLS
from warpvox.algos.robots.entry import DIGITS, zoo_tasks
from warpvox.envs.registry import get_task
from warpvox.errors import ConfigError
from warpvox.types import ACTION_HIGH, ACTION_LOW

EPISODES = 32  # under noise, of an entry of the zoo

COUNT = 500


@pytest.fixture
def short_walks() -> Iterator[None]:
    with short_episodes("Walker-v0", "BridgeWalker-v0", "Jumper-v0"):
        yield


def test_numbers_are_normal_and_uniform() -> None:
    draws = Draws(3, JUDGED, COUNT)
    normal, uniform = draws.normal(NOISE, 7, 20).flatten(), draws.uniform(NOISE, 7, 20).flatten()
    for values, mean, deviation in (normal, 0.0, 1.0), (uniform, 0.5, 12**-0.5):
        assert float(values.mean()) == pytest.approx(mean, abs=4 * deviation / len(values) ** 0.5)
        assert float(values.std()) == pytest.approx(deviation, rel=0.04)
    assert float((normal.abs() > 1.96).double().mean()) == pytest.approx(0.05, abs=0.01)


def test_numbers_depend_on_copy_step_seed_and_stream_alone() -> None:
    first = Draws(3, JUDGED, 4).normal(NOISE, 7, 5)
    assert torch.equal(Draws(3, JUDGED, 9).normal(NOISE, 7, 8)[:4, :5], first)  # not on how many there are
    others = [Draws(4, JUDGED, 4), Draws(3, SEARCHED, 4), Draws(3, JUDGED, 4)]
    for step, draws in zip((7, 7, 8), others, strict=True):
        assert not torch.isin(draws.normal(NOISE, step, 5), first).any()


def played(parts: tuple[str, ...], copies: int) -> tuple[list[torch.Tensor], list[torch.Tensor]]:
    """Observations that a policy is given, and actions ``[parts, copies, num_actions]`` that follow."""
    env = wv.make_vec("Walker-v0", "mini", len(parts) * copies, device="cpu", auto_reset=False)
    seen, done = [], []

    def policy(obs: torch.Tensor) -> torch.Tensor:
        seen.append(obs.view(len(parts), copies, -1))
        return torch.full((env.num_envs, env.num_actions), 1.0 + 0.01 * len(seen))

    disturbed = Disturbed(policy, env, parts, seed=0)
    obs, _ = env.reset()
    for _ in range(25):
        actions = disturbed(obs)
        done.append(actions.view(len(parts), copies, -1))
        obs, *_ = env.step(actions)
    return seen, done


def test_each_block_is_disturbed_in_its_way() -> None:
    names = tuple(DISTURBANCES)
    seen, done = played(names, 40)
    actions, obs = torch.stack(done), torch.stack(seen)
    given = 1.0 + 0.01 * torch.arange(1, 26)[:, None, None]
    nominal, noise, sticky, start, sensors = (actions[:, names.index(name)] for name in names)
    assert torch.equal(nominal, given.expand_as(nominal))
    assert torch.equal(sensors, given.expand_as(sensors))
    assert float((noise - given).std()) == pytest.approx(0.01, rel=0.05)
    repeats = (sticky[1:] == sticky[:-1]).all(2)
    assert torch.equal(repeats, (sticky[1:] == sticky[:-1]).any(2))  # all actuators together
    assert float(repeats.double().mean()) == pytest.approx(0.25, abs=0.05)
    lengths = (start != given).any(2).sum(0)
    assert set(lengths.tolist()) <= set(range(1, 11))
    assert len(set(lengths.tolist())) > 5
    drawn = start[:1]
    assert ACTION_LOW <= float(drawn.min()) < 0.7
    assert 1.5 < float(drawn.max()) <= ACTION_HIGH
    differences = obs[0, names.index("sensors")] - obs[0, 0]
    assert float(differences.std()) == pytest.approx(0.01, rel=0.1)
    assert torch.equal(obs[0, 1], obs[0, 0])


def test_what_is_no_measurement_has_no_noise_of_sensors() -> None:
    env = wv.make_vec("Walker-v0", "mini", 2, obs="voxel", device="cpu", auto_reset=False)
    seen = []
    disturbed = Disturbed(lambda obs: seen.append(obs) or torch.ones(2, env.num_actions), env, ["sensors"], seed=0)
    obs, _ = env.reset()
    disturbed(obs)
    (grid,) = env.voxels.values()
    noisy = grid.cells(seen[0]) != grid.cells(obs)
    assert noisy.all((0, 1)).tolist() == noisy.any((0, 1)).tolist() == [True] * 16 + [False] * 9
    assert bool((seen[0] != obs)[:, grid.place.stop :].all())


def test_padding_has_no_noise_of_sensors() -> None:
    env = wv.make_vec("Walker-v0", ["mini", "walker"], 4, device="cpu", auto_reset=False)
    seen = []
    disturbed = Disturbed(lambda obs: seen.append(obs) or torch.ones(4, env.num_actions), env, ["sensors"], seed=0)
    obs, _ = env.reset()
    disturbed(obs)
    assert torch.equal(seen[0] != obs, env.obs_mask[env.design_index])


def test_the_nominal_rows_of_all_protocols_are_the_same(short_walks: None) -> None:
    (nominal,) = wv.evaluate("zoo:BridgeWalker-v0", episodes=2)
    rows = wv.evaluate("zoo:BridgeWalker-v0", episodes=2, protocol="robust")
    assert [row.disturbance for row in rows] == list(PROTOCOLS["robust"])
    assert set(rows[0].returns) == {nominal.mean}
    assert all(np.ptp(row.returns) > 0 for row in rows[1:])
    (noise,) = wv.evaluate("zoo:BridgeWalker-v0", episodes=2, protocol="noise")
    assert noise.returns == rows[1].returns
    assert "noise" in repr(rows)
    assert "10 % quantile" in repr(rows)


def test_all_disturbances_have_the_episodes_of_one_where_a_task_draws() -> None:
    task = dataclasses.replace(get_task("BidirectionalWalker-v0"), max_episode_steps=4)
    bodies = [[[3, 3, 3], [4, 1, 4]], [[3, 3], [4, 3]]]

    def policy(obs: torch.Tensor) -> torch.Tensor:
        return 1.0 + 0.3 * torch.sin(obs[:, :5])

    how = {"task": task, "design": bodies, "episodes": 8, "device": "cpu"}
    rows = wv.evaluate(policy, protocol="robust", **how)
    for row in rows:
        (alone,) = wv.evaluate(policy, protocol=row.disturbance, **how)
        assert alone.returns == row.returns


def test_each_disturbance_has_as_many_episodes_of_every_body() -> None:
    with refused(ConfigError, "5 bodies need a multiple of that of episodes; got 2"):
        wv.evaluate(lambda obs: obs, "Walker-v0", [[[3, 3]]] * 5, episodes=2, protocol="robust", device="cpu")


def short(policy: object, protocol: str) -> wv.PolicyTable:
    """Returns of a function in disturbed episodes of a few control steps."""
    task = dataclasses.replace(get_task("Walker-v0"), max_episode_steps=12)
    return wv.evaluate(policy, task, [[3, 3], [4, 4]], episodes=2, protocol=protocol, device="cpu")


@pytest.mark.parametrize("protocol", ["noise", "start"])
def test_actions_of_a_function_are_disturbed_as_they_are_taken(protocol: str) -> None:
    (whole,) = short(lambda obs: torch.ones((2, 4), dtype=torch.long), protocol)
    (same,) = short(lambda obs: torch.ones((2, 4)), protocol)
    assert whole.returns == same.returns
    (beyond,) = short(lambda obs: torch.full((2, 4), 9.0), protocol)
    (largest,) = short(lambda obs: torch.full((2, 4), 1.6), protocol)
    assert beyond.returns == largest.returns


@pytest.mark.parametrize("protocol", ["nominal", "noise", "start"])
@pytest.mark.parametrize(
    ("policy", "words"),
    [
        (lambda obs: torch.ones(4), "got [4]"),
        (lambda obs: torch.ones((1, 4)), "got [1, 4]"),
        (lambda obs: None, "tensor or array of numbers"),
    ],
)
def test_actions_of_a_function_are_checked_in_disturbed_episodes_too(policy: object, protocol: str, words: str) -> None:
    with refused(wv.ActionError, words):
        short(policy, protocol)


def test_a_gait_has_no_sensors(short_walks: None) -> None:
    rows = wv.evaluate("zoo:Jumper-v0", episodes=2, protocol="robust")
    assert [row.disturbance for row in rows] == ["nominal", "noise", "sticky", "start"]
    with pytest.raises(ConfigError):
        wv.evaluate("zoo:Jumper-v0", protocol="sensors")
    with pytest.raises(ConfigError):
        wv.evaluate("zoo:Jumper-v0", protocol="stiky")


@pytest.mark.usefixtures("narrow_packs")
def test_a_robust_gait_is_worth_what_its_policy_gets_in_the_same_copies() -> None:
    (candidate,) = candidates(1)
    where = dataclasses.replace(factory(), protocol="noise")
    how = GaitEvaluator(where, Gaits(gaits=4, passes=1, beam=4, rounds=1, stages=2), episodes=COPIES)
    (outcome,) = how.evaluate([candidate], {})
    policy = Policy(spec_of(outcome.spec), outcome.policy).double()
    where = dataclasses.replace(factory(), obs="timed").computed(lanes=8)
    env = where.make([candidate.body], COPIES, [candidate_seed(0, 0)], auto_reset=False)
    found = evaluator(env, 0, "robust")(policy)
    assert outcome.fitness == pytest.approx(found.mean_return, abs=1e-5)
    assert np.ptp(found.returns.numpy()) > 0


def test_a_training_chooses_by_disturbed_copies(tmp_path: Path, short_walks: None) -> None:
    small = {"design": "mini", "num_envs": 8, "max_iterations": 2, "eval_interval": 1, "device": "cpu"}
    run = wv.train(protocol="noise", folder=tmp_path / "run", progress=False, **small)
    env = wv.make_vec("Walker-v0", "mini", COPIES, seed=0, device="cpu", auto_reset=False)
    policy = read_policy(run.folder / "model_best.pt").double()
    assert run.best_return == evaluator(env, 0, "robust")(policy).mean_return
    assert run.best_return != evaluator(env, 0)(policy).mean_return


@pytest.mark.parametrize(
    ("task", "episodes"),
    [
        ("Catcher-v0", 3),  # a task that draws something in each episode
        *((t, 1) for t in zoo_tasks()[::8]),
        *(pytest.param(t, EPISODES, marks=pytest.mark.slow) for t in zoo_tasks()),
    ],
)
def test_a_robot_gets_the_recorded_returns_under_noise(task: str, episodes: int) -> None:
    robot = wv.zoo(task)
    recorded = robot.about["noise"]["returns"]
    (row,) = wv.evaluate(f"zoo:{task}", protocol="noise", episodes=episodes, device="cpu")
    assert np.round(row.returns, DIGITS).tolist() == recorded[:episodes]
    assert (len(recorded), robot.robust_return) == (EPISODES, pytest.approx(np.mean(recorded)))
