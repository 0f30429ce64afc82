"""The control step as one CUDA graph, as far as a machine without a GPU can tell.

A graph repeats what was recorded on fixed addresses, and knows nothing of what Python does meanwhile. Here a recording
of torch's operations and Warp's launches is played on the CPU in the same way.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
import warp as wp
from simulated_cuda import Tape

from warpvox.envs.graph import StepGraph
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import observes, rewards
from warpvox.envs.terms.observations import orientation
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ConfigError
from warpvox.view.rollout import record


def make(task: Any, **options: Any) -> VoxelVecEnv:
    env = make_vec(task, num_envs=3, device="cpu", threads=1, max_episode_steps=5, **options)
    env._on_cpu = False  # as on CUDA
    return env


def taping(env: VoxelVecEnv, monkeypatch: pytest.MonkeyPatch) -> Callable:
    """A way to capture steps of ``env`` on the CPU."""
    launched = wp.launch, wp.Launch.launch

    def capture(step: Callable[[], Any]) -> tuple[Callable[[], None], Any]:
        kept = env.state(), [buffer.clone() for buffer in env.sim.sensing_buffers]
        drawn, tape, inside = env.episodes.drawn, Tape(), []

        def launch(*args: Any, **options: Any) -> Any:
            assert not options.get("record_cmd"), "the first steps record all launches"
            tape.done.append(lambda: launched[0](*args, **options))
            inside.append(True)
            launched[0](*args, **options)
            inside.pop()

        def relaunch(command: Any) -> None:
            if not inside:
                tape.done.append(lambda: launched[1](command))
            launched[1](command)

        with monkeypatch.context() as patch, tape:
            patch.setattr(wp, "launch", launch)
            patch.setattr(wp.Launch, "launch", relaunch)
            results = step()
        env.set_state(kept[0])  # a recording does nothing
        env.episodes.drawn = drawn
        for buffer, value in zip(env.sim.sensing_buffers, kept[1], strict=True):
            buffer.copy_(value)
        return tape.play, results

    return capture


def graphed(task: Any, monkeypatch: pytest.MonkeyPatch, **options: Any) -> VoxelVecEnv:
    """Environments whose steps are replayed from a tape."""
    env = make(task, **options)
    env._graph = StepGraph(env._whole_step, taping(env, monkeypatch))
    return env


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
    actions = 0.6 + torch.rand((3, envs[0].num_actions), generator=random)
    return [env.step(actions) for env in envs]


def start_again(env: VoxelVecEnv) -> Any:
    return env.reset(seed=5)


def start_some(env: VoxelVecEnv) -> Any:
    return env.reset(mask=torch.tensor([False, True, True]))


def shift_lengths(env: VoxelVecEnv) -> Any:
    env.episode_length = torch.tensor([0, 1, 2])


def write_lengths(env: VoxelVecEnv) -> Any:
    env.episode_length[1] = 4


def take_back(env: VoxelVecEnv) -> Any:
    env.set_state(env.state())


def wait(env: VoxelVecEnv) -> Any:
    env.auto_reset = not env.auto_reset


def shorten(env: VoxelVecEnv) -> Any:
    env.max_episode_steps = 3


def look(env: VoxelVecEnv) -> Any:
    return env.sim.com("robot"), env.sim.velocity("robot")


def film(env: VoxelVecEnv) -> Any:
    rollout = record(env, "random", 4)
    return torch.from_numpy(rollout.positions), torch.from_numpy(rollout.terminated | rollout.truncated)


MEDDLING = (start_again, start_some, shift_lengths, take_back, film, write_lengths, look, wait, shorten, film)


@pytest.mark.parametrize("auto_reset", [True, False])
@pytest.mark.parametrize("task", ["Walker-v0", "BidirectionalWalker-v0", "Catcher-v0", "Balancer-v1", "UpStepper-v0"])
def test_replays_are_equal_to_plain_steps(task: str, auto_reset: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is done between steps: a recording that missed it would give something else."""
    envs = make(task, auto_reset=auto_reset), graphed(task, monkeypatch, auto_reset=auto_reset)
    random = torch.Generator().manual_seed(0)
    kept = []
    for meddle in (None, *MEDDLING):
        if meddle is not None:
            told = [meddle(env) for env in envs]
            assert told[0] is None or equal(*told), meddle.__name__
        for step in range(5):
            results = acting(envs, random)
            assert equal(*results), (meddle, step)
            assert equal(*(env.memory for env in envs))
            assert equal(*(look(env) for env in envs))
            kept.append(results)
        assert equal(*(env.state() for env in envs))
    assert set(envs[1]._graph.recorded) == {True, False}
    assert all(equal(*results) for results in kept), "results must stay as they were returned"


