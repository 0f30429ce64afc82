"""The drop-in's environments: ids, spaces, base classes for environments of one's own, what is random."""

import os
import random
import warnings
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from refusals import refused

import warpvox.evogym.envs as envs
from warpvox.envs.registry import get_task
from warpvox.errors import ConfigError
from warpvox.evogym import BASELINE_ENV_NAMES, EvoWorld

BODY = np.array([[1, 4, 4, 4, 1], [3, 3, 3, 3, 3], [3, 3, 3, 3, 3], [4, 4, 0, 4, 4], [4, 4, 0, 4, 4]])


@pytest.mark.parametrize("name", BASELINE_ENV_NAMES)
def test_ids_are_those_of_the_release(name: str) -> None:
    spec: EnvSpec = gymnasium.spec(name)
    module, _, cls = spec.entry_point.partition(":")
    assert module.startswith("warpvox.evogym.envs.")
    assert get_task(getattr(envs, cls).task) is get_task(name)
    assert spec.max_episode_steps == get_task(name).max_episode_steps


def test_spaces_are_those_of_the_release() -> None:
    env = gymnasium.make("UpStepper-v0", body=BODY)
    assert env.action_space == gymnasium.spaces.Box(0.6, 1.6, (21,), float)
    assert env.observation_space == gymnasium.spaces.Box(-100, 100, (14 + 72,), float)
    assert env.unwrapped.sight_dist == 5
    assert env.unwrapped.terrain_list == ["ground"]
    assert env.unwrapped.default_viewer._tracked == ["robot"]
    assert gymnasium.make("Pusher-v0", body=BODY).unwrapped.default_viewer._tracked == ["robot", "package"]
    assert gymnasium.make("BeamSlider-v0", body=BODY).unwrapped.default_viewer._tracked == ["robot", "beam"]


def test_made_environments_pass_attributes_on() -> None:
    env: Any = gymnasium.make("Walker-v0", body=BODY)
    assert env.sim is env.unwrapped.sim
    assert env.get_time() == 0
    assert not hasattr(env, "simulation")
    env.set_wrapper_attr("world", None)
    assert env.world is None
    assert env.unwrapped.world is None
    assert gymnasium.make(env.spec).sim is not env.sim
    assert gymnasium.make("Walker-v0", body=BODY, max_episode_steps=-1).get_time() == 0


def test_made_environments_are_wrapped_as_gymnasium_wraps_them() -> None:
    env: Any = gymnasium.make("Walker-v0", body=BODY, max_episode_steps=9)
    plain: Any = gymnasium.make("CartPole-v1", max_episode_steps=9)
    assert isinstance(env, gymnasium.wrappers.TimeLimit)
    assert str(env).partition("<W")[0] == str(plain).partition("<C")[0]
    assert set(vars(env)) == set(vars(plain))  # whatever they are called, also in other versions of gymnasium
    for name, value in vars(plain).items():
        if name != "env":
            assert getattr(env, name) == value, name
    assert (env.spec.max_episode_steps, gymnasium.make(env.spec)._max_episode_steps) == (9, 9)


@pytest.mark.parametrize("wrapper", [lambda env: env, gymnasium.wrappers.RecordEpisodeStatistics])
def test_the_time_limit_can_be_set(wrapper: Any) -> None:
    env: Any = gymnasium.make("Walker-v0", body=BODY)
    wrapped = wrapper(env)
    wrapped.reset()
    env._max_episode_steps = 3
    assert [wrapped.step(wrapped.action_space.sample())[3] for _ in range(3)] == [False, False, True]
    wrapped.set_wrapper_attr("_max_episode_steps", 1000)
    assert not wrapped.step(wrapped.action_space.sample())[3]
    assert env._elapsed_steps == 4
    env._elapsed_steps = 999
    assert wrapped.step(wrapped.action_space.sample())[3]
    assert wrapped.unwrapped.get_time() == 5


def test_the_time_limit_can_be_set_in_vector_environments() -> None:
    envs: Any = gymnasium.make_vec("Walker-v0", num_envs=2, body=BODY)
    envs.set_attr("_max_episode_steps", [1, 2])
    envs.reset()
    assert envs.step(envs.action_space.sample())[3].tolist() == [True, False]


