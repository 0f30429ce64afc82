"""Tests of design inside the episode: stages, masks, invalid bodies, and control compared with given bodies."""

import numpy as np
import pytest
import torch

from lab.design_in_episode.episodes import NUM_TYPES, DesignVecEnv, RslRlDesignEnv, design_episodes
from warpvox import ActionError, Cell, ConfigError, check_design, make_vec, sample_design

ENVS, SHAPE, LIMIT = 8, (4, 4), 5
OPTIONS = dict(device="cpu", threads=1, lanes=8, max_episode_steps=LIMIT)
BODIES = np.stack([sample_design(SHAPE, seed=k) for k in range(ENVS)])
APART = np.array([[1, 0, 3, 0], [1, 0, 3, 0], [1, 0, 0, 0], [1, 0, 0, 2]])


def make(task: str = "Walker-v0", num_envs: int = ENVS, **options: object) -> DesignVecEnv:
    return design_episodes(task, num_envs, SHAPE, **{"design_steps": 1, **OPTIONS, **options})


def design(env: DesignVecEnv, bodies: np.ndarray, idle: float = np.nan) -> torch.Tensor:
    """Build actions of a design step, types or logits; entries of the control stage are ``idle``."""
    cells = torch.as_tensor(bodies).long().reshape(len(bodies), -1)
    if env.layout.revise == "one":
        cells = cells.gather(1, env.episode_length[:, None] % env.layout.cells)
    if env.layout.actions == "logits":
        cells = torch.nn.functional.one_hot(cells, NUM_TYPES)
    actions = torch.full((env.num_envs, env.num_actions), idle)
    actions[:, env.layout.control :] = cells.flatten(1).float()
    return actions


def control(env: DesignVecEnv, seed: int, idle: float = np.nan) -> torch.Tensor:
    """Build actions of a control step, equal for environments of the same number."""
    draws = np.stack([np.random.default_rng([seed, k]).uniform(0.6, 1.6, env.layout.control) for k in range(ENVS)])
    actions = torch.full((env.num_envs, env.num_actions), idle)
    actions[:, : env.layout.control] = torch.as_tensor(draws)[: env.num_envs].float()
    return actions


@pytest.mark.parametrize("revise", ["all", "one"])
@pytest.mark.parametrize("actions", ["types", "logits"])
def test_a_designed_body_is_that_of_a_new_environment_bit_for_bit(revise: str, actions: str) -> None:
    steps = 2 if revise == "all" else SHAPE[0] * SHAPE[1]
    env = make(design_steps=steps, revise=revise, actions=actions)
    fresh = make_vec("Walker-v0", list(BODIES), ENVS, obs="voxel", grid=SHAPE, **OPTIONS)
    layout, (obs, _) = env.layout, env.reset()
    for step in range(steps):
        assert env.designing.all()
        assert bool(layout.designing(obs).all())
        assert not obs[:, : layout.task].any()
        assert layout.progress(obs).tolist() == pytest.approx([step / steps] * ENVS)
        if revise == "one":
            assert layout.cursor(obs).argmax(1).tolist() == [step] * ENVS
        obs, reward, terminated, truncated, info = env.step(design(env, BODIES))
        assert not (reward.any())
        assert not (terminated.any())
        assert not (truncated.any())
        assert info["design"]["done"].tolist() == [step == steps - 1] * ENVS
    wanted = fresh.reset()[0]
    for step in range(LIMIT):
        assert not env.designing.any()
        assert not layout.designing(obs).any()
        assert torch.equal(obs[:, : layout.task], wanted)
        assert torch.equal(layout.types(obs).argmax(-1), torch.as_tensor(BODIES).long().flatten(1))
        move = control(env, step)
        obs, reward, _, truncated, info = env.step(move)
        wanted, reference, _, _, known = fresh.step(move[:, : layout.control])
        assert torch.equal(info["final_obs"][:, : layout.task], known["final_obs"])
        assert torch.equal(reward, reference)
        assert info["episode"]["length"].tolist() == [steps + step + 1] * ENVS
    assert truncated.all()
    assert env.designing.all()
    assert torch.equal(obs, env.reset()[0])


