"""A different body in every environment, and other bodies for environments that run."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from warpvox.algos.training.settings import Training
from warpvox.design import example_design, full_connections, sample_design
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.snapshot import Snapshot
from warpvox.envs.spec import observes
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ConfigError, DesignError, SimulationError, WorldError

LANES = 8
OPTIONS = dict(device="cpu", threads=1, lanes=LANES)


def sampled(count: int, first: int = 0, shape: tuple[int, int] = (5, 5)) -> list[np.ndarray]:
    return [sample_design(shape, seed=first + k) for k in range(count)]


def actions_of(env: VoxelVecEnv, steps: int, seed: int = 0) -> torch.Tensor:
    """[steps, environments, actions]; the same for an environment however many there are."""
    draws = [np.random.default_rng([seed, k]).uniform(0.6, 1.6, (steps, 64)) for k in range(env.num_envs)]
    return torch.as_tensor(np.stack(draws, 1)[..., : env.num_actions], dtype=env.dtype)


@pytest.mark.parametrize(
    "task", [task if k % 3 == 0 else pytest.param(task, marks=pytest.mark.slow) for k, task in enumerate(task_ids())]
)
def test_a_body_does_the_same_whatever_the_others_of_its_pack_are(task: str) -> None:
    """Bit for bit, at one lane width: bodies that share a pack against a pack of one body."""
    designs = sampled(LANES, 3)
    mixed = make_vec(task, designs, LANES, seed=list(range(LANES)), auto_reset=False, **OPTIONS)
    assert mixed.sim._state.packs == 1
    moves = actions_of(mixed, 6)
    results = [mixed.reset()[0], *(mixed.step(move)[0] for move in moves)]
    for k in (0, 5):
        alone = make_vec(task, [designs[k]], LANES, seed=[k] * LANES, auto_reset=False, **OPTIONS)
        own = [move[k, : alone.num_actions].expand(LANES, -1) for move in moves]
        expected = [alone.reset()[0], *(alone.step(move)[0] for move in own)]
        for found, wanted in zip(results, expected, strict=True):
            assert torch.equal(found[k, : alone.num_obs], wanted[k])
            assert not found[k, alone.num_obs :].any()


def doubled(state: Snapshot, name: str) -> torch.Tensor:
    return 2 * state.actions(name)


@pytest.mark.parametrize("grid", [None, (2, 3)])
def test_actions_are_observed_as_wide_as_those_of_a_body_that_is_alone(grid: tuple[int, int] | None) -> None:
    base = get_task("Walker-v0")
    spec = replace(base, id="Acting-v0", observations=(observes(doubled), *base.observations))
    small, large = [[3, 3], [3, 0]], [[3, 3, 3], [4, 4, 4]]
    mixed = make_vec(spec, [small, large], 2, grid=grid, auto_reset=False, **OPTIONS)
    if grid:
        mixed.set_designs([large, small], np.array([True, True]))
        mixed.set_designs([small, large], np.array([True, True]))
    goals = torch.tensor([[0.7, 0.8, 0.9, 0.7, 0.7, 0.7], [1.1, 1.2, 1.3, 1.4, 1.5, 1.6]])
    seen = mixed.step(goals)[0]
    for k, (body, actuators, entries) in enumerate(((small, 3, 21), (large, 6, 32))):
        alone = make_vec(spec, [body], 1, auto_reset=False, **OPTIONS)
        assert alone.num_obs == int(mixed.obs_mask[mixed.design_index[k]].sum()) == entries
        assert torch.allclose(seen[k, :actuators], 2 * goals[k, :actuators])
        assert torch.allclose(seen[k, :entries], alone.step(goals[k : k + 1, :actuators])[0][0], atol=1e-4)
        assert not seen[k, entries:].any()


@pytest.mark.parametrize("grid", [None, (2, 3)])
def test_designs_of_an_adapter_go_on_alone(grid: tuple[int, int] | None) -> None:
    bodies = [[[3, 3], [3, 0]], [[3, 3, 3], [4, 4, 4]]]
    both = RslRlVecEnv(make_vec("Walker-v0", bodies, 4, grid=grid, **OPTIONS))
    both.step(torch.full((4, both.num_actions), 0.3))
    alone = RslRlVecEnv(make_vec("Walker-v0", bodies[:1], 2, grid=grid, **OPTIONS))
    alone.set_state(both.pick([0]))
    wide = alone.env.num_obs
    assert torch.equal(alone.get_observations()["policy"], both.get_observations()["policy"][:2, :wide])
    steps = [one.step(torch.full((one.num_envs, one.num_actions), -0.3))[0]["policy"] for one in (alone, both)]
    assert torch.equal(steps[0], steps[1][:2, :wide])


def cut_body(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A body some of whose neighbouring cells are not connected."""
    rng, body = np.random.default_rng(seed), sample_design((4, 4), seed=seed)
    pairs = full_connections(body)
    return body, pairs[rng.random(len(pairs)) < 0.75].T


def test_cut_connections_share_packs_with_whole_bodies() -> None:
    designs, links = zip(*(cut_body(seed) for seed in range(4)), strict=True)
    designs, links = [*designs, *sampled(4, 1, (4, 4))], [*links, *[None] * 4]
    mixed = make_vec("Walker-v0", designs, LANES, connections=links, dtype="float64", arithmetic="fast", **OPTIONS)
    exact = make_vec("Walker-v0", designs, LANES, connections=links, dtype="float64", device="cpu", threads=1, lanes=1)
    assert (mixed.sim._state.packs, exact.sim._state.packs) == (1, LANES)
    for move in actions_of(mixed, 3):
        for env in (mixed, exact):
            env.step(move)
        gap = mixed.sim.object_positions("robot") - exact.sim.object_positions("robot")
        assert gap.abs().max() < 1e-10


