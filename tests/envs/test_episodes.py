"""Rewards, ends and resets of the tasks on the puppet, where every threshold can be met."""

from __future__ import annotations

import pytest
import torch

from warpvox.envs.registry import get_task
from warpvox.envs.vec_env import VoxelVecEnv


def make(puppet, task: str, points: list[int] = (4, 4, 6), **options) -> VoxelVecEnv:
    spec = get_task(task).under(options.get("rules", "evogym"))
    objects = tuple(obj.name for obj in spec.objects if not obj.is_static)
    sim = puppet(list(points), objects)
    return VoxelVecEnv(spec, [None] * len(points), sim, **options)


def act(env: VoxelVecEnv):
    return env.step(torch.ones(env.num_envs, env.num_actions))


def push(env: VoxelVecEnv, name: str, *per_env: tuple[float, float]) -> None:
    env.sim.push[name] = torch.tensor(per_env, dtype=torch.float64)


def test_goal_and_tilt_may_fire_in_one_step(puppet) -> None:
    env = make(puppet, "UpStepper-v0", [4])
    push(env, "robot", (10.0, 0.0))
    env.sim.turn[:] = torch.pi
    _, reward, terminated, _, info = act(env)
    assert terminated.all()
    assert float(reward) == pytest.approx(10.0 + 2.0 - 3.0, abs=1e-12)
    parts = {name: float(value) for name, value in info["reward_terms"].items()}
    assert parts["beyond_robot_x"] == 2.0
    assert parts["tilted_robot"] == -3.0


def test_folding_costs_three_and_shows_the_observation_before(puppet) -> None:
    env = make(puppet, "Walker-v0")
    push(env, "robot", (0.1, 0.0), (0.1, 0.0), (0.1, 0.0))
    before, _, _, _, _ = act(env)
    env.sim.fold[1] = True
    obs, reward, terminated, _, info = act(env)
    assert terminated.tolist() == [False, True, False]
    assert info["unstable"].tolist() == [False, True, False]
    assert reward.tolist() == pytest.approx([0.1, -3.0, 0.1], abs=1e-12)
    assert torch.equal(info["final_obs"][1], before[1])
    assert torch.equal(env.sim.points["robot"][1], env.sim.home["robot"][1])
    assert torch.isfinite(obs).all()


def test_tests_for_the_end_look_at_the_old_state_when_the_step_was_stopped(puppet) -> None:
    env = make(puppet, "Walker-v0", [4])
    env.sim.home["robot"] += 20.0  # beyond the goal before any step
    env.reset()
    env.sim.fold[:] = True
    _, reward, terminated, _, _ = act(env)
    assert terminated.all()
    assert float(reward) == -3.0 + 1.0


@pytest.mark.parametrize("looks", [True, False])
def test_ended_environments_begin_anew_in_the_same_step(puppet, looks: bool) -> None:
    env = make(puppet, "Walker-v0")
    env._on_cpu = looks  # False is how it runs where looking at a mask would wait for the device
    first, _ = env.reset()
    push(env, "robot", (4.0, 0.0), (0.1, 0.0), (6.0, 0.0))
    lengths, returns = [], []
    for _ in range(5):
        obs, _, terminated, _, info = act(env)
        assert torch.equal(env.episode_length == 0, terminated)
        # velocities aside, an ended environment shows its first observation again
        assert torch.equal(obs[terminated][:, 2:], first[terminated][:, 2:])
        done = info["episode"]["done"]
        lengths.append(info["episode"]["length"][done].tolist())
        returns.append(info["episode"]["return"][done].tolist())
    assert lengths == [[], [2.0], [3.0], [2.0], []]
    assert returns[1] == pytest.approx([13.0])
    assert returns[2] == pytest.approx([13.0])
    assert returns[3] == pytest.approx([13.0])


def test_the_first_reward_after_a_reset_starts_from_the_new_state(puppet) -> None:
    env = make(puppet, "Walker-v0", [4])
    push(env, "robot", (10.0, 0.0))
    act(env)
    push(env, "robot", (0.25, 0.0))
    assert float(act(env)[1]) == pytest.approx(0.25, abs=1e-12)


def test_the_time_limit_truncates(puppet) -> None:
    env = make(puppet, "Walker-v0")
    env.episode_length[:] = torch.tensor([498, 499, 0])
    _, _, terminated, truncated, info = act(env)
    assert not terminated.any()
    assert truncated.tolist() == [False, True, False]
    assert env.episode_length.tolist() == [499, 0, 1]
    assert info["episode"]["length"].tolist() == [499.0, 500.0, 1.0]


def test_without_auto_reset_ended_environments_stay_as_they_ended(puppet) -> None:
    env = make(puppet, "Walker-v0", auto_reset=False)
    push(env, "robot", (10.0, 0.0), (0.1, 0.0), (0.1, 0.0))
    end, reward, terminated, _, info = act(env)
    assert float(reward[0]) == pytest.approx(11.0)
    assert info["episode"]["done"].tolist() == [True, False, False]
    for _ in range(3):
        obs, reward, terminated, truncated, info = act(env)
        assert torch.equal(obs[0, 2:], end[0, 2:])
        assert terminated.tolist() == [True, False, False]
        assert reward.tolist() == pytest.approx([0.0, 0.1, 0.1], abs=1e-12)
        assert not truncated.any()
        assert not info["episode"]["done"].any()
        assert not any(part[0] for part in info["reward_terms"].values())
    assert info["episode"]["length"].tolist() == [1.0, 4.0, 4.0]
    assert info["episode"]["return"].tolist() == pytest.approx([11.0, 0.4, 0.4])
    env.reset()
    _, reward, terminated, _, _ = act(env)
    assert float(reward[0]) == pytest.approx(11.0)


def test_without_auto_reset_a_folded_environment_is_unstable_once(puppet) -> None:
    env = make(puppet, "Walker-v0", [4, 4], auto_reset=False)
    env.sim.fold[0] = True
    assert act(env)[1].tolist() == [-3.0, 0.0]
    _, reward, terminated, _, info = act(env)
    assert reward.tolist() == [0.0, 0.0]
    assert terminated.tolist() == [True, False]
    assert not info["unstable"].any()


def test_without_auto_reset_the_time_limit_freezes(puppet) -> None:
    env = make(puppet, "Walker-v0", [4], auto_reset=False)
    env.episode_length[:] = 499
    push(env, "robot", (0.1, 0.0))
    for _ in range(2):
        _, _, terminated, truncated, _ = act(env)
        assert truncated.all()
        assert not terminated.any()
    assert env.episode_length.tolist() == [500]


def test_returned_tensors_belong_to_the_caller(puppet) -> None:
    env, twin = make(puppet, "UpStepper-v0"), make(puppet, "UpStepper-v0")
    for e in (env, twin):
        push(e, "robot", (0.1, 0.2), (0.3, 0.1), (3.0, 0.0))
    for _ in range(4):
        ours, theirs = act(env), act(twin)
        for a, b in zip(ours[:4], theirs[:4], strict=True):
            assert torch.equal(a, b)
            a.fill_(1)
        for a in (*ours[4]["reward_terms"].values(), ours[4]["unstable"], *ours[4]["episode"].values()):
            a.fill_(1)
