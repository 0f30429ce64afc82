"""A simulation that diverges is ended alone: the others of its batch go on, equal to the last bit."""

from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from worlds import ground, world

from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.registry import get_task
from warpvox.envs.spec import terminates
from warpvox.envs.terms.terminations import beyond
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.kernels.state import UNSTABLE
from warpvox.simulation import Simulation
from warpvox.types import Physics

STEPS, AT, VICTIM, ENVS = 14, 5, 1, 5
BAD = {
    "nan position": ("pos", float("nan")),
    "infinite position": ("pos", float("-inf")),
    "far away": ("pos", 1.1e6),
    "nan velocity": ("vel", float("nan")),
    "infinite velocity": ("vel", float("inf")),
    "huge velocity": ("vel", 1e300),
    "fast": ("vel", -1.1e4),
    "nan displacement": ("true_vel", float("nan")),
}


def actions_of(env: Any, steps: int = STEPS) -> torch.Tensor:
    draw = torch.Generator().manual_seed(3)
    shape = (steps, env.num_envs, env.num_actions)
    return (0.6 + torch.rand(shape, generator=draw, dtype=torch.float64)).to(env.dtype)


def inject(sim: Simulation, kind: str, env: int = VICTIM, point: int = 2) -> None:
    name, value = BAD[kind]
    state = sim.state()
    state[name][env, point] = value
    sim.set_state(state)


def flat(result: tuple) -> dict[str, torch.Tensor]:
    obs, reward, terminated, truncated, info = result
    parts = {f"{group}/{name}": value for group in ("episode", "reward_terms") for name, value in info[group].items()}
    parts |= {name: info[name] for name in ("final_obs", "unstable", "diverged")}
    return parts | {"obs": obs, "reward": reward, "terminated": terminated, "truncated": truncated}


def play(env: VoxelVecEnv, actions: torch.Tensor, bad: str | None = None) -> list[dict[str, torch.Tensor]]:
    env.reset()
    rows = []
    for step, action in enumerate(actions):
        if bad and step == AT:
            inject(env.sim, bad)
        rows.append(flat(env.step(action)) | env.sim.state())
    return rows


def same(a: torch.Tensor, b: torch.Tensor, rows: list[int]) -> bool:
    """Equal bit for bit: as bytes, so that NaN and the sign of 0 count."""
    return a[rows].numpy().tobytes() == b[rows].numpy().tobytes()


@pytest.mark.parametrize(
    ("lanes", "dtype", "auto_reset"),
    [
        *((1, "float32", True), (8, "float32", False), (32, "float32", True)),
        *((1, "float64", False), (8, "float64", True)),
        pytest.param(32, "float64", False, marks=pytest.mark.slow),
    ],
)
def test_one_environment_ends_and_the_others_do_not_notice(lanes: int, dtype: str, auto_reset: bool) -> None:
    def make() -> VoxelVecEnv:
        return make_vec(
            "Walker-v0", num_envs=ENVS, device="cpu", lanes=lanes, dtype=dtype, auto_reset=auto_reset, threads=1
        )

    env = make()
    actions, others = actions_of(env), [k for k in range(ENVS) if k != VICTIM]
    calm = play(env, actions)
    first = make().reset()[0]
    fresh = play(make(), actions[AT + 1 :])
    for bad in BAD:
        rows = play(make(), actions, bad)
        for ours, theirs in zip(rows, calm, strict=True):
            assert all(same(ours[name], theirs[name], others) for name in calm[0] if name != "drift"), bad
        assert all(torch.isfinite(value).all() for row in rows for value in row.values()), bad
        hit = rows[AT]
        for name in ("unstable", "diverged", "terminated", "episode/done"):
            assert hit[name].tolist() == [k == VICTIM for k in range(ENVS)], (bad, name)
        assert hit["reward"][VICTIM] == -3.0 == hit["reward_terms/unstable"][VICTIM]
        # what was bad from the start of the step on cannot be shown: it stands at time 0
        assert torch.equal(hit["final_obs"][VICTIM], first[VICTIM])
        assert not any(bool(row["diverged"].any()) for step, row in enumerate(rows) if step != AT)
        for ours, new in zip(rows[AT + 1 :], fresh, strict=True):
            if auto_reset:
                assert all(same(ours[name], new[name], [VICTIM]) for name in new), bad
            else:
                assert ours["terminated"][VICTIM]
                assert ours["reward"][VICTIM] == 0.0
                assert same(ours["obs"], hit["obs"], [VICTIM])