def test_a_state_goes_on_in_another_simulation_as_in_its_own() -> None:
    designs, links = zip(*(cut_body(seed) for seed in range(LANES)), strict=True)
    one, other = (make_vec("Walker-v0", designs, LANES, connections=links, **OPTIONS) for _ in range(2))
    moves = actions_of(one, 6)
    for move in moves[:3]:
        one.step(move)
    other.set_state(one.state())
    for move in moves[3:]:
        for found, wanted in zip(other.step(move)[:4], one.step(move)[:4], strict=True):
            assert torch.equal(found, wanted)


@pytest.mark.parametrize("obs", ["task", "voxel"])
@pytest.mark.parametrize("task", ["Walker-v0", "Catcher-v0", "Traverser-v0", "Climber-v2"])
def test_a_changed_batch_is_a_new_one_bit_for_bit(task: str, obs: str) -> None:
    designs, others = sampled(16), sampled(5, 100, (4, 5))
    env = make_vec(task, designs, 16, grid=(5, 5), obs=obs, **OPTIONS)
    sizes = env.num_obs, env.num_actions
    env.reset()
    moves = actions_of(env, 12)
    for move in moves[:4]:
        env.step(move)
    mask = torch.zeros(16, dtype=torch.bool)
    mask[[0, 3, 7, 8, 15]] = True
    before, memory = env.sim.state(), env.memory
    arrays = {name: array.ptr for name, array in env.sim._state.arrays.items()}
    env.set_designs(others, mask)
    assert arrays == {name: array.ptr for name, array in env.sim._state.arrays.items()}
    assert (env.num_obs, env.num_actions) == sizes
    after = env.sim.state()
    for name in before:
        width = min(before[name].shape[-1], after[name].shape[-1]) if before[name].ndim == 2 else None
        assert torch.equal(before[name][~mask][..., :width], after[name][~mask][..., :width]), name
    assert all(torch.equal(env.memory[name][~mask], memory[name][~mask]) for name in memory)
    for k, body in zip(mask.nonzero()[:, 0].tolist(), others, strict=True):
        designs[k] = body
    assert all(np.array_equal(env.designs[env.design_index[k]], designs[k]) for k in range(16))

    fresh = make_vec(task, designs, 16, grid=(5, 5), obs=obs, **OPTIONS)
    found, expected = env.reset(seed=7)[0], fresh.reset(seed=7)[0]
    assert torch.equal(found, expected)
    for move in moves:
        found, expected = env.step(move), fresh.step(move)
        for a, b in zip(found[:4], expected[:4], strict=True):
            assert torch.equal(a, b)
    assert torch.equal(env.obs_mask[env.design_index], fresh.obs_mask[fresh.design_index])
    assert torch.equal(env.action_mask[env.design_index], fresh.action_mask[fresh.design_index])


def test_what_cannot_be_given_is_refused_before_anything_changes() -> None:
    env = make_vec("Walker-v0", sampled(2), 4, grid=(5, 5), device="cpu", threads=1)
    all_of_them = torch.ones(4, dtype=torch.bool)
    state = env.state()
    body, links = cut_body(0)
    for designs, options, error in (
        (sampled(3), {}, ConfigError),
        (np.full((6, 6), 3), {}, SimulationError),
        (np.zeros((5, 5)), {}, DesignError),
        ([body], {"connections": [links]}, SimulationError),
        (np.full((4, 70), 3), {}, (SimulationError, WorldError)),
    ):
        with pytest.raises(error):
            env.set_designs(designs, all_of_them, **options)
    for mask in (torch.ones(3, dtype=torch.bool), None, "x"):
        with pytest.raises(ConfigError):
            env.set_designs(sampled(1), mask)
    with pytest.raises(ConfigError):
        env.reset(mask="x")
    with pytest.raises(DesignError):
        env.set_designs(None, all_of_them)
    after = env.state()
    assert all(torch.equal(after["sim"][name], value) for name, value in state["sim"].items())
    with pytest.raises(SimulationError):
        make_vec("Walker-v0", sampled(1), 1, device="cpu").set_designs(sampled(1, 5), torch.ones(1, dtype=torch.bool))
    with pytest.raises(SimulationError):
        make_vec("Walker-v0", sampled(1), 1, device="cpu", dtype="float64", grid=(5, 5))
    with pytest.raises(SimulationError):
        make_vec("Walker-v0", sampled(1), 1, device="cpu", grid=(4, 5))
    for grid in (5, (5,), "5x5", (0, 5), (5.0, 5)):
        with pytest.raises(ConfigError):
            make_vec("Walker-v0", sampled(1), 1, device="cpu", grid=grid)


def test_a_state_of_other_bodies_is_refused() -> None:
    env = make_vec("Walker-v0", sampled(2), 2, grid=(5, 5), device="cpu", threads=1)
    state, mask = env.state(), torch.tensor([False, True])
    env.set_designs(sampled(1, 9), mask)
    with pytest.raises(SimulationError):
        env.set_state(state)
    env.set_designs(sampled(1, 1), mask)  # as they were
    env.set_state(state)


def test_auto_is_the_example_made_for_the_task() -> None:
    assert np.array_equal(make_vec("UpStepper-v0", "auto", device="cpu").designs[0], example_design("stepper"))
    assert [Training(task=task, design="auto").design for task in ("Climber-v0", "Pusher-v0")] == ["climber", "walker"]
