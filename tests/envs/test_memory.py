"""The memory that environments need is known before they are made, and what does not fit is refused."""

import re
from collections.abc import Callable

import numpy as np
import pytest
import torch

import warpvox as wv
from warpvox.batch.options import SimOptions
from warpvox.design import sample_design
from warpvox.envs import memory
from warpvox.envs.memory import environment_bytes
from warpvox.envs.registry import get_task
from warpvox.envs.vec_env import make_vec
from warpvox.envs.worlds import task_world
from warpvox.errors import DeviceError, MemoryLimitError
from warpvox.simulation import Simulation

BODIES = [sample_design((5, 5), seed=seed) for seed in range(4)]
GIB = 2**30


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> Callable[[float | None], None]:
    """``free(bytes)``: what the machine has left."""
    return lambda size: monkeypatch.setattr(memory, "free_memory", lambda device: size)


@pytest.mark.parametrize(
    ("task", "bodies", "count", "options"),
    [
        ("Traverser-v0", ["walker"], 96, {}),
        ("Carrier-v0", BODIES, 128, {}),
        ("Walker-v0", BODIES, 128, {"dtype": "float64"}),
        ("Walker-v0", [[[3, 4]]], 32, {"grid": (20, 20)}),
    ],
)
def test_the_estimate_is_what_the_arrays_take_and_a_little_more(task, bodies: list, count: int, options: dict) -> None:
    env = make_vec(task, bodies, count, device="cpu", threads=1, **options)
    taken = sum(array.capacity for array in env.sim.buffers.arrays.values())
    worlds = [task_world(get_task(task), wv.load_design(body)) for body in bodies]
    each = environment_bytes(get_task(task), worlds, count, SimOptions("cpu", **options).resolved(count))
    mixed = env.sim.arithmetic == "fast" and len(bodies) > 1  # room for all that their common grid may hold
    assert 0.95 < each * count / taken < (2 if mixed else 1.3)


def fits(error: pytest.ExceptionInfo) -> int:
    return int(re.search(r"num_envs=(\d+)\.", str(error.value))[1])


@pytest.mark.parametrize("options", [{"body": "walker"}, {"designs": [[[3, 4]]], "grid": (100, 100)}])
def test_what_does_not_fit_is_refused_before_anything_is_made(monkeypatch, free: Callable, options: dict) -> None:
    monkeypatch.setattr(Simulation, "__init__", lambda *words, **options: pytest.fail("made"))
    free(GIB)
    with pytest.raises(MemoryLimitError) as refused:
        make_vec("Walker-v0", num_envs=1_000_000, device="cpu", **options)
    assert isinstance(refused.value, DeviceError)
    assert 32 < fits(refused) < 500_000


def test_the_advice_fits_and_can_be_ignored(free: Callable) -> None:
    free(4_000_000)
    with pytest.raises(MemoryLimitError) as refused:
        make_vec("Walker-v0", designs=["walker", "worm"], num_envs=256, device="cpu", threads=1)
    assert fits(refused) % 2 == 0
    make_vec("Walker-v0", designs=["walker", "worm"], num_envs=fits(refused), device="cpu", threads=1)
    free(1)
    with pytest.raises(MemoryLimitError):
        make_vec("Walker-v0", "walker", 8, device="cpu", threads=1)
    make_vec("Walker-v0", "walker", 8, device="cpu", threads=1, memory_check=False)
    free(None)  # nobody knows: all is tried
    make_vec("Walker-v0", "walker", 8, device="cpu", threads=1)


def test_a_grid_that_no_array_could_hold_is_refused() -> None:
    with pytest.raises(MemoryLimitError):
        make_vec("Walker-v0", [[[3]]], 1, device="cpu", grid=(1000, 1000))


def test_learning_counts_what_it_keeps() -> None:
    spec = get_task("Walker-v0")
    worlds, ppo = [task_world(spec, np.full((5, 5), 3))], lambda: None
    ppo.steps, ppo.hidden, ppo.minibatches = 64, [64, 64], 4
    sim = SimOptions("cpu").resolved(512)
    plain, learning = (environment_bytes(spec, worlds, 512, sim, ppo=what) for what in (None, ppo))
    env = make_vec(spec, [np.full((5, 5), 3)], 1, device="cpu", threads=1)
    rollout = torch.zeros(ppo.steps, env.num_obs + 3 * env.num_actions).nbytes
    assert rollout < learning - plain < 3 * rollout
