"""The control step as one CUDA graph, as far as a machine without a GPU can tell.

A graph repeats what was recorded on fixed addresses. Here the recording is played by a function that runs the step
again on the same tensors: what the environment forgets to carry, or takes from elsewhere, makes a difference.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from warpvox.envs.graph import StepGraph
from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec

# Operations that read a value on the host, give a result whose size does, or bring data from the host.
WAITING = (
    "_local_scalar_dense",
    "nonzero",
    "masked_select",
    "unique",
    "lift_fresh",
    "scalar_tensor",
    "repeat_interleave",
)


class Watch(TorchDispatchMode):
    """Collects operations that would wait for a GPU."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: set[str] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None) -> Any:
        name = str(func)
        by_mask = name.startswith(("aten.index.", "aten.index_put")) and any(
            isinstance(index, torch.Tensor) and index.dtype == torch.bool for index in args[1]
        )
        if by_mask or any(word in name for word in WAITING):
            self.waiting.add(f"{name} by a mask" if by_mask else name)
        return func(*args, **(kwargs or {}))


def make(task: str, **options: Any) -> VoxelVecEnv:
    env = make_vec(task, num_envs=3, device="cpu", threads=1, max_episode_steps=5, **options)
    env._may_look = False  # as on CUDA
    return env


@pytest.mark.parametrize("rules", ["evogym", "paper"])
@pytest.mark.parametrize("task", task_ids())
def test_no_step_waits_for_the_device(task: str, rules: str) -> None:
    for auto_reset in (True, False):
        env = make(task, rules=rules, auto_reset=auto_reset)
        env.reset()
        env.step(torch.ones((3, env.num_actions)))  # tables are made on first use
        env.sim.take(torch.ones((3, env.num_actions)))  # looks at actions that are on the CPU already
        with Watch() as watch:
            env._whole_step()
        assert not watch.waiting


def test_what_waits_is_noticed() -> None:
    values = torch.arange(3.0)
    with Watch() as watch:
        values[values > 1]
        values.sum().item()
        values.new_tensor([1.0])
    assert len(watch.waiting) == 3


def replayed(env: VoxelVecEnv) -> Callable:
    """A recording that is played by running the step on the same tensors."""

    def copy(source: Any, target: Any) -> None:
        if isinstance(source, torch.Tensor):
            target.copy_(source)
        else:
            for name in source if isinstance(source, dict) else range(len(source)):
                copy(source[name], target[name])

    def capture(body: Callable[[], None]) -> Callable[[], None]:
        graph = env._graph
        state, fixed = env.sim.state(), {name: value.clone() for name, value in graph._fixed.items()}
        body()
        env.sim.set_state(state)  # a recording does nothing
        copy(fixed, graph._fixed)
        results = graph._results

        def replay() -> None:
            env._carry(graph._fixed)
            body()
            copy(graph._results, results)
            graph._results = results

        return replay

    return capture


def equal(one: Any, other: Any) -> bool:
    if isinstance(one, torch.Tensor):
        return torch.equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[name], other[name]) for name in one)
    return len(one) == len(other) and all(map(equal, one, other))


@pytest.mark.parametrize("auto_reset", [True, False])
@pytest.mark.parametrize("task", ["Walker-v0", "BidirectionalWalker-v0", "Catcher-v0", "Balancer-v1", "UpStepper-v0"])
def test_replays_are_equal_to_plain_steps(task: str, auto_reset: bool) -> None:
    plain, graphed = make(task, auto_reset=auto_reset), make(task, auto_reset=auto_reset)
    graphed._graph = StepGraph(graphed, replayed(graphed))
    random = torch.Generator().manual_seed(0)
    kept = []
    for step in range(24):
        if step == 9:
            assert equal(plain.reset(seed=5), graphed.reset(seed=5))
        if step == 14:
            for env in (plain, graphed):
                env.episode_length = torch.tensor([0, 1, 2])
        if step == 18:
            state = plain.state()
            plain.set_state(state)
            graphed.set_state(state)
        actions = 0.6 + torch.rand((3, plain.num_actions), generator=random)
        expected, found = plain.step(actions), graphed.step(actions)
        assert equal(expected, found), step
        assert equal(plain.memory, graphed.memory)
        kept.append((found, expected))
    assert graphed._graph._replay is not None
    assert all(equal(found, expected) for found, expected in kept), "results must stay as they were returned"


def test_what_is_not_carried_would_be_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    plain, graphed = make("Walker-v0"), make("Walker-v0")
    graphed._graph = StepGraph(graphed, replayed(graphed))
    whole = VoxelVecEnv._carried
    monkeypatch.setattr(
        VoxelVecEnv, "_carried", lambda env: whole(env) | {"return": torch.zeros(3, dtype=torch.float64)}
    )
    actions = torch.full((3, plain.num_actions), 1.6)
    assert not all(equal(plain.step(actions), graphed.step(actions)) for _ in range(5))


def test_there_is_no_graph_on_the_cpu() -> None:
    env = make_vec("Walker-v0", device="cpu", cuda_graph=True)
    assert env._graph is None


@pytest.mark.gpu
@pytest.mark.parametrize("task", task_ids())
def test_on_cuda_a_graph_gives_the_same(task: str) -> None:
    random = torch.Generator().manual_seed(0)
    envs = [
        make_vec(task, num_envs=64, device="cuda", max_episode_steps=7, cuda_graph=graph) for graph in (False, True)
    ]
    assert equal(*(env.reset() for env in envs))
    for _ in range(12):
        actions = (0.6 + torch.rand((64, envs[0].num_actions), generator=random)).cuda()
        assert equal(*(env.step(actions) for env in envs))
