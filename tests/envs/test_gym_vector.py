"""Many environments as gymnasium has them, compared with gymnasium's own way of stepping single ones."""

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import NormalizeObservation
from refusals import refused

from warpvox.design import example_design, full_connections
from warpvox.envs.adapters.gym_vector import VoxelGymVectorEnv
from warpvox.errors import ConfigError, RolloutError, SimulationError

SAME = 1e-9  # batches sum in another order than single environments; a few steps later that is all there is

pytestmark = pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")


def make(task: str = "Walker-v0", num_envs: int = 3, **options: Any) -> VoxelGymVectorEnv:
    return gymnasium.make_vec(f"warpvox/{task}", num_envs=num_envs, **({"threads": 1} | options))


def compare(ours: Any, theirs: Any, place: str = "infos") -> None:
    """Equal keys, types and masks everywhere; numbers to rounding."""
    assert type(ours) is type(theirs), place
    if isinstance(ours, dict):
        assert sorted(ours) == sorted(theirs), place
        for key in ours:
            compare(ours[key], theirs[key], f"{place}.{key}")
    elif isinstance(ours, tuple) or (isinstance(ours, np.ndarray) and ours.dtype == object):
        for one, other in zip(ours, theirs, strict=True):
            compare(one, other, place)
    elif isinstance(ours, np.ndarray):
        assert (ours.dtype, ours.shape) == (theirs.dtype, theirs.shape), place
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=SAME, err_msg=place)
    else:
        assert ours is theirs is None, place


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("task", ["Walker-v0", "UpStepper-v0", "Catcher-v0"])
def test_it_is_what_gymnasium_makes_of_single_environments(task: str, mode: AutoresetMode) -> None:
    ours = make(task, body="walker", max_episode_steps=4, autoreset_mode=mode)
    assert ours.metadata["autoreset_mode"] is mode
    single = {"body": "walker"}
    limits = iter([4, 2, 3])
    theirs = SyncVectorEnv(
        [lambda: gymnasium.make(f"warpvox/{task}", **single, max_episode_steps=next(limits))] * 3, autoreset_mode=mode
    )
    for name in ("single_observation_space", "single_action_space", "observation_space", "action_space"):
        assert getattr(ours, name) == getattr(theirs, name), name
    limits = torch.tensor([4, 2, 3])

    def stagger() -> None:  # our episodes begin so late that they have the length of theirs
        begun = ours.vec.episode_length == 0
        ours.vec.episode_length = torch.where(begun, 4 - limits, ours.vec.episode_length)

    compare(ours.reset(seed=3)[0], theirs.reset(seed=3)[0], "obs")
    rng = np.random.default_rng(0)
    ended = np.zeros(3, dtype=bool)
    for step in range(12):
        if mode is AutoresetMode.DISABLED and ended.any():
            seed = [7, 8, 9] if step % 2 else None
            masks = ({"reset_mask": ended.copy()}, {"reset_mask": ended.copy()})
            compare(ours.reset(seed=seed, options=masks[0]), theirs.reset(seed=seed, options=masks[1]), "reset")
        stagger()
        actions = rng.uniform(0.6, 1.6, ours.action_space.shape)
        (*numbers, infos), (*others, expected) = ours.step(actions), theirs.step(actions)
        for one, other in zip(numbers, others, strict=True):
            compare(one, other, f"step {step}")
        compare(infos, expected, f"infos {step}")
        ended = numbers[2] | numbers[3]
    compare(ours.reset()[0], theirs.reset()[0], "reset of all")