@pytest.mark.parametrize("task", ["Walker-v0", "BidirectionalWalker-v0", "Catcher-v0"])
def test_gymnasiums_own_check(task: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that actions are not within [-1, 1]
        check_env(gymnasium.make(task, body=BODY, render_mode="rgb_array").unwrapped)


def test_actions_are_clipped_and_copied() -> None:
    env, other = (gymnasium.make("Walker-v0", body=BODY).unwrapped for _ in range(2))
    actions = np.random.default_rng(1).uniform(-1, 3, (10, 21))
    kept = actions.copy()
    for row in actions:
        env.step(row)
        other.step(np.clip(row, 0.6, 1.6))
    assert np.array_equal(actions, kept)
    assert np.array_equal(env.pos_at_time(10), other.pos_at_time(10))


def test_lengths_are_in_the_units_of_the_release() -> None:
    env = gymnasium.make("Walker-v0", body=BODY).unwrapped
    env.reset()
    for _ in range(5):
        env.step(env.action_space.sample())
    plain, now = envs.EvoGymBase, env.get_time()
    for look in ("object_pos_at_time", "object_vel_at_time"):
        assert np.allclose(getattr(env, look)(now, "robot"), getattr(plain, look)(env, now, "robot") / 10)
    for look in ("get_pos_com_obs", "get_vel_com_obs", "get_relative_pos_obs"):
        assert np.allclose(getattr(env, look)("robot"), getattr(plain, look)(env, "robot") / 10)
    assert np.allclose(env.get_floor_obs("robot", ["ground"], 2), plain.get_floor_obs(env, "robot", ["ground"], 2) / 10)
    assert np.array_equal(env.get_ort_obs("robot"), [env.object_orientation_at_time(now, "robot")])
    assert env.get_ceil_obs("robot", ["ground"], 2).tolist() == [0.5] * 5
    assert env.get_floor_obs("robot", [], 2) is None


def test_terrain_is_seen_window_by_window() -> None:
    world = EvoWorld()
    world.add_from_array("robot", np.array([[3, 3, 3]]), 10, 4)  # the centre lies at (11.5, 4.5)
    world.add_from_array("ground", np.array([[5, 0, 0], [5, 5, 0]]), 10, 0)
    world.add_from_array("roof", np.array([[5]]), 11, 8)
    env = envs.EvoGymBase(world)
    env.sim.translate_object(0.02, 0.0, "robot")  # to (11.7, 4.5): else points lie on the borders of windows
    assert env.get_floor_obs("robot", ["ground"], 2, 4) == pytest.approx([2.5, 2.5, 3.5, 4, 4])
    assert env.get_floor_obs("robot", ["ground"], 2, 3) == pytest.approx([2.5, 2.5, 3, 3, 3])
    assert env.get_ceil_obs("robot", ["ground", "roof"], 1) == pytest.approx([3.5, 3.5, 5])


class TwoRobots(envs.EvoGymBase):
    """Someone's own environment: two robots, a box, a reward of their own."""

    def __init__(self, body: np.ndarray, render_mode: str | None = None, render_options: Any = None) -> None:
        self.world = EvoWorld()
        self.world.add_from_array("ground", np.full((1, 30), 5), 0, 0)
        self.world.add_from_array("left", body, 2, 1)
        self.world.add_from_array("right", np.array([[3, 4]]), 12, 1)
        self.world.add_from_array("box", np.array([[2]]), 20, 1)
        envs.EvoGymBase.__init__(self, self.world, render_mode, render_options)
        count = sum(self.get_dim_action_space(name) for name in ("left", "right"))
        self.action_space = gymnasium.spaces.Box(0.6, 1.6, (count,), float)
        self.observation_space = gymnasium.spaces.Box(-100, 100, self.reset()[0].shape, float)
        self.default_viewer.track_objects("left", "right")

    def observe(self) -> np.ndarray:
        return np.concatenate(
            [self.get_pos_com_obs("left"), self.get_relative_pos_obs("right"), self.get_ort_obs("box")]
        )

    def step(self, action: np.ndarray) -> tuple:
        before = self.get_pos_com_obs("left")
        done = super().step({"left": action[:-2], "right": action[-2:]})
        return self.observe(), self.get_pos_com_obs("left")[0] - before[0], done, False, {}

    def reset(self, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed, options=options)
        return self.observe(), {}


def test_an_environment_of_ones_own() -> None:
    gymnasium.register("TwoRobots-v0", entry_point=lambda **kwargs: TwoRobots(**kwargs), max_episode_steps=8)
    env = gymnasium.make("TwoRobots-v0", body=BODY, render_mode="rgb_array", render_options={"hide_grid": True})
    first, _ = env.reset(seed=1)
    env.action_space.seed(1)
    place, total = first[0], 0.0
    for step in range(1, 9):
        obs, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        total += reward
        assert not terminated
        assert truncated == (step == 8)
    assert total == pytest.approx(obs[0] - place)
    assert env.unwrapped.get_time() == 8
    assert env.render().shape == (600, 1200, 3)
    again, _ = env.reset()
    assert np.array_equal(again, first)
    env.close()
    env.close()


class OtherTerrain(envs.WalkingBumpy2):
    """Steps of the release in another world, as scripts do: its constructor is left out."""

    metadata: ClassVar = {"render_modes": ["human"]}

    def __init__(self, body: np.ndarray) -> None:
        self.world = EvoWorld.from_json(os.path.join(self.DATA_PATH, "UpStepper-v0.json"))
        self.world.add_from_array("robot", body, 1, 1)
        envs.StairsBase.__init__(self, self.world, "rgb_array")


def test_a_subclass_may_bring_its_own_world_and_metadata() -> None:
    own, theirs = OtherTerrain(BODY), gymnasium.make("UpStepper-v0", body=BODY).unwrapped
    assert own.reset()[0].shape == theirs.reset()[0].shape
    row = np.full(21, 1.3)
    assert [own.step(row)[1] for _ in range(9)] == [theirs.step(row)[1] for _ in range(9)]


def test_goals_come_from_the_global_generator_or_the_seed() -> None:
    random.seed(7)
    env = gymnasium.make("BidirectionalWalker-v0", body=BODY).unwrapped
    env.reset()
    random.seed(7)
    expected = []
    for _ in range(2):  # drawn when it is made and when it is reset
        place, way, expected = 35, 0, []
        while way < 100:
            goal = random.randrange(20, 50)
            way, place = way + abs(goal - place), goal
            expected.append(goal)
    assert [goal.x_goal for goal in env.goals] == expected
    runs = []
    for _ in range(2):
        env.reset(seed=3)
        random.seed()
        runs.append([goal.x_goal for goal in env.goals])
        env.reset()
        runs.append([goal.x_goal for goal in env.goals])
    assert runs[0] == runs[2] != runs[1] == runs[3]


def test_goals_are_reached_one_after_the_other() -> None:
    env = gymnasium.make("BidirectionalWalker-v0", body=BODY).unwrapped
    obs, _ = env.reset()
    assert obs[-3:].tolist() == pytest.approx([0, env.goals[0].x_goal / 10, env.goals[0].x_goal / 10 - obs_x(env)])
    env.init_reward_goals([envs.WalkToX(goal) for goal in (35, 36, 30)])
    obs, reward, terminated, _, _ = env.step(np.ones(21))
    assert (env.current_goal, terminated) == (2, False)  # the robot stands within 2 voxels of the first two
    assert obs[-3] == 0  # observed before it counts
    env.init_reward_goals([envs.WalkToX(35)])
    _, reward, terminated, _, _ = env.step(np.ones(21))
    assert terminated
    assert reward == pytest.approx(1, abs=0.01)
    env.step(np.ones(21))
    with pytest.raises(ValueError):
        env.init_reward_goals([])


def obs_x(env: envs.BenchmarkBase) -> float:
    return float(env.get_pos_com_obs("robot")[0])


def test_the_package_begins_in_other_places() -> None:
    random.seed(11)
    env = gymnasium.make("Catcher-v0", body=BODY).unwrapped
    env.reset()
    random.seed(11)
    drawn = [(random.randint(-6, 4), random.randint(0, 5)) for _ in range(2)]
    assert (env.offsetx, env.offsety) == drawn[1]
    corner = env.object_pos_at_time(0, "package").min(axis=1)
    assert corner.tolist() == pytest.approx([2.1 + drawn[1][0] / 10, 4.1 + drawn[1][1] / 10])
    places = {(env.reset(seed=seed), env.offsetx, env.offsety)[1:] for seed in (1, 2, 3, 1)}
    assert 1 < len(places) <= 3


def test_shapes_have_hulls() -> None:
    env = gymnasium.make("AreaMaximizer-v0", body=BODY).unwrapped
    points = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [0, 1], [1, 0.5], [1, 0]])
    corners = env.jarvis_march(points)
    assert sorted(map(tuple, corners.tolist())) == [(0, 0), (0, 1), (2, 0), (2, 1)]
    assert env.convex_poly_area(corners) == pytest.approx(2)
    assert env.convex_poly_area(corners[::-1]) == pytest.approx(-2)
    assert env.CCW((0, 0), (1, 0), (1, 1))


