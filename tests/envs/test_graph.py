"""The control step as one CUDA graph, on a simulated device and on a real one.

A graph repeats what was recorded on fixed addresses, and knows nothing of what Python does meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch
from simulated_cuda import SimulatedCuda

from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import observes, rewards
from warpvox.envs.terms.observations import orientation
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.view.rollout import record


@pytest.fixture(params=["simulated", pytest.param("real", marks=pytest.mark.gpu)])
def cuda(request: pytest.FixtureRequest) -> Iterator[None]:
    if request.param == "real":
        yield
    else:
        with SimulatedCuda():
            yield


def pair(task: Any, **options: Any) -> tuple[VoxelVecEnv, VoxelVecEnv]:
    """The same environments, without a graph and with one."""
    options = dict(num_envs=3, device="cuda", max_episode_steps=5, layout="group", threads=1) | options
    return tuple(make_vec(task, cuda_graph=graph, **options) for graph in (False, True))


def equal(one: Any, other: Any) -> bool:
    if isinstance(one, torch.Tensor):
        return torch.equal(one, other)
    if one is None:
        return other is None
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[name], other[name]) for name in one)
    return len(one) == len(other) and all(map(equal, one, other))


def acting(envs: tuple[VoxelVecEnv, ...], random: torch.Generator) -> list[tuple]:
    """The same random actions in all environments; what their steps give."""
    actions = 0.6 + torch.rand((envs[0].num_envs, envs[0].num_actions), generator=random)
    return [env.step(actions.to(env.device)) for env in envs]


def look(env: VoxelVecEnv) -> Any:
    return env.sim.com("robot"), env.sim.velocity("robot")


def film(env: VoxelVecEnv) -> Any:
    rollout = record(env, "random", 4)
    return torch.from_numpy(rollout.positions), torch.from_numpy(rollout.terminated | rollout.truncated)


MEDDLING = {
    "nothing": lambda env: None,
    "start all again": lambda env: env.reset(seed=5),
    "start some again": lambda env: env.reset(mask=torch.tensor([False, True, True])),
    "set lengths": lambda env: setattr(env, "episode_length", torch.tensor([0, 1, 2])),
    "take back": lambda env: env.set_state(env.state()),
    "film": film,
    "write into lengths": lambda env: env.episode_length.__setitem__(1, 4),
    "look": look,
    "wait or not": lambda env: setattr(env, "auto_reset", not env.auto_reset),
    "shorten": lambda env: setattr(env, "max_episode_steps", 3),
    "film again": film,
}


FEW = [("Walker-v0", True), ("BidirectionalWalker-v0", True), ("Catcher-v0", False), ("UpStepper-v0", False)]
MORE = [pytest.param(task, not auto_reset, marks=pytest.mark.slow) for task, auto_reset in FEW]


@pytest.mark.parametrize(("task", "auto_reset"), [*FEW, *MORE])
def test_a_graph_misses_nothing_that_is_done_between_steps(task: str, auto_reset: bool, cuda: None) -> None:
    envs, random, kept = pair(task, auto_reset=auto_reset), torch.Generator().manual_seed(0), []
    for name, meddle in MEDDLING.items():
        assert equal(*(meddle(env) for env in envs)), name
        for step in range(4):
            results = acting(envs, random)
            assert equal(*results), (name, step)
            assert equal(*(env.memory for env in envs))
            assert equal(*(look(env) for env in envs))
            kept.append(results)
        assert equal(*(env.state() for env in envs))
    assert set(envs[1]._graph._recorded) == {True, False}
    assert all(equal(*results) for results in kept), "results must stay as they were returned"


def test_what_was_sensed_between_steps_is_not_taken_for_the_present(cuda: None) -> None:
    """The step of a task that does not ask for centres leaves those that somebody else has asked for."""

    def widest(before: Any, after: Any, name: str) -> torch.Tensor:
        return after.extent(name)[:, 0]

    spec = replace(get_task("Walker-v0"), observations=(observes(orientation),), rewards=(rewards(widest),))
    assert make_vec(spec, device="cuda")._graph is None, (
        "a graph would repeat nothing but what such a function launches"
    )
    assert make_vec("Walker-v0", device="cuda")._graph is not None
    envs, random = pair(spec), torch.Generator().manual_seed(0)
    for _ in range(6):
        assert equal(*acting(envs, random))
        assert equal(*(look(env) for env in envs))
    assert envs[1]._graph._recorded


@pytest.mark.gpu
@pytest.mark.parametrize("graph", [False, True])
def test_on_cuda_every_stream_of_torch_gives_the_same(graph: bool) -> None:
    envs = tuple(make_vec("Catcher-v0", num_envs=3, device="cuda", max_episode_steps=5, cuda_graph=graph) for _ in "ab")
    random = torch.Generator().manual_seed(0)
    for _ in range(8):
        actions = 0.6 + torch.rand((3, envs[0].num_actions), generator=random)
        expected = envs[0].step(actions)
        torch.cuda.synchronize()
        with torch.cuda.stream(torch.cuda.Stream()):
            found = envs[1].step(actions)
            torch.cuda.current_stream().synchronize()
        assert equal(expected, found)


@pytest.mark.gpu
@pytest.mark.parametrize("task", task_ids())
def test_on_cuda_a_graph_gives_the_same(task: str) -> None:
    envs, random = pair(task, num_envs=64, max_episode_steps=7), torch.Generator().manual_seed(0)
    assert equal(*(env.reset() for env in envs))
    for _ in range(12):
        assert equal(*acting(envs, random))
