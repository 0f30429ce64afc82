"""What every task must hold to, on the real simulator."""

from __future__ import annotations

from math import pi, radians

import numpy as np
import pytest
import torch

from warpvox.design import example_design, sample_design
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ActionError, ConfigError, DesignError, TaskError, WorldError

ALL = pytest.mark.parametrize("task", task_ids())
BOTH = pytest.mark.parametrize("rules", ["evogym", "paper"])


def make(task: str, designs: object = None, num_envs: int = 1, **options) -> VoxelVecEnv:
    defaults = {"device": "cpu", "dtype": "float64", "threads": 1}
    return make_vec(task, designs, num_envs, **(defaults | options))


def some_actions(env: VoxelVecEnv, steps: int, seed: int = 0) -> torch.Tensor:
    """Waves of different speed, ``[steps, num_envs, num_actions]``; they go beyond the bounds on purpose."""
    rng = np.random.default_rng(seed)
    speed = rng.uniform(0.1, 0.6, (env.num_envs, env.num_actions))
    phase = rng.uniform(0, 2 * pi, (env.num_envs, env.num_actions))
    time = np.arange(steps)[:, None, None]
    return torch.as_tensor(1.1 + 0.55 * np.sin(speed * time + phase))


@ALL
@BOTH
def test_shapes_dtypes_and_masks(task: str, rules: str) -> None:
    designs = [sample_design((3, 3), seed=1), example_design("walker")]
    env = make(task, designs, 4, rules=rules, dtype="float32")
    obs, info = env.reset()
    assert info == {}
    spec = get_task(task).under(rules)
    assert (env.num_envs, env.num_designs, env.max_episode_steps) == (4, 2, spec.max_episode_steps)
    assert env.design_index.tolist() == [0, 0, 1, 1]
    assert env.num_actions == int((designs[1] >= 3).sum())
    assert env.action_mask.sum(1).tolist() == [int((body >= 3).sum()) for body in designs]
    points = env.sim.point_mask("robot").sum(1)
    assert torch.equal(env.obs_mask.sum(1), fixed_entries(task) + 2 * points)
    assert tuple(obs.shape) == (4, env.num_obs)
    assert not obs[~env.obs_mask[env.design_index]].any()
    obs, reward, terminated, truncated, info = env.step(some_actions(env, 1)[0])
    assert tuple(obs.shape) == tuple(info["final_obs"].shape) == (4, env.num_obs)
    assert obs.dtype == reward.dtype == info["episode"]["return"].dtype == torch.float32
    assert terminated.dtype == truncated.dtype == info["unstable"].dtype == torch.bool
    assert tuple(reward.shape) == tuple(terminated.shape) == tuple(truncated.shape) == (4,)
    assert torch.isfinite(obs).all()
    assert torch.isfinite(reward).all()


def fixed_entries(task: str) -> int:
    """Entries of an observation besides the positions of the robot's points (section B)."""
    return {"Walker-v0": 2, "Carrier-v0": 6, "Climber-v0": 2, "UpStepper-v0": 14}[task]