def test_bodies_that_do_not_work_are_refused() -> None:
    with pytest.raises(ValueError):
        gymnasium.make("Walker-v0", body=np.array([[1, 2]]))
    with pytest.raises(ValueError):
        gymnasium.make("Climber-v0", body=np.full((5, 6), 3))
    with pytest.raises(ValueError):
        gymnasium.make("Walker-v0", body=BODY).unwrapped.step(np.ones(3))


def test_actions_of_another_kind_are_refused() -> None:
    world = EvoWorld()
    world.add_from_array("robot", BODY, 1, 1)
    with pytest.raises(TypeError):
        envs.EvoGymBase(world).step(np.ones(3))
    with pytest.raises(TypeError):
        gymnasium.make("Walker-v0", body=BODY).unwrapped.step({"robot": np.ones(3)})


def test_loose_bodies_are_allowed_as_released() -> None:
    env = gymnasium.make("Walker-v0", body=np.array([[3, 0, 4], [3, 0, 4]])).unwrapped
    assert env.reset()[0].shape == (2 + 2 * 12,)


def test_render_modes_and_options_are_checked() -> None:
    world = EvoWorld()
    world.add_from_array("robot", BODY, 1, 1)
    with refused(ConfigError, "Did you mean 'rgb_array'"):
        envs.EvoGymBase(world, render_mode="rgb_aray")
    with pytest.warns(UserWarning, match="Did you mean 'hide_grid'"):
        envs.EvoGymBase(world, render_options={"hide_gird": True})