@pytest.mark.parametrize("obs", ["task", "timed", "voxel"])
def test_other_bodies_are_seen_by_a_recording(obs: str, monkeypatch: pytest.MonkeyPatch) -> None:
    envs = [
        made("Walker-v0", grid=(5, 7), obs=obs) for made in (make, functools.partial(graphed, monkeypatch=monkeypatch))
    ]
    random = torch.Generator().manual_seed(0)
    for body in ("walker", "mini", "worm"):
        mask = torch.tensor([False, True, body != "mini"])
        assert equal(*(env.set_designs([body], mask) for env in envs))
        for _ in range(4):
            assert equal(*acting(envs, random))
    assert envs[1]._graph.recorded


def test_what_was_sensed_between_steps_is_not_taken_for_the_present(monkeypatch: pytest.MonkeyPatch) -> None:
    """The step of a task that does not ask for centres leaves those that somebody else has asked for."""

    def widest(before: Any, after: Any, name: str) -> torch.Tensor:
        return after.extent(name)[:, 0]

    spec = replace(get_task("Walker-v0"), observations=(observes(orientation),), rewards=(rewards(widest),))
    envs = make(spec), graphed(spec, monkeypatch)
    random = torch.Generator().manual_seed(0)
    for _ in range(6):
        assert equal(*acting(envs, random))
        assert equal(*(look(env) for env in envs))
    assert envs[1]._graph.recorded


def held(env: VoxelVecEnv) -> dict[str, int]:
    """Where all tensors lie that environments and their parts hold."""
    places: dict[str, int] = {}
    seen: set[int] = set()

    def walk(value: Any, name: str) -> None:
        if isinstance(value, torch.Tensor):
            places[name] = value.data_ptr()
        elif id(value) not in seen and not isinstance(value, type):
            seen.add(id(value))
            if isinstance(value, dict):
                for key, item in value.items():
                    walk(item, f"{name}[{key}]")
            elif isinstance(value, (list, tuple)):
                for number, item in enumerate(value):
                    walk(item, f"{name}[{number}]")
            elif type(value).__module__.startswith("warpvox.") and hasattr(value, "__dict__"):
                for key, item in vars(value).items():
                    walk(item, f"{name}.{key}")

    walk(env, "env")
    return places


@pytest.mark.parametrize("task", ["Walker-v0", "Catcher-v0", "Balancer-v1"])
def test_tensors_stay_where_they_are(task: str) -> None:
    env = make(task)
    env.reset()
    for _ in range(2):
        acting((env,), torch.Generator().manual_seed(0))
    places = held(env)
    assert {"env.episodes.length", "env.episodes.returns", "env.sim._actions"} <= places.keys()
    for meddle in MEDDLING:
        meddle(env)
        acting((env,), torch.Generator().manual_seed(0))
        now = held(env)  # new ones may come, for what is sensed for the first time
        assert {name: now.get(name) for name in places} == places, meddle.__name__


@pytest.mark.parametrize("name", ["length", "returns", "terminated"])
def test_what_is_replaced_would_be_noticed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    envs = make("Walker-v0", auto_reset=False), graphed("Walker-v0", monkeypatch, auto_reset=False)
    random = torch.Generator().manual_seed(0)
    assert all(equal(*acting(envs, random)) for _ in range(4))
    for env in envs:
        setattr(env.episodes, name, torch.ones_like(getattr(env.episodes, name)))
    assert not all(equal(*acting(envs, random)) for _ in range(3))


@pytest.mark.parametrize("limit", [0, 2.5, True, "many"])
def test_a_time_limit_is_a_number_of_steps(limit: Any) -> None:
    env = make("Walker-v0")
    with pytest.raises(ConfigError, match="max_episode_steps must be an integer >= 1"):
        env.max_episode_steps = limit
    with pytest.raises(ConfigError, match=r"episode_length must be integers \[3\]"):
        env.episode_length = torch.zeros(2, dtype=torch.long)


@pytest.mark.gpu
@pytest.mark.parametrize("task", ["Walker-v0", "Catcher-v0", "Balancer-v1", "UpStepper-v0"])
def test_on_cuda_a_graph_misses_nothing_that_is_done_between_steps(task: str) -> None:
    options = dict(device="cuda", max_episode_steps=5)
    envs = tuple(make_vec(task, num_envs=3, cuda_graph=graph, **options) for graph in (False, True))
    random = torch.Generator().manual_seed(0)
    for meddle in MEDDLING:
        told = [meddle(env) for env in envs]
        assert told[0] is None or equal(*told), meddle.__name__
        for step in range(5):
            assert equal(*acting(envs, random)), (meddle, step)
        assert equal(*(env.state() for env in envs))


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
    random = torch.Generator().manual_seed(0)
    envs = [
        make_vec(task, num_envs=64, device="cuda", max_episode_steps=7, cuda_graph=graph) for graph in (False, True)
    ]
    assert equal(*(env.reset() for env in envs))
    for _ in range(12):
        actions = (0.6 + torch.rand((64, envs[0].num_actions), generator=random)).cuda()
        assert equal(*(env.step(actions) for env in envs))