def stiff() -> Physics:
    """Soft cells far beyond the stability of the integrator, which bodies without them never notice."""
    return Physics.preset("evogym", soft_main=1e12, soft_structural=1e12)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_an_explosion_within_a_step_ends_with_the_observation_before_it(dtype: str) -> None:
    bodies = [np.array([[3, 2], [4, 3]]), np.array([[3, 4], [4, 3]])]

    def make(designs: list[np.ndarray], envs: int) -> VoxelVecEnv:
        return make_vec("Walker-v0", designs, envs, device="cpu", lanes=8, dtype=dtype, physics=stiff(), threads=1)

    env, alone = make(bodies, 6), make(bodies[1:], 3)
    actions = actions_of(env)
    before, _ = env.reset()
    rest, _ = alone.reset()
    assert torch.equal(before[3:], rest)
    ends = 0
    for action in actions:
        obs, reward, terminated, _, info = env.step(action)
        expected = alone.step(action[3:])
        assert same(obs, torch.cat([obs[:3], expected[0]]), [3, 4, 5])
        assert torch.equal(reward[3:], expected[1])
        gone = info["diverged"]
        assert not gone[3:].any()
        assert torch.equal(info["final_obs"][gone], before[gone])
        assert bool((reward[gone] == -3.0).all())
        assert bool(terminated[gone].all())
        assert torch.isfinite(obs).all()
        before, ends = obs, ends + int(gone.sum())
    assert ends >= 3


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_those_on_the_floor_of_an_empty_world_do_not_notice(dtype: str) -> None:
    # The floor at y = 0 is a force that whole packs take or do not: a NaN in one lane must not decide for all.
    floorless = world(12, 8, robot=([[3, 4], [4, 3]], 4, 0))

    def run(bad: str | None) -> list[torch.Tensor]:
        sim = Simulation([floorless] * 8, device="cpu", lanes=8, dtype=dtype, threads=1)
        rows = []
        for step in range(20):
            if bad and step == 6:
                inject(sim, bad)
            sim.step(torch.full((8, sim.num_actions), 1.6 if step % 4 < 2 else 0.6))
            rows.append(sim.state()["pos"])
        return rows

    calm = run(None)
    for bad in BAD:
        assert all(same(a, b, [0, 2, 3, 4, 5, 6, 7]) for a, b in zip(run(bad), calm, strict=True)), bad


@pytest.mark.parametrize(
    ("how", "dtype"),
    [("explodes", "float32"), ("is torn", "float64"), ("collapses", "float32"), ("collapses", "float64")],
)
def test_what_overlaps_everywhere_does_not_take_the_room_for_candidates(how: str, dtype: str) -> None:
    load = np.full((3, 12), 2), 22, 22
    made = world(60, 60, ground=ground(60, 2), robot=(np.full((20, 20), 3), 20, 2), load=load)
    noise = 2 * torch.rand(4000, generator=torch.Generator().manual_seed(0), dtype=torch.float64) - 1

    def run(bad: bool) -> tuple[list[torch.Tensor], bool]:
        sim = Simulation([made] * 3, device="cpu", lanes=8, dtype=dtype, threads=1)
        rows, stopped = [], False
        for step in range(4):
            if bad and step == 1:
                state = sim.state()
                length = state["pos"].shape[1]
                name, value = {"explodes": ("vel", 9e3), "is torn": ("pos", 40.0), "collapses": ("pos", 1e-3)}[how]
                state[name][VICTIM] = 3.0 + value * noise[:length]  # sound, but not for long
                sim.set_state(state)
            sim.step(torch.full((3, sim.num_actions), 1.6 if step % 2 else 0.6))
            stopped = stopped or bool(sim.unstable[VICTIM])
            assert not sim.overflow[[0, 2]].any()
            rows.append(sim.state()["pos"])
        return rows, stopped

    (calm, never), (rows, stopped) = run(False), run(True)
    assert stopped
    assert not never
    assert all(same(a, b, [0, 2]) for a, b in zip(rows, calm, strict=True))