@pytest.mark.parametrize("task", ["Thrower-v0", "Climber-v2"])
def test_tasks_with_objects_and_a_past_episode(task: str) -> None:
    """Also that an episode depends on nothing that was before it: the bodies of the first one are others."""
    env = make(task)
    for bodies in (BODIES[::-1].copy(), BODIES):
        obs = env.step(design(env, bodies))[0]
        fresh = make_vec(task, list(bodies), ENVS, obs="voxel", grid=SHAPE, **OPTIONS)
        assert torch.equal(obs[:, : env.layout.task], fresh.reset()[0])
        for step in range(LIMIT):
            move = control(env, step)
            found, known = env.step(move), fresh.step(move[:, : env.layout.control])
            assert torch.equal(found[4]["final_obs"][:, : env.layout.task], known[4]["final_obs"])
            assert torch.equal(found[1], known[1])


def test_environments_in_different_stages_do_not_disturb_each_other() -> None:
    """Half of them are reset in the middle of an episode; each does what it does where all begin together."""
    late = torch.arange(ENVS) % 2 == 1
    together, mixed = make(), make()
    results = [together.step(design(together, BODIES))[0]]
    results += [together.step(control(together, step))[0] for step in range(LIMIT - 1)]
    first = mixed.step(design(mixed, BODIES[::-1].copy()))[0]
    assert not torch.equal(first, results[0])
    mixed.reset()
    mixed.step(design(mixed, BODIES))
    mixed.step(control(mixed, 0))
    mixed.reset(mask=late)
    for step in range(LIMIT - 2):
        assert mixed.designing.tolist() == (late if step == 0 else torch.zeros_like(late)).tolist()
        move = torch.where(
            late[:, None], design(mixed, BODIES) if step == 0 else control(mixed, step - 1), control(mixed, step + 1)
        )
        obs = mixed.step(move)[0]
        assert torch.equal(obs[late], results[step][late])
        assert torch.equal(obs[~late], results[step + 2][~late])


@pytest.mark.parametrize("actions", ["types", "logits"])
def test_entries_that_are_masked_change_no_bit(actions: str) -> None:
    envs = [make(actions=actions) for _ in range(2)]
    for step in range(LIMIT + 2):
        mask = envs[0].action_mask
        results = []
        for env, idle in zip(envs, (np.nan, 3e8), strict=True):
            move = torch.where(env.designing[:, None], design(env, BODIES), control(env, step))
            results.append(env.step(torch.where(mask, move, idle)))
        for a, b in zip(results[0][:4], results[1][:4], strict=True):
            assert torch.equal(a, b)
        assert torch.equal(envs[0].layout.action_mask(results[0][0]), envs[0].action_mask)
        counts = [(body >= Cell.H_ACT).sum() for body in BODIES]
        if envs[0].designing[0]:
            assert envs[0].action_mask.sum(1).tolist() == [envs[0].layout.design] * ENVS
        else:
            assert envs[0].action_mask.sum(1).tolist() == counts


