"""What every task must hold to, on the real simulator."""

from math import pi

import numpy as np
import pytest
import torch

from warpvox.design import example_design, sample_design
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ActionError, ConfigError, DesignError

ALL = pytest.mark.parametrize("task", task_ids())


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
def test_shapes_dtypes_and_masks(task: str) -> None:
    designs = [sample_design((3, 3), seed=1), example_design("walker")]
    env = make(task, designs, 4, dtype="float32")
    obs, info = env.reset()
    assert info == {}
    assert (env.num_envs, env.num_designs, env.max_episode_steps) == (4, 2, get_task(task).max_episode_steps)
    assert env.design_index.tolist() == [0, 0, 1, 1]
    assert env.num_actions == int((designs[1] >= 3).sum())
    assert env.action_mask.sum(1).tolist() == [int((body >= 3).sum()) for body in designs]
    other_entries = env.obs_mask.sum(1) - 2 * env.sim.point_mask("robot").sum(1)
    assert len(set(other_entries.tolist())) == 1
    assert tuple(obs.shape) == (4, env.num_obs)
    assert not obs[~env.obs_mask[env.design_index]].any()
    obs, reward, terminated, truncated, info = env.step(some_actions(env, 1)[0])
    assert tuple(obs.shape) == tuple(info["final_obs"].shape) == (4, env.num_obs)
    assert obs.dtype == reward.dtype == info["episode"]["return"].dtype == torch.float32
    assert terminated.dtype == truncated.dtype == info["unstable"].dtype == torch.bool
    assert tuple(reward.shape) == tuple(terminated.shape) == tuple(truncated.shape) == (4,)
    assert torch.isfinite(obs).all()
    assert torch.isfinite(reward).all()


@ALL
def test_a_batch_of_designs_gives_what_single_environments_give(task: str) -> None:
    designs = [sample_design((3, 3), seed=1), example_design("walker"), sample_design((5, 4), seed=2)]
    env = make(task, designs, 6, lanes=8, max_episode_steps=10)
    random = bool(env.memory)  # the next episode would be another one than that of an environment alone
    actions = some_actions(env, 9 if random else 12)
    first, _ = env.reset()
    drawn = env.memory
    steps = [env.step(action) for action in actions]
    for number in (0, 5):
        design = int(env.design_index[number])
        alone = make(task, [designs[design]], 1, lanes=8, max_episode_steps=10)
        width, count = alone.num_obs, alone.num_actions
        own = {name: value[number : number + 1] for name, value in drawn.items()}
        assert torch.equal(first[number, :width], alone.reset(memory=own)[0][0])
        for action, (obs, reward, terminated, truncated, info) in zip(actions, steps, strict=True):
            own = alone.step(action[number : number + 1, :count])
            assert torch.equal(obs[number, :width], own[0][0])
            assert not obs[number, width:].any()
            assert torch.equal(info["final_obs"][number, :width], own[4]["final_obs"][0])
            assert [part[number].item() for part in (reward, terminated, truncated)] == [
                part.item() for part in own[1:4]
            ]


@pytest.mark.parametrize("task", ["Walker-v0", "Thrower-v0", "AreaMaximizer-v0"])
def test_an_episode_after_a_reset_repeats_the_first(task: str) -> None:
    env = make(task, None, 2, max_episode_steps=8)
    actions = some_actions(env, 8)
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


def test_rows_of_cells_are_one_body() -> None:
    env = make_vec("Walker-v0", [[3, 3, 3], [4, 0, 4]], 2, device="cpu", threads=1)
    assert [body.tolist() for body in env.designs] == [[[3, 3, 3], [4, 0, 4]]]


def test_what_is_returned_belongs_to_the_caller() -> None:
    env, twin = (make("UpStepper-v0", None, 2, max_episode_steps=3) for _ in range(2))
    for action in some_actions(env, 5):
        parts = (
            [*step[:4], *step[4]["reward_terms"].values(), step[4]["unstable"], *step[4]["episode"].values()]
            for step in (env.step(action), twin.step(action))
        )
        for one, other in zip(*parts, strict=True):
            assert torch.equal(one, other)
            one.fill_(1)


def test_equal_designs_share_a_model_but_keep_their_blocks() -> None:
    body = example_design("walker")
    env = make("Walker-v0", [body, body.copy()], 4)
    assert (env.sim.num_designs, env.num_designs) == (1, 2)
    assert env.design_index.tolist() == [0, 0, 1, 1]
    assert tuple(env.obs_mask.shape) == (2, env.num_obs)
    assert tuple(env.action_mask.shape) == (2, env.num_actions)


@pytest.mark.parametrize("task", ["Walker-v0", "Catcher-v0", "BidirectionalWalker-v0"])
@pytest.mark.parametrize("auto_reset", [True, False])
def test_a_reset_of_some_leaves_the_others_as_they_are(task: str, auto_reset: bool) -> None:
    env, twin = (make(task, num_envs=3, auto_reset=auto_reset, max_episode_steps=4) for _ in range(2))
    first = env.reset()[0]
    twin.reset()
    actions = some_actions(env, 6)
    for action in actions[:2]:
        before = env.step(action)[0]
        assert torch.equal(before, twin.step(action)[0])
    fresh, _ = env.reset(mask=np.array([True, False, True]))
    assert torch.equal(fresh[1], before[1])
    assert env.episode_length.tolist() == [0, 2, 0]
    if task != "Walker-v0":
        assert not torch.equal(fresh[0], first[0])  # another episode, another place of the box or list of goals
        assert torch.equal(env.reset(seed=0, mask=torch.tensor([True, False, False]))[0][0], first[0])
    else:
        assert torch.equal(fresh[0], first[0])
    for step, action in enumerate(actions[2:4]):
        ours, theirs = env.step(action), twin.step(action)
        assert torch.equal(ours[4]["final_obs"][1], theirs[4]["final_obs"][1])
        assert ours[3].tolist() == [False, step == 1, False]
    with pytest.raises(ConfigError):
        env.reset(mask=torch.ones(3))