def test_actions_that_are_not_finite_stop_an_environment_where_they_cannot_be_looked_at() -> None:
    env = make_vec("Walker-v0", num_envs=3, device="cpu", threads=1)
    before, _ = env.reset()
    actions = torch.ones((3, env.num_actions))
    env.sim.take(actions)
    for number, value in enumerate((float("nan"), float("inf"))):
        env.sim.action_buffer[number, 0] = value  # as take leaves them on CUDA
    obs, reward, terminated, _, info = env._step_on_device()
    assert info["diverged"].tolist() == terminated.tolist() == [True, True, False]
    assert reward[:2].tolist() == [-3.0, -3.0]
    assert torch.equal(info["final_obs"][:2], before[:2])
    assert torch.isfinite(obs).all()


def test_tests_for_the_end_look_at_the_old_state_when_the_step_was_stopped() -> None:
    beyond_at_once = terminates(beyond, axis="x", limit=0.0, bonus=1.0)
    env = make_vec(replace(get_task("Walker-v0"), terminations=(beyond_at_once,)), num_envs=2, device="cpu", threads=1)
    inject(env.sim, "nan velocity")
    assert env.step(torch.ones((2, env.num_actions)))[1].tolist() == [pytest.approx(1.0, abs=0.01), -3.0 + 1.0]


def test_self_folding_costs_what_the_task_says() -> None:
    env = make_vec("Walker-v0", num_envs=2, device="cpu", threads=1)
    env.sim.array("status").view(-1)[env.sim.slot[0]] = UNSTABLE
    env._outcomes.count()
    found, terms = env._outcomes.score([torch.zeros(2)], [torch.zeros(2) > 0], auto_reset=False)
    assert (terms["unstable"].tolist(), found["terminated"].tolist()) == ([-3.0, 0.0], [True, False])


def test_speeds_of_a_fall_without_end_are_sound() -> None:
    # gravity / drag = 1100: nothing that falls is faster, and what is as fast must not be stopped
    sim = Simulation([world(5, 5, robot=([[3]], 2, 2))], device="cpu", dtype="float64")
    state = sim.state()
    state["pos"][:, 1::2] += 5000.0
    state["vel"][:, 1::2] = -1100.0
    sim.set_state(state)
    for _ in range(100):
        sim.step(np.ones((1, 1)))
        assert not sim.diverged.any()
    assert float(sim.velocity("robot")[0, 1]) == pytest.approx(-1100.0, rel=1e-9)


def test_gymnasium_says_what_has_happened() -> None:
    single = gymnasium.make("warpvox/Walker-v0")
    first, _ = single.reset()
    inject(single.unwrapped.sim, "nan velocity", env=0)
    obs, reward, terminated, truncated, info = single.step(single.action_space.high)
    assert (terminated, truncated, reward) == (True, False, -3.0)
    assert info["unstable"] is True
    assert info["diverged"] is True
    assert info["reward_terms/displacement_robot_x"] == 0.0
    np.testing.assert_array_equal(obs, first)
    again, reward, *ended, last = single.unwrapped.step(single.action_space.low)  # all is over
    assert (reward, ended, last) == (0.0, [True, False], dict.fromkeys(info, 0))
    np.testing.assert_array_equal(again, obs)

    many = gymnasium.make_vec("warpvox/Walker-v0", num_envs=3, threads=1)
    many.reset()
    inject(many.unwrapped.vec.sim, "infinite position")
    obs, reward, terminated, _, infos = many.step(np.ones(many.action_space.shape))
    assert terminated.tolist() == infos["diverged"].tolist() == [False, True, False]
    np.testing.assert_array_equal(obs[VICTIM], first)
    assert reward[VICTIM] == -3.0
    assert np.isfinite(obs).all()


def test_the_logs_of_training_count_it_and_stay_finite() -> None:
    env = RslRlVecEnv(make_vec("Walker-v0", num_envs=4, device="cpu", threads=1), reward_gamma=0.99)
    env.step(torch.zeros((4, env.num_actions)))
    inject(env.env.sim, "nan position")
    _, rewards, dones, extras = env.step(torch.zeros((4, env.num_actions)))
    assert torch.isfinite(rewards).all()
    assert dones.tolist() == [False, True, False, False]
    assert not extras["time_outs"].any()
    assert extras["log"]["Episode/diverged"] == extras["log"]["Episode/unstable"] == 0.25
    assert all(torch.isfinite(value) for value in extras["log"].values())
    again = env.state()
    episodes = env.pop_episodes()
    assert (episodes["episodes"], episodes["unstable"], episodes["diverged"]) == (1, 1, 1)
    assert env.pop_episodes()["diverged"] == 0
    env.set_state(again)
    assert env.pop_episodes() == episodes