def test_single_environments_answer_as_those_of_a_sync_vector_env() -> None:
    options = {"body": "walker", "render_mode": "rgb_array", "render_size": (80, 45)}
    ours, theirs = make(**options), make(vectorization_mode="sync", **options)
    for env in (ours, theirs):
        env.reset(seed=5)
        for value in (0.6, 1.6, 0.6):
            env.step(np.full(env.action_space.shape, value))
    for name in ("render_mode", "render_size", "action_space", "observation_space", "body", "np_random_seed"):
        np.testing.assert_equal(ours.get_attr(name), theirs.get_attr(name), name)
    for name in ("_max_episode_steps", "_elapsed_steps"):
        assert ours.get_attr(name) == theirs.get_attr(name), name
        assert ours.call("get_wrapper_attr", name) == theirs.call("get_wrapper_attr", name), name
        assert ours.call("has_wrapper_attr", name) == theirs.call("has_wrapper_attr", name), name
    assert [one.random() for one in ours.get_attr("np_random")] == [
        one.random() for one in theirs.get_attr("np_random")
    ]
    assert [one.id for one in ours.get_attr("spec")] == [one.id for one in theirs.get_attr("spec")]
    pictures = ours.call("render")
    assert type(pictures) is type(theirs.call("render")) is tuple
    np.testing.assert_array_equal(pictures, theirs.call("render"))
    np.testing.assert_array_equal(pictures, ours.render())
    for env in (ours, theirs):
        env.set_attr("mine", [1, (2,), None])
        assert env.get_attr("mine") == env.call("mine") == (1, (2,), None)
        env.set_attr("mine", "word")
        assert env.get_attr("mine") == ("word",) * 3
        for wrong in ([1], (1, 2, 3, 4)):
            with pytest.raises(ValueError):
                env.set_attr("mine", wrong)
        with refused(AttributeError, "others"):
            env.get_attr("others")
    compare(ours.call("reset", seed=2), theirs.call("reset", seed=2), "reset")
    assert ours.get_attr("np_random_seed") == theirs.get_attr("np_random_seed") == (2, 2, 2)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_time_limits_are_set_for_each_environment(mode: AutoresetMode) -> None:
    ours = make(body="walker", autoreset_mode=mode)
    theirs = make(body="walker", vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode})
    found = {}
    for env in (ours, theirs):
        env.reset()
        env.set_attr("_max_episode_steps", [4, 2, 3])
        ended = np.zeros(3, dtype=bool)
        found[env] = []
        for _ in range(9):
            if mode is AutoresetMode.DISABLED and ended.any():
                env.reset(options={"reset_mask": ended})
            *_, ended, _ = env.step(np.ones(env.action_space.shape))
            found[env].append((ended.tolist(), env.get_attr("_elapsed_steps")))
    assert found[ours] == found[theirs]
    assert [spec.max_episode_steps for spec in ours.get_attr("spec")] == [4, 2, 3]
    with pytest.raises(ConfigError):
        ours.set_attr("_max_episode_steps", 0)


def test_bodies_of_single_environments() -> None:
    env = make(num_envs=4, designs=["walker", "mini"])
    for number, body in enumerate(env.get_attr("body")):
        np.testing.assert_array_equal(body, example_design("walker" if number < 2 else "mini"))
        body[:] = 0
    assert all(body.any() for body in env.get_attr("body"))
    with pytest.raises(SimulationError):
        env.call("step", env.single_action_space.sample())


def test_the_mode_is_gymnasiums_own_unless_another_is_asked_for() -> None:
    theirs = make(body="walker", vectorization_mode="sync")
    assert make(body="walker").metadata["autoreset_mode"] is theirs.metadata["autoreset_mode"]
    NormalizeObservation(make(body="walker"))  # which takes no SAME_STEP


def test_who_has_ended_must_be_reset_where_nobody_else_does() -> None:
    env = make(num_envs=2, body="walker", max_episode_steps=1, autoreset_mode="disabled")
    env.reset()
    env.step(env.action_space.sample())
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(SimulationError):
        env.step(env.action_space.sample())
    for mask in ([True, True], np.ones(2), np.ones(3, dtype=bool), np.zeros(2, dtype=bool)):
        with pytest.raises(ConfigError):
            env.reset(options={"reset_mask": mask})
    with pytest.raises(ConfigError):
        env.reset(seed=[1])


def test_pictures_of_all() -> None:
    env = make(num_envs=2, body="walker", render_mode="rgb_array", render_size=(160, 90))
    env.reset()
    first = env.render()
    assert [(frame.shape, frame.dtype) for frame in first] == [((90, 160, 3), np.uint8)] * 2
    assert np.array_equal(*first)
    for _ in range(10):
        env.step(np.stack([np.full(env.vec.num_actions, 0.6), np.full(env.vec.num_actions, 1.6)]))
    assert not np.array_equal(*env.render())
    silent = make(num_envs=2, body="walker")
    with pytest.warns(UserWarning, match="without render_mode"):
        assert silent.render() is None