def test_what_others_do_does_not_show_in_an_observation() -> None:
    """The goal that a step has reached shows in the next observation, whether or not another episode ends in it."""
    observed = []
    for begun in (0, 3):
        env = make("BidirectionalWalker-v0", num_envs=2, max_episode_steps=4)
        env.reset()
        here = env.sim.com("robot")[1, 0] / 0.1
        env.reset(memory={"goals": [[40, 20], [round(float(here)), 20]]})
        env.episode_length = torch.tensor([begun, 0])
        observed.append(env.step(some_actions(env, 1)[0])[0][1])
    assert torch.equal(*observed)


def test_rules_choose_the_physics_unless_told_otherwise() -> None:
    assert make("Walker-v0").sim.physics.name == "evogym"
    assert make("Walker-v0", rules="paper").sim.physics.name == "paper"
    assert make("Walker-v0", rules="paper", physics="evogym").sim.physics.name == "evogym"


@pytest.mark.parametrize("shape", [(1, 3), (2, 20), (20,), (2, 20, 1)])
def test_actions_of_the_wrong_shape_are_refused(shape: tuple[int, ...]) -> None:
    env = make("Walker-v0")
    with pytest.raises(ActionError):
        env.step(torch.ones(shape))


def test_environments_that_inference_mode_has_made_are_those_of_any() -> None:
    with torch.inference_mode():
        env = make("Catcher-v0")
        env.step(torch.ones(1, env.num_actions))
    twin = make("Catcher-v0")
    twin.step(torch.ones(1, env.num_actions))
    assert torch.equal(env.step(torch.ones(1, env.num_actions))[0], twin.step(torch.ones(1, env.num_actions))[0])
    assert torch.equal(env.reset()[0], twin.reset()[0])


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_actions_that_are_not_finite_are_refused_and_change_nothing(value: float) -> None:
    env, twin = make("Walker-v0", None, 2), make("Walker-v0", None, 2)
    bad = torch.ones((2, env.num_actions))
    bad[1, 2] = value
    with pytest.raises(ActionError):
        env.step(bad)
    good = torch.full((2, env.num_actions), 1.3)
    assert env.episode_length.tolist() == [0, 0]
    assert torch.equal(env.step(good)[0], twin.step(good)[0])


@pytest.mark.parametrize(
    ("error", "arguments"),
    [
        (ConfigError, {"designs": ["walker"] * 2, "num_envs": 3}),
        (ConfigError, {"designs": ["walker"], "body": "walker"}),
        (ConfigError, {"desings": ["walker"]}),
        (ConfigError, {"max_episode_steps": 0}),
        (ConfigError, {"obs": None, "num_envs": 2}),
        (ConfigError, {"connections": [None, None]}),
        (DesignError, {"designs": []}),
        (DesignError, {"designs": [[3, 3], [4]]}),
        (DesignError, {"designs": [[3, 3], [7, 3]]}),
        (DesignError, {"designs": [[3, 0], [0, 3]]}),
        (DesignError, {"designs": ["walker", [[3, 0], [0, 3]]], "num_envs": 2}),
    ],
)
def test_bad_input_is_refused_in_words(error: type[Exception], arguments: dict) -> None:
    with pytest.raises(error):
        make(**({"task": "Walker-v0"} | arguments))


@pytest.mark.parametrize("auto_reset", [None, 1, "yes", np.array([True, False])])
def test_auto_reset_is_a_flag(auto_reset: object) -> None:
    with pytest.raises(ConfigError):
        make_vec("Walker-v0", num_envs=2, auto_reset=auto_reset)  # pyright: ignore[reportArgumentType]


def test_defaults_of_torch_change_no_number_or_are_refused() -> None:
    def rewards() -> list[list[float]]:
        env = make_vec("Carrier-v0", num_envs=2, device="cpu", seed=3)
        env.reset()
        actions = torch.full((2, env.num_actions), 1.2, device="cpu")
        return [env.step(actions)[1].tolist() for _ in range(5)]

    usual = rewards()
    torch.set_default_dtype(torch.float64)
    try:
        assert rewards() == usual
    finally:
        torch.set_default_dtype(torch.float32)
    with torch.device("meta"), pytest.raises(ConfigError):
        make_vec("Carrier-v0", device="cpu")


def test_random_actions_follow_from_the_seed() -> None:
    first, other = (make_vec("Walker-v0", ["mini", "worm"], 4, device="cpu", threads=1, seed=3) for _ in range(2))
    actions = first.random_actions()
    assert actions.shape == (4, first.num_actions)
    assert 0.6 <= actions.min() < 0.8 < 1.4 < actions.max() <= 1.6
    assert torch.equal(actions, other.random_actions())
    assert not torch.equal(actions, first.random_actions())
    first.step(actions)
