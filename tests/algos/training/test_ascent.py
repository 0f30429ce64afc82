"""Training by gradients through the physics: it climbs, resumes exactly, and refuses what has no derivative."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning import assert_same_weights, ppo_settings, small_env

from warpvox.algos.checkpoints.policy import policy_of
from warpvox.algos.evaluate import evaluator
from warpvox.algos.policies.registry import layout_for
from warpvox.algos.training.ascent import AscentRunner, Targets
from warpvox.algos.training.bodies import Bodies, draw_bodies
from warpvox.algos.training.runner import Schedule, adapt
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import ConfigError
from warpvox.runs import STATE

ENVS, SHAPE, STEPS = 8, (3, 3), 40
SETTINGS = {"width": 8, "heads": 2, "layers": 1}

pytestmark = pytest.mark.usefixtures("one_thread")


def make_env(bodies: list, auto_reset: bool = True, **changes: object) -> VoxelVecEnv:
    options = dict(max_episode_steps=60, obs="timed_voxel", grid=SHAPE, lanes=8, auto_reset=auto_reset) | changes
    return small_env(len(bodies), designs=bodies, **options)


def make_runner(
    refresh: str = "none",
    total: int = 4,
    folder: Path | None = None,
    seed: int = 0,
    network: str = "cpg",
    schedule: str = "fixed",
    **changes: object,
) -> AscentRunner:
    torch.manual_seed(seed)
    pool = draw_bodies(12, SHAPE, np.random.default_rng(0))
    bodies = Bodies(pool[:ENVS], refresh, np.random.default_rng(seed))
    env = make_env(bodies.first(ENVS), **changes)
    settings = SETTINGS if network == "cpg" else {}
    voxels = {"network": network, "settings": settings, "layout": layout_for(network, env).dict()}
    ppo = ppo_settings(steps=STEPS, learning_rate=0.01, schedule=schedule, max_grad_norm=1.0)
    judge = evaluator(make_env(pool[-4:], auto_reset=False, **changes))
    return AscentRunner(adapt(env, ppo), ppo, Schedule(total, 100, total), folder, judge, voxels=voxels, bodies=bodies)


def test_returns_rise() -> None:
    runner, rows = make_runner(total=12, schedule="linear"), []
    runner.report = rows.append
    critic = [parameter.clone() for parameter in runner.alg.critic.parameters()]
    runner.run()
    returns = [row["return_mean"] for row in rows]
    assert returns[-1] > returns[0] + 0.01, returns
    assert rows[-1]["episodes"] == ENVS
    assert rows[-1]["steps"] == 12 * ENVS * STEPS
    assert rows[0]["learning_rate"] > rows[-1]["learning_rate"]
    assert np.isfinite(runner.last_return)
    assert all(torch.equal(one, two) for one, two in zip(critic, runner.alg.critic.parameters(), strict=True))


def test_the_rollout_is_what_the_policy_does() -> None:
    """Returns that are differentiated are those of the environment."""
    runner = make_runner()
    env = runner.env
    with torch.no_grad():
        rewards = [env.step(runner.alg.actor(env.get_observations()))[1] for _ in range(STEPS)]
    runner._collect()
    total = float(sum(rewards).mean()) / runner.ppo.reward_scale
    assert runner._found["return_mean"] == pytest.approx(total, abs=1e-6)


def test_targets_do_not_depend_on_how_steep_the_slopes_of_others_are(monkeypatch: pytest.MonkeyPatch) -> None:
    targets = []
    for factors in (torch.ones(ENVS), 10.0 ** torch.arange(ENVS)):
        runner = make_runner()
        returns, slope, stopped = runner._roll_out(*runner.alg.look(runner.env.reset())[1:], STEPS)
        found = returns, slope * factors[:, None, None], stopped
        monkeypatch.setattr(runner, "_roll_out", lambda *_, found=found: found)
        runner._collect()
        targets.append(runner._targets.state()["targets"])
    assert len(targets[0]) == ENVS
    assert torch.allclose(*targets)


def test_stopped_episodes_say_of_a_body_that_it_does_badly_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    runner = make_runner("performance")
    roll_out, stops = runner._roll_out, torch.arange(ENVS) < 3

    def stopped(*given: Any) -> tuple[torch.Tensor, ...]:
        returns, slope, _ = roll_out(*given)
        return returns.masked_fill(stops, 0.0), slope.masked_fill(stops[:, None, None], 0.0), stops

    monkeypatch.setattr(runner, "_roll_out", stopped)
    runner._improve()
    whole = runner.bodies._returns[3:]
    assert runner._found["return_mean"] == pytest.approx(whole.mean())
    assert runner.bodies._returns[:3].tolist() == [-3.0] * 3
    stops[:] = True
    runner._improve()
    runner._check(runner.logger.losses)  # no divergence
    assert np.isnan(runner._found["return_mean"])


@pytest.mark.parametrize("refresh", ["none", pytest.param("new", marks=pytest.mark.slow)])
def test_a_resumed_run_is_the_run_that_was_not_interrupted(tmp_path: Path, refresh: str) -> None:
    whole = make_runner(refresh)
    whole.run()
    make_runner(refresh, 2, tmp_path).run()
    second = make_runner(refresh, seed=5)
    second.resume(tmp_path / STATE)
    second.run()
    assert_same_weights(whole, second)
    assert whole.last_return == second.last_return


def test_weights_that_are_kept_are_those_of_the_body_and_of_what_was_learned() -> None:
    runner = make_runner()
    runner.run()
    actor, obs = runner.alg.actor.eval(), runner.env.reset()
    with torch.no_grad():
        first = actor(obs)
        assert torch.equal(actor(obs), first)
        later = obs.clone()
        later["policy"][:, -1] = 3.0
        assert not torch.equal(actor(later), first)
        runner.env.set_designs([np.full(SHAPE, 3, np.int8)], torch.arange(ENVS) == 0)
        changed = actor(runner.env.get_observations())
        assert not torch.equal(changed[0], first[0])
        assert torch.equal(changed[1:], first[1:])
        actor.train()
        for parameter in actor.network.parameters():
            parameter.mul_(0.5)
        assert not torch.equal(actor.eval()(obs), first)


def test_a_loaded_policy_that_is_trained_further_acts_by_what_it_has_learned() -> None:
    runner = make_runner()
    policy, obs = policy_of(runner.controller).requires_grad_(), runner.env.reset()["policy"]
    optimizer, known = torch.optim.SGD(policy.parameters(), 0.1), copy.deepcopy(policy.state_dict())
    exact = policy.in_float64().act(obs.numpy())
    first = policy.act(obs.numpy())
    assert np.array_equal(policy.in_float64().act(obs.numpy()), exact)  # not by weights in float32
    policy(obs).sum().backward()
    optimizer.step()
    assert not np.array_equal(policy.act(obs.numpy()), first)
    policy.load_state_dict(known)
    assert np.array_equal(policy.act(obs.numpy()), first)


def test_what_moves_does_not_matter() -> None:
    runner = make_runner()
    obs = runner.env.reset()
    with torch.no_grad():
        first = runner.alg.actor(obs)
        runner.env.step(torch.ones_like(first))
        moved = runner.env.get_observations()
        moved["policy"][:, -1] = obs["policy"][:, -1]
        assert torch.equal(runner.alg.actor(moved), first)


def test_what_has_no_derivative_is_refused() -> None:
    with pytest.raises(ConfigError, match="method=gradients trains policy=cpg"):
        make_runner(network="grid")
    with pytest.raises(ConfigError, match=r"those of AreaMaximizer-v0 are made of hull_area, too"):
        make_runner(task="AreaMaximizer-v0")
    with pytest.raises(ConfigError, match=r"those of BidirectionalWalker-v0 are made of memory, too"):
        make_runner(task="BidirectionalWalker-v0")
    with pytest.raises(ConfigError, match="the rewards of Lifter-v0 have no derivative by the actions"):
        make_runner(task="Lifter-v0")
    with pytest.raises(ConfigError, match="layout='lanes', got 'group'"):
        make_runner(layout="group", lanes=None)
    with pytest.raises(ConfigError, match="is more than an episode has, 5"):
        make_runner(max_episode_steps=5)
    with pytest.raises(ConfigError, match="which is not observed: it needs obs=timed"):
        make_runner(obs="voxel")


def numbered(*numbers: int) -> torch.Tensor:
    return torch.tensor([[[float(number)]] for number in numbers])


def content(targets: Targets) -> list[tuple[float, float]]:
    """Pairs of body and target, oldest first."""
    state = targets.state()
    return list(zip(state["bodies"].flatten().tolist(), state["targets"].flatten().tolist(), strict=True))


def test_the_last_stay_and_a_body_has_its_newest() -> None:
    targets = Targets(4)
    targets.add(numbered(1, 2, 3), numbered(10, 20, 30))
    targets.add(numbered(2, 4, 2), numbered(21, 40, 22))
    assert content(targets) == [(1, 10), (3, 30), (2, 22), (4, 40)]
    targets.add(numbered(5), numbered(50))
    assert content(targets) == [(3, 30), (2, 22), (4, 40), (5, 50)]
    assert len(targets) == 4