@pytest.mark.parametrize("size", [("a", 30), 30, (float("nan"), 30), (100_000, 100_000), (15, 30), (64.5, 30)])
def test_pictures_of_a_size_that_cannot_be_drawn_are_refused_in_one_line(size: object) -> None:
    with pytest.raises(RolloutError):
        make(render_mode="rgb_array", render_size=size).render()


def test_connections_are_those_of_the_one_body() -> None:
    links = full_connections(example_design("walker"))[:-1].T
    step = np.full((2, make().vec.num_actions), 1.6)
    found = []
    for options in ({}, {"connections": links}, {"connections": links, "body": "walker"}):
        env = make(num_envs=2, **options)
        env.reset(seed=0)
        found.append(env.step(step)[0])
    assert np.array_equal(found[1], found[2])
    assert not np.array_equal(found[0], found[1])


def test_mistakes_are_named() -> None:
    with pytest.raises(ConfigError):
        make(body="walker", designs=["walker"])
    with pytest.raises(ConfigError):
        make(body="walker", render_mode="human")
    with pytest.raises(ConfigError):
        make(body="walker", autoreset_mode="same")
    with pytest.raises(ConfigError):
        make(body="walker", autoreset="SAME_STEP")


@pytest.mark.parametrize("mode", AutoresetMode)
def test_bodies_are_exchanged_in_the_running_batch(mode: AutoresetMode) -> None:
    first, second = example_design("mini"), np.array([[3, 4], [1, 2], [4, 3]], dtype=np.int8)
    options = {"grid": (4, 4), "dtype": "float32"}
    env = make(body=first, max_episode_steps=3, autoreset_mode=mode, render_mode="rgb_array", **options)
    env.reset(seed=0)
    actions = np.ones(env.action_space.shape, env.action_space.dtype)
    for _ in range(3):  # in modes other than SAME_STEP all have ended then
        before, *_ = env.step(actions)
    pictures = env.render()
    mask = np.array([False, True, True])
    obs = env.set_designs(second, mask)
    fresh = make(body=second, **options).reset(seed=0)[0]
    np.testing.assert_array_equal(obs[mask], fresh[mask])
    np.testing.assert_array_equal(obs[0], before[0])
    drawn = env.render()
    assert [np.array_equal(one, other) for one, other in zip(drawn, pictures, strict=True)] == [True, False, False]
    if mode is AutoresetMode.DISABLED:
        with pytest.raises(SimulationError):
            env.step(actions)
        env.reset(options={"reset_mask": ~mask})
    assert not env.step(actions)[3].any()
    with pytest.raises(SimulationError):
        make(body=first, dtype="float32").set_designs(second, mask)


def test_pictures_show_bodies_that_were_exchanged_in_the_environments_themselves() -> None:
    first, second = example_design("mini"), np.array([[3, 4], [1, 2], [4, 3]], dtype=np.int8)
    options = {"num_envs": 2, "grid": (4, 4), "dtype": "float32", "render_mode": "rgb_array"}
    env, wanted = make(body=first, **options), make(designs=[second, first], **options)
    env.render()
    env.vec.set_designs(second, np.array([True, False]))
    np.testing.assert_array_equal(env.render(), wanted.render())


@pytest.mark.parametrize("task", ["Walker-v0", "UpStepper-v0", "Pusher-v0"])
def test_the_space_holds_whatever_bodies_are_put_in(task: str) -> None:
    """Terms behind the shape of a body lie elsewhere for each; Pusher has a second object, UpStepper bounded scans."""
    env = make(task, num_envs=4, body=[[3]], grid=(3, 2), dtype="float32")
    bodies = [np.array(body) for body in ([[3]], [[3, 4]], [[3, 3], [4, 4], [1, 2]], [[4, 1], [4, 1], [0, 3]])]
    env.reset(seed=0)
    for body in bodies:
        obs = env.set_designs(body, np.array([True, False, False, False]))
        assert env.observation_space.contains(obs)
    for _ in range(3):
        assert env.observation_space.contains(env.step(env.action_space.sample())[0])
    if task == "UpStepper-v0":  # and it still says something
        assert np.isfinite(env.single_observation_space.high[-1])