def test_invalid_bodies_are_repaired_or_end_the_episode() -> None:
    bodies = BODIES.copy()
    bodies[1], bodies[2] = APART, 0
    wrong = torch.tensor([k in (1, 2) for k in range(ENVS)])
    env = make(penalty=2.0, cost=[0.1, 0.2, 0.3, 0.4])
    _, reward, terminated, _, info = env.step(design(env, bodies))
    assert info["design"]["valid"].tolist() == (~wrong).tolist()
    assert not terminated.any()
    made = env.cells.numpy()
    assert np.array_equal(made[~wrong], BODIES[~wrong])
    assert np.array_equal(made[1], np.where(APART == 3, 3, 0))
    assert np.count_nonzero(made[2]) == 1
    prices = np.array([0, 0.1, 0.2, 0.3, 0.4])[made].sum((1, 2)) + 2.0 * wrong.numpy()
    assert (-reward).tolist() == pytest.approx(prices.tolist())
    assert info["episode"]["return"].tolist() == reward.tolist() == info["reward_terms"]["design"].float().tolist()

    env = make(invalid="end", penalty=2.0, cost=1.0)
    _, reward, terminated, truncated, info = env.step(design(env, bodies))
    assert terminated.tolist() == wrong.tolist()
    assert not truncated.any()
    assert reward[wrong].tolist() == [-2.0, -2.0]
    assert (-reward[~wrong]).tolist() == [np.count_nonzero(body) for body in BODIES[~wrong]]
    assert info["episode"]["length"].tolist() == [1] * ENVS
    assert env.designing.tolist() == wrong.tolist()  # the next episode has begun


def test_starts() -> None:
    env = make(start="random", seed=3, design_steps=2)
    obs = env.reset(seed=5)[0]
    assert obs.shape == (ENVS, env.num_obs)
    again = make(start="random", seed=5, design_steps=2, num_envs=4)
    assert torch.equal(again.cells, env.cells[:4])
    for body in env.cells.numpy():
        check_design(body)
    assert len(np.unique(env.cells.numpy(), axis=0)) == ENVS
    with torch.inference_mode():  # as rsl-rl's runner steps
        env.step(design(env, BODIES))
        env.step(design(env, BODIES))
        env.step(control(env, 0))
    env.reset(mask=torch.arange(ENVS) < 2)
    assert not torch.equal(env.cells[:2], again.cells[:2])  # another episode
    fixed = make(start=APART)
    assert np.array_equal(fixed.cells[0].numpy(), APART)


def test_ends_are_spread_over_time() -> None:
    env = RslRlDesignEnv(make())
    env.episode_length_buf = torch.tensor([0, 1, 3, 4, 5, 2, 0, 0])
    env.step(design(env.env, BODIES, 0.0))
    ends = []
    for step in range(LIMIT):
        done = env.step(torch.where(env.env.designing[:, None], 0.0, control(env.env, step, 0.0)))[2]
        ends += [(number, step + 1) for number in done.nonzero()[:, 0].tolist()]
    first = dict(reversed(ends))
    assert [first[number] for number in range(ENVS)] == [5, 4, 2, 1, 1, 3, 5, 5]


def test_the_time_is_that_of_the_control_stage() -> None:
    env = design_episodes("Walker-v0", 2, (3, 3), 2, obs="timed", device="cpu", threads=1, lanes=8)
    moves = torch.full((2, env.num_actions), 3.0)  # all cells actuators: the body fills the grid
    env.reset()
    env.episode_length = torch.tensor([0, 5])
    obs = [env.step(moves)[0] for _ in range(4)]
    place = env.env.obs_columns[0]["elapsed_steps"]
    assert [row[:, place].flatten().tolist() for row in obs] == [[0.0, 0.0], [0.0, 5.0], [1.0, 6.0], [2.0, 7.0]]
    env.episode_length = torch.tensor([9, 9])
    assert env.retimed(obs[-1])[:, place].flatten().tolist() == [7.0, 7.0]


def test_what_is_not_valid_is_refused() -> None:
    for options in ({"revise": "al"}, {"start": "rand"}, {"start": [[1, 2]]}, {"cost": [1, 2]}, {"design_steps": 0}):
        with pytest.raises(ConfigError):
            make(**options)
    env = make()
    for actions in (torch.zeros(ENVS, 3), torch.full((ENVS, env.num_actions), torch.nan)):
        with pytest.raises(ActionError):
            env.step(actions)
    assert env.designing.all()
    assert not env.episode_length.any()
