"""Random tasks: every environment draws from a stream of its own, and what it draws can be set."""

from itertools import pairwise

import numpy as np
import pytest
import torch

from warpvox.envs.random_stream import RandomStream
from warpvox.envs.terms import goals
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ConfigError


def make(task: str, num_envs: int = 4, designs: object = None, **options) -> VoxelVecEnv:
    return make_vec(task, designs, num_envs, **({"device": "cpu", "dtype": "float64", "threads": 1} | options))


def act(env: VoxelVecEnv):
    return env.step(torch.ones(env.num_envs, env.num_actions))


def drawn(env: VoxelVecEnv) -> torch.Tensor:
    return torch.cat([value for name, value in env.memory.items() if name != "goal"], dim=1)


RANDOM = pytest.mark.parametrize("task", ["BidirectionalWalker-v0", "Catcher-v0"])


def test_numbers_are_uniform_and_in_range() -> None:
    draws = RandomStream(3, 500, "cpu")
    numbers = draws.integers(-6, 5, 100)
    counts = torch.bincount((numbers + 6).flatten())
    assert (int(numbers.min()), int(numbers.max())) == (-6, 4)
    expected = numbers.numel() / 11
    assert float(((counts - expected) ** 2 / expected).sum()) < 30  # chi squared, 10 degrees of freedom
    rows = numbers.double() - numbers.double().mean()
    assert abs(float((rows[:, 1:] * rows[:, :-1]).mean() / rows.var())) < 0.02
    assert abs(float((rows[1:] * rows[:-1]).mean() / rows.var())) < 0.02


def test_a_stream_depends_on_seed_environment_episode_and_place_alone() -> None:
    many, few = RandomStream(3, 50, "cpu"), RandomStream(3, 2, "cpu")
    assert torch.equal(many.integers(0, 1 << 30, 9)[:2], few.integers(0, 1 << 30, 9))
    few.episode += 1
    later = few.rewind().integers(0, 1 << 30, 9)
    assert not torch.equal(later, many.rewind().integers(0, 1 << 30, 9)[:2])
    parts = torch.cat([few.rewind().integers(0, 1 << 30, 4), few.integers(0, 1 << 30, 5)], dim=1)
    assert torch.equal(later, parts)
    assert not torch.equal(later, RandomStream(4, 2, "cpu").integers(0, 1 << 30, 9))


@RANDOM
def test_each_reset_draws_anew_and_seeds_repeat(task: str) -> None:
    env, twin = make(task, seed=5), make(task, 8, seed=5)
    seen = []
    for _ in range(4):
        env.reset()
        twin.reset()
        seen.append(drawn(env))
        assert torch.equal(drawn(twin)[:4], seen[-1])
    assert all(not torch.equal(a, b) for a, b in pairwise(seen))
    assert len({tuple(row) for row in seen[0].tolist()}) > 1
    env.reset(seed=5)
    assert torch.equal(drawn(env), seen[0])
    env.reset(seed=6)
    assert not torch.equal(drawn(env), seen[0])


@RANDOM
def test_only_environments_that_end_are_drawn_anew(task: str) -> None:
    env = make(task, seed=5, max_episode_steps=4)
    env.reset()
    env.episode_length[1] = 2
    first = drawn(env)
    act(env)
    assert torch.equal(drawn(env), first)
    _, _, _, truncated, _ = act(env)
    assert truncated.tolist() == [False, True, False, False]
    now = drawn(env)
    assert (now != first).any(1).tolist() == [False, True, False, False]
    again = make(task, 2, seed=5)
    again.reset()
    again.reset()
    assert torch.equal(drawn(again)[1], now[1])


def test_what_is_drawn_can_be_set() -> None:
    env = make("Catcher-v0", 2)
    env.reset(memory={"offset": [[-6, 0], [4, 5]]})
    assert env.memory["offset"].tolist() == [[-6, 0], [4, 5]]
    walker = make("BidirectionalWalker-v0", 1)
    walker.reset(memory={"goals": [[40, 20, 45]]})
    assert walker.memory["goals"][0, :4].tolist() == [40, 20, 45, 0]


@pytest.mark.parametrize(
    ("task", "memory"),
    [
        ("Walker-v0", {"goals": [[30]]}),
        ("Catcher-v0", {"offsets": [[0, 0]]}),
        ("Catcher-v0", {"offset": [[0, 0, 0]]}),
        ("Catcher-v0", {"offset": [[float("nan"), 0]]}),
        ("Catcher-v0", {"offset": torch.tensor([[0.0, float("nan")]])}),
        ("Catcher-v0", [1]),
    ],
)
def test_what_cannot_be_set_is_refused(task: str, memory: dict) -> None:
    with pytest.raises(ConfigError):
        make(task, 1).reset(memory=memory)


def test_goals_go_on_until_the_way_is_long_enough() -> None:
    draws = RandomStream(1, 300, "cpu")
    lists = goals.draw_goals(draws, 20, 50, start=35, way=100).tolist()
    for row in lists:
        given = [goal for goal in row if goal]
        assert row[: len(given)] == given
        assert all(20 <= goal < 50 for goal in given)
        ways = np.abs(np.diff([35, *given]))
        assert ways.sum() >= 100
        assert ways[:-1].sum() < 100
    assert (goals.draw_goals(draws, 20, 50, start=35, way=None) > 0).all()
