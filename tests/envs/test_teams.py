"""Several robots in one world, each with a body and actions of its own."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch

from warpvox.design import example_design, sample_design
from warpvox.envs.adapters.gym import register_task
from warpvox.envs.registry import get_task
from warpvox.envs.spec import TaskSpec, observes, rewards, terminates
from warpvox.envs.terms.observations import separation, shape, velocity
from warpvox.envs.terms.rewards import displacement, gap
from warpvox.envs.terms.terminations import beyond
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.envs.worlds import block
from warpvox.errors import DesignError, WorldError

ALONE = TaskSpec(
    id="Alone-v0",
    summary="Walk.",
    objects=(block("ground", 60, 1),),
    robot_cell=(2, 1),
    max_episode_steps=50,
    observations=(observes(velocity), observes(shape)),
    rewards=(rewards(displacement, axis="x"),),
    terminations=(terminates(beyond, axis="x", limit=5.0, bonus=1.0),),
)
TEAM = replace(
    ALONE,
    id="Team-v0",
    partners={"mate": (30, 1), "third": (45, 1)},
    observations=(
        *ALONE.observations,
        observes(velocity, "mate"),
        observes(shape, "mate"),
        observes(separation, "mate", other="robot"),
    ),
    rewards=(rewards(displacement, axis="x"), rewards(gap, "mate", weight=-1.0, other="robot", axis="x")),
)
A, B, C = example_design("walker"), sample_design((4, 3), seed=3), np.array([[3, 4]])


def make(task: TaskSpec, designs: object, num_envs: int = 1, **options) -> VoxelVecEnv:
    defaults = {"device": "cpu", "dtype": "float64", "threads": 1, "lanes": 1}
    return make_vec(task, designs, num_envs, **(defaults | options))


def wave(count: int, step: int, phase: float) -> np.ndarray:
    return 1.1 + 0.5 * np.sin(0.4 * step + phase + np.arange(count))


def test_robots_far_apart_move_as_if_they_were_alone() -> None:
    designs = [{"robot": A, "mate": B, "third": C}, {"third": A, "robot": C, "mate": B}]
    team = make(TEAM, designs, 2)
    assert [sorted(columns) for columns in team.action_columns] == [["mate", "robot", "third"]] * 2
    assert team.action_mask.sum(1).tolist() == [sum(int((body >= 3).sum()) for body in d.values()) for d in designs]
    team.reset()
    places = {"robot": 2, "mate": 30, "third": 45}
    alone = [
        {name: make(replace(ALONE, robot_cell=(places[name], 1)), [body]) for name, body in design.items()}
        for design in designs
    ]
    for step in range(20):
        actions = np.ones((2, team.num_actions))
        for number, columns in enumerate(team.action_columns):
            for phase, name in enumerate(places):
                own = wave(columns[name].stop - columns[name].start, step, phase)
                actions[number, columns[name]] = own
                alone[number][name].step(own[None])
        team.step(actions)
        for number in range(2):
            for name, env in alone[number].items():
                mine = env.sim.object_positions("robot")[0]
                assert torch.equal(team.sim.object_positions(name)[number, : len(mine)], mine), (step, number, name)


def test_rewards_and_observations_may_be_about_any_robot() -> None:
    env = make(TEAM, [{"robot": A, "mate": B, "third": C}])
    obs, _ = env.reset()
    before = {name: env.sim.com(name)[0] for name in ("robot", "mate")}
    for step in range(10):
        obs, reward, _, _, info = env.step(wave(env.num_actions, step, 0.0)[None])
        now = {name: env.sim.com(name)[0] for name in before}
        places = env.obs_columns[0]
        assert obs[0, places["separation_mate_robot"]].tolist() == (now["mate"] - now["robot"]).tolist()
        assert places["shape_mate"].stop - places["shape_mate"].start == 2 * env.sim.num_points("mate")
        apart = [abs(float((p["mate"] - p["robot"])[0])) for p in (before, now)]
        assert float(info["reward_terms"]["gap_mate_robot_x"]) == pytest.approx(apart[0] - apart[1], abs=1e-12)
        assert float(reward) == pytest.approx(
            float((now["robot"] - before["robot"])[0]) + apart[0] - apart[1], abs=1e-12
        )
        before = now


def test_one_body_is_meant_for_all_robots() -> None:
    env = make(TEAM, [B])
    assert all(np.array_equal(body, B) for body in env.designs[0].values())
    assert list(env.designs[0]) == ["robot", "mate", "third"]
    assert make(TEAM, "walker").num_actions == 3 * int((A >= 3).sum())
    assert make(TEAM, {"robot": A, "mate": B, "third": C}).num_designs == 1


def test_a_grid_of_voxels_for_every_robot() -> None:
    env = make(TEAM, [{"robot": A, "mate": B, "third": C}, {"robot": C, "mate": A, "third": B}], 2, obs="voxel")
    assert [(grid.rows, grid.columns) for grid in env.voxels.values()] == [(5, 5), (5, 5), (4, 3)]
    assert list(env.obs_columns[0])[:4] == ["voxels_robot", "voxels_mate", "voxels_third", "velocity_robot"]
    assert "shape_mate" not in env.obs_columns[0]
    values = {name: torch.rand(2, grid.rows * grid.columns) for name, grid in env.voxels.items()}
    actions = sum(grid.actions(values[name]) for name, grid in env.voxels.items())
    obs, _ = env.reset()
    for number in range(2):
        for name, place in env.action_columns[number].items():
            body = env.designs[number][name]
            kinds = env.voxels[name].cells(obs)[number, :, 16:21].argmax(1)
            assert int((kinds > 0).sum()) == int((body > 0).sum())
            assert torch.equal(actions[number, place], values[name][number][kinds >= 3])


def test_gymnasium_takes_teams() -> None:
    name = register_task(TEAM, "team")
    bodies = {"robot": A, "mate": B, "third": C}
    env = gymnasium.make(name, body=bodies)
    assert sorted(env.unwrapped.body) == ["mate", "robot", "third"]
    assert env.reset()[0] in env.observation_space
    batch = gymnasium.make_vec(name, num_envs=2, body=bodies)
    assert batch.single_observation_space == env.observation_space
    assert batch.single_action_space == env.action_space


def test_mistakes_are_named() -> None:
    with pytest.raises(DesignError):
        make(TEAM, [{"robot": A, "mat": B, "third": C}])
    with pytest.raises(DesignError):
        make(TEAM, [{"robot": A}])
    with pytest.raises(DesignError):
        make(get_task("Walker-v0"), [{"robot": A, "mate": B}])
    with pytest.raises(DesignError):
        make(TEAM, [B, {"robot": A, "mate": B, "third": [[1]]}], 2)
    with pytest.raises(WorldError):
        make(TEAM, [{"robot": A, "mate": np.full((1, 20), 3), "third": C}])


def test_teams_of_different_bodies_share_packs_and_may_change() -> None:
    """Fast arithmetic; each team against a batch of it alone, bit for bit."""
    options = dict(dtype="float32", lanes=8, auto_reset=False)
    teams = [
        {name: sample_design((4, 4), seed=10 * k + n) for n, name in enumerate(("robot", "mate", "third"))}
        for k in range(8)
    ]
    env = make(TEAM, teams[:4] * 2, 8, grid=(4, 4), **options)
    mask = torch.arange(8) >= 4
    env.set_designs(teams[4:], mask)
    assert env.sim._state.packs == 1
    env.reset()
    draws = np.random.default_rng(0).uniform(0.6, 1.6, (4, 8, env.num_actions)).astype(np.float32)
    seen = [env.step(torch.as_tensor(move))[0] for move in draws]
    for k in (1, 6):
        alone = make(TEAM, [teams[k]], 8, **options)
        alone.reset()
        for move, found in zip(draws, seen, strict=True):
            own = torch.as_tensor(move[k, : alone.num_actions]).expand(8, -1)
            assert torch.equal(found[k, : alone.num_obs], alone.step(own)[0][k])