def raw(env: VoxelVecEnv, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre of mass, its velocity, and relative positions (x before y) of an object, from its points."""
    points = env.sim.object_positions(name)[0].numpy()
    centre = points.mean(0)
    return centre, env.sim.object_velocities(name)[0].numpy().mean(0), (points - centre).T.ravel()


def scan_below(env: VoxelVecEnv, rules: str, reach: int = 5) -> np.ndarray:
    """Floor (released) or elevation (printed), window by window from the points of the ground."""
    points, (x, y) = env.sim.object_positions("ground")[0].numpy() / 0.1, raw(env, "robot")[0] / 0.1
    out = []
    for i in range(-reach, reach + 1):
        left, right = (x + i - 0.5, x + i + 0.5) if rules == "evogym" else (x + i, x + i + 1)
        seen = [h for p, h in points if left < p < right and h < y]
        if rules == "evogym":
            out.append(np.clip(y - max(seen), 0, 5) if seen else 5.0)
        else:
            out.append(max(seen, default=0.0))
    return np.array(out) * 0.1


def expected_obs(env: VoxelVecEnv, task: str, rules: str) -> np.ndarray:
    _, velocity, shape = raw(env, "robot")
    if task in ("Walker-v0", "Climber-v0"):
        return np.concatenate([velocity, shape])
    if task == "Carrier-v0":
        package, robot = raw(env, "package"), raw(env, "robot")
        first, last = (robot[1], package[1]) if rules == "evogym" else (package[1], robot[1])
        return np.concatenate([first, package[0] - robot[0], last, shape])
    angle = env.sim.orientation("robot").numpy()
    return np.concatenate([velocity, angle, shape, scan_below(env, rules)])


def expected_reward(task: str, before: dict, after: dict) -> float:
    robot = after["robot"] - before["robot"]
    if task == "Carrier-v0":
        package = after["package"] - before["package"]
        return 0.5 * robot[0] + 0.5 * package[0] + (10 * package[1] if after["package"][1] < 0.3 else 0.0)
    return robot[1] if task == "Climber-v0" else robot[0]


def expected_end(env: VoxelVecEnv, task: str, after: dict) -> tuple[bool, float]:
    x, y = after["robot"]
    if task == "UpStepper-v0":
        tilt = radians(75) < float(env.sim.orientation("robot")) < radians(285)
        return x > 6.9 or tilt, 2.0 * (x > 6.9) - 3.0 * tilt
    past = y > 8.6 if task == "Climber-v0" else x > 9.9
    return past, 1.0 * past


@ALL
@BOTH
def test_observations_and_rewards_follow_from_the_points(task: str, rules: str) -> None:
    env = make(task, [sample_design((5, 5), seed=3)], rules=rules, auto_reset=False)
    names = ["robot", "package"] if task == "Carrier-v0" else ["robot"]
    obs, _ = env.reset()
    where = {name: raw(env, name)[0] for name in names}
    np.testing.assert_allclose(obs[0], expected_obs(env, task, rules), rtol=0, atol=1e-11)
    for action in some_actions(env, 120):
        obs, reward, terminated, truncated, _ = env.step(action)
        before, where = where, {name: raw(env, name)[0] for name in names}
        ends, bonus = expected_end(env, task, where)
        np.testing.assert_allclose(obs[0], expected_obs(env, task, rules), rtol=0, atol=1e-11)
        assert float(reward) == pytest.approx(expected_reward(task, before, where) + bonus, abs=1e-11)
        assert bool(terminated) == ends
        assert not truncated.any()
        if ends:
            break


@ALL
def test_a_batch_of_designs_gives_what_single_environments_give(task: str) -> None:
    designs = [sample_design((3, 3), seed=1), example_design("walker"), sample_design((5, 4), seed=2)]
    env = make(task, designs, 6, lanes=8, max_episode_steps=25)
    actions = some_actions(env, 40)
    first, _ = env.reset()
    steps = [env.step(action) for action in actions]
    for number in (0, 3, 5):
        design = int(env.design_index[number])
        alone = make(task, [designs[design]], 1, lanes=8, max_episode_steps=25)
        width, count = alone.num_obs, alone.num_actions
        assert torch.equal(first[number, :width], alone.reset()[0][0])
        for action, (obs, reward, terminated, truncated, info) in zip(actions, steps, strict=True):
            own = alone.step(action[number : number + 1, :count])
            assert torch.equal(obs[number, :width], own[0][0])
            assert not obs[number, width:].any()
            assert torch.equal(info["final_obs"][number, :width], own[4]["final_obs"][0])
            assert [float(reward[number]), bool(terminated[number]), bool(truncated[number])] == [
                float(own[1]),
                bool(own[2]),
                bool(own[3]),
            ]


@ALL
def test_two_runs_are_equal_bit_for_bit(task: str) -> None:
    runs = []
    for _ in range(2):
        env = make(task, None, 3, dtype="float32", seed=5)
        env.reset()
        runs.append([env.step(action)[:2] for action in some_actions(env, 20)])
    for (obs_a, reward_a), (obs_b, reward_b) in zip(*runs, strict=True):
        assert torch.equal(obs_a, obs_b)
        assert torch.equal(reward_a, reward_b)


@ALL
def test_an_episode_after_a_reset_repeats_the_first(task: str) -> None:
    env = make(task, None, 2, max_episode_steps=15)
    actions = some_actions(env, 15)
    start, _ = env.reset()
    first = [env.step(action) for action in actions]
    assert first[-1][3].all()
    assert torch.equal(first[-1][0], start)
    assert not torch.equal(first[-1][4]["final_obs"], start)
    assert first[-1][4]["episode"]["done"].all()
    again = [env.step(action) for action in actions]
    for one, two in zip(first, again, strict=True):
        assert torch.equal(one[4]["final_obs"], two[4]["final_obs"])
        assert torch.equal(one[1], two[1])


def test_it_can_be_stepped_without_a_reset() -> None:
    a, b = make("Walker-v0"), make("Walker-v0")
    b.reset()
    for action in some_actions(a, 3):
        assert torch.equal(a.step(action)[0], b.step(action)[0])


def test_actions_may_be_numpy_and_are_clipped() -> None:
    a, b = make("Walker-v0", None, 2), make("Walker-v0", None, 2)
    a.reset(), b.reset()
    wild = np.full((2, a.num_actions), 9.0)
    assert torch.equal(a.step(wild)[0], b.step(torch.full((2, a.num_actions), 1.6))[0])


def test_equal_designs_share_a_model_but_keep_their_blocks() -> None:
    body = example_design("walker")
    env = make("Walker-v0", [body, body.copy()], 4)
    assert (env.sim.num_designs, env.num_designs) == (1, 2)
    assert env.design_index.tolist() == [0, 0, 1, 1]
    assert tuple(env.obs_mask.shape) == (2, env.num_obs)
    assert tuple(env.action_mask.shape) == (2, env.num_actions)


def test_bodies_may_be_given_in_any_form() -> None:
    body = example_design("walker")
    for designs in (None, "walker", ["walker"], body, [body.tolist()], body[None]):
        assert np.array_equal(make("Walker-v0", designs).designs[0], body)


def test_connections_change_the_robot() -> None:
    body = np.array([[3, 3], [4, 4]])
    cut = np.array([[0, 0, 1], [1, 2, 3]])
    whole, open_ring = make("Walker-v0", [body]), make("Walker-v0", [body], connections=[cut])
    assert whole.sim.num_points("robot") == 9
    assert open_ring.sim.num_points("robot") == 10


def test_rules_choose_the_physics_unless_told_otherwise() -> None:
    assert make("Walker-v0").sim.physics.name == "evogym"
    assert make("Walker-v0", rules="paper").sim.physics.name == "paper"
    assert make("Walker-v0", rules="paper", physics="evogym").sim.physics.name == "evogym"


@pytest.mark.parametrize("shape", [(1, 3), (2, 20), (20,), (2, 20, 1)])
def test_actions_of_the_wrong_shape_are_refused(shape: tuple[int, ...]) -> None:
    env = make("Walker-v0")
    with pytest.raises(ActionError, match="shape"):
        env.step(torch.ones(shape))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_actions_that_are_not_finite_are_refused_and_change_nothing(value: float) -> None:
    env, twin = make("Walker-v0", None, 2), make("Walker-v0", None, 2)
    bad = torch.ones((2, env.num_actions))
    bad[1, 2] = value
    with pytest.raises(ActionError, match="environment 1"):
        env.step(bad)
    good = torch.full((2, env.num_actions), 1.3)
    assert env.episode_length.tolist() == [0, 0]
    assert torch.equal(env.step(good)[0], twin.step(good)[0])


@pytest.mark.parametrize(
    ("error", "words", "arguments"),
    [
        (TaskError, "Did you mean 'Walker-v0'", {"task": "Waker-v0"}),
        (ConfigError, "Did you mean 'paper'", {"rules": "papr"}),
        (
            ConfigError,
            "multiple of the number of designs \\(2\\), got 3; try 2 or 4",
            {"designs": ["walker"] * 2, "num_envs": 3},
        ),
        (ConfigError, "whole number >= 1", {"num_envs": 0}),
        (ConfigError, "whole number >= 1", {"num_envs": 1.5}),
        (ConfigError, "max_episode_steps must be", {"max_episode_steps": 0}),
        (ConfigError, "one entry a design", {"connections": [None, None]}),
        (DesignError, "list of designs is empty", {"designs": []}),
        (DesignError, "must be a list of bodies", {"designs": 7}),
        (DesignError, "no actuator", {"designs": [[[1, 1]]]}),
        (DesignError, "Design 1: .*not connected", {"designs": ["walker", [[3, 0], [0, 3]]], "num_envs": 2}),
        (WorldError, "does not fit the world of Climber-v0", {"task": "Climber-v0", "designs": [[[3] * 6]]}),
    ],
)
def test_bad_input_is_refused_in_words(error: type[Exception], words: str, arguments: dict) -> None:
    with pytest.raises(error, match=words):
        make(**({"task": "Walker-v0"} | arguments))
