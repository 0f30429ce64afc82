"""The host side of a CUDA device, on a simulated one: no mix of devices, no wait in a step, one stream.

Its arithmetic is that of the group layout on the CPU, which equals the lanes bit for bit.
"""

from __future__ import annotations

import functools
import gc
import warnings
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import gymnasium
import pytest
import torch
from learning import stock_ppo
from population_cases import training_preset
from simulated_cuda import SimulatedCuda, Stream
from tiny import tiny

from warpvox.algos import evaluate as evaluation
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.population.training import PopulationTraining
from warpvox.algos.ppo.stock import PPO
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.batch.options import SimOptions
from warpvox.cli.config import load
from warpvox.design import example_design
from warpvox.devices import names
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import MemoryLimitError
from warpvox.view.rollout import record

ENVS, LIMIT, STEPS = 4, 4, 6
BODY = example_design("mini")


@pytest.fixture
def cuda() -> Iterator[SimulatedCuda]:
    with SimulatedCuda() as found:
        yield found


def life(task: str, device: str, step: Callable[[VoxelVecEnv, torch.Tensor], tuple], **options: Any) -> list:
    """All that is done with environments; what they gave."""
    grid = (BODY.shape[0], BODY.shape[1] + 1)
    common = dict(device=device, max_episode_steps=LIMIT, layout="group", threads=1, grid=grid)
    env = make_vec(task, [BODY], ENVS, **(common | options))
    random, given = torch.Generator().manual_seed(0), [env.reset(seed=3)[0]]

    def go(steps: int) -> None:
        for _ in range(steps):
            actions = 0.6 + torch.rand((ENVS, env.num_actions), generator=random)
            given.extend(step(env, actions.to(env.device))[:4])

    mask = torch.arange(ENVS, device=env.device) > 1
    go(STEPS)
    given.append(env.reset(mask=mask)[0])
    env.set_state(env.state())
    given.append(torch.from_numpy(record(env, "zero", 2).positions))
    other = BODY.copy()
    other[0, 0] = 0 if other[0, 0] else 3
    given.append(env.set_designs([other], mask))
    go(STEPS)
    assert env.not_finite() == {}
    return [value.cpu() for value in given]


def check_life(task: str, cuda: SimulatedCuda, **options: Any) -> None:
    def plain(env: VoxelVecEnv, actions: torch.Tensor) -> tuple:
        return env.step(actions)

    def watched(env: VoxelVecEnv, actions: torch.Tensor) -> tuple:
        cuda.stream = Stream(number=cuda.stream.cuda_stream + 1)  # launches must be on torch's current one
        capturing = env._graph is not None and not env._graph._recorded
        with cuda.watched() as waits:
            found = env.step(actions)
        assert capturing or not waits
        assert {value.device.type for value in found[:4]} == {"cuda"}
        return found

    expected = life(task, "cpu", plain, **options)
    found = [life(task, "cuda", watched, cuda_graph=graph, **options) for graph in (False, True)]
    assert all(torch.equal(one, other) for one, other in zip(expected, found[0], strict=True))
    assert all(torch.equal(one, other) for one, other in zip(*found, strict=True))
    assert [graph.replays > 1 for graph in cuda.captured] == [True] * len(cuda.captured) != []


@pytest.mark.parametrize(
    ("task", "options"),
    [
        ("Walker-v0", {"obs": "timed_voxel"}),
        ("Catcher-v0", {"auto_reset": False}),
        ("Balancer-v1", {}),
        ("UpStepper-v0", {"rules": "paper"}),
    ],
)
def test_environments_do_what_they_do_on_the_cpu(task: str, options: dict, cuda: SimulatedCuda) -> None:
    check_life(task, cuda, **options)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"auto_reset": False}, {"obs": "voxel"}, {"rules": "paper"}], ids=str)
@pytest.mark.parametrize("task", task_ids())
def test_all_tasks_do_what_they_do_on_the_cpu(task: str, options: dict, cuda: SimulatedCuda) -> None:
    check_life(task, cuda, **options)


@pytest.mark.slow
@pytest.mark.parametrize("task", ["Walker-v0", "Climber-v1"])
def test_the_group_kernel_of_cuda_has_room_for_its_worlds(task: str) -> None:
    with SimulatedCuda(own_capacities=True):
        env = make_vec(task, num_envs=ENVS, device="cuda")
        assert env.sim.layout == "group"
        assert env.sim.buffers.group.approximate
        obs = env.reset()[0]
        for _ in range(STEPS):
            obs, *_ = env.step(torch.ones((ENVS, env.num_actions), device=env.device))
        assert bool(torch.isfinite(obs).all())


def test_a_capture_that_fails_is_said_once_and_steps_go_on(cuda: SimulatedCuda, monkeypatch) -> None:
    @contextmanager
    def failing(graph: Any, stream: Any, capture_error_mode: str) -> Iterator[None]:
        cuda.stream = stream  # which torch leaves current
        raise RuntimeError("operation failed due to a previous error during capture")
        yield

    envs = [make_vec("Walker-v0", [BODY], ENVS, device="cuda", cuda_graph=graph) for graph in (False, True)]
    monkeypatch.setattr(torch.cuda, "graph", failing)
    actions = torch.ones((ENVS, envs[0].num_actions), device="cuda")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for _ in range(STEPS):
            plain, graphed = (env.step(actions) for env in envs)
            assert torch.equal(plain[0], graphed[0])
    assert ["cannot be captured as a CUDA graph" in str(warning.message) for warning in said] == [True]
    assert cuda.stream.cuda_stream == 0


def test_environments_end_with_their_last_name(cuda: SimulatedCuda) -> None:
    """Else their memory on the device would wait for Python to look for cycles."""
    gc.disable()
    try:
        env = make_vec("Walker-v0", [BODY], ENVS, device="cuda")
        env.step(torch.ones((ENVS, env.num_actions), device="cuda"))
        alive = weakref.ref(env.sim)
        del env
        assert alive() is None
    finally:
        gc.enable()


@pytest.mark.parametrize(("task", "most"), [("Walker-v0", 30), ("Carrier-v0", 40), ("Catcher-v0", 70)])
def test_a_step_is_a_graph_of_few_nodes(task: str, most: int, cuda: SimulatedCuda) -> None:
    """Each costs about 2 microseconds, whatever it computes; terms are most of them."""
    env = make_vec(task, [BODY], ENVS, device="cuda")
    for _ in range(3):
        env.step(torch.ones((ENVS, env.num_actions), device="cuda"))
    assert len(cuda.captured[-1].tape.done) <= most


def test_gymnasium_and_stable_baselines_take_arrays_of_the_host(cuda: SimulatedCuda) -> None:
    env = gymnasium.make_vec("warpvox/Walker-v0", num_envs=3, body=BODY, device="cuda", dtype="float32")
    env.reset(seed=0)
    obs, reward, *_ = env.step(env.action_space.sample())
    assert obs.shape[0] == len(reward) == 3
    sb3 = pytest.importorskip("warpvox.envs.adapters.sb3")
    env = sb3.VoxelSB3VecEnv("Walker-v0", num_envs=3, body=BODY, device="cuda", max_episode_steps=2)
    env.reset()
    for _ in range(2):
        *_, done, infos = env.step(env.action_space.sample()[None].repeat(3, 0))
    assert done.all()
    assert "terminal_observation" in infos[0]
    assert cuda.launches["group_step"] == 3


def test_what_does_not_fit_is_refused_before_it_is_made(cuda: SimulatedCuda, monkeypatch: pytest.MonkeyPatch) -> None:
    """Free memory is what the driver says and what torch has cached."""
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (2**30, 2**32))
    monkeypatch.setattr(torch.cuda, "memory_reserved", lambda device: 3 * 2**20)
    monkeypatch.setattr(torch.cuda, "memory_allocated", lambda device: 2**20)
    with pytest.raises(MemoryLimitError):
        make_vec("Walker-v0", num_envs=150_000, device="auto")
    assert not cuda.operations["zeros"]


@pytest.mark.parametrize("words", ["policy=mlp", "policy=grid", "policy=transformer obs=timed"])
def test_a_training_ends_and_no_step_of_it_waits(words: str, cuda: SimulatedCuda, warpvox, monkeypatch) -> None:
    """Control steps are a graph; policies for voxels bring no tables; the CPU evaluates."""
    evaluated, waits = [], []

    def watched(owner: type, name: str) -> None:
        method = getattr(owner, name)

        def watch(*args: Any) -> Any:
            with cuda.watched() as seen:
                found = method(*args)
            waits.append(dict(seen))
            return found

        monkeypatch.setattr(owner, name, watch)

    def evaluate(env: VoxelVecEnv, policy: Any, **options: Any) -> Any:
        evaluated.append(env.device)
        launched = cuda.launches.total()
        env.max_episode_steps = 3
        found = evaluation_of(env, policy, **options)
        assert cuda.launches.total() == launched
        return found

    evaluation_of = evaluation.evaluate
    watched(PPO, "act")
    watched(PPO, "process_env_step")
    watched(RslRlVecEnv, "step")
    monkeypatch.setattr(evaluation, "evaluate", evaluate)
    warpvox(*tiny("train", "device=cuda", "num_envs=4", "max_iterations=2", "ppo.minibatches=1", *words.split()))
    assert evaluated == ["cpu"]
    assert len(cuda.captured) == 1
    later = waits[len(waits) // 2 :]  # in the first iteration kernels are loaded, and a graph is captured
    assert later == [{}] * len(later)
    assert later
    assert cuda.launches["group_step"] > 0


def settings(steps: int = STEPS) -> Any:
    return load("train", [f"ppo.steps={steps}"]).ppo


def runner(num_envs: int = ENVS) -> Runner:
    env = make_vec("Walker-v0", [BODY], num_envs, device="cuda", max_episode_steps=3, cuda_graph=False)
    return Runner(adapt(env, settings()), settings(), Schedule(total=10, evaluate=10**9))


def counted(cuda: SimulatedCuda, part: Callable[[], Any]) -> tuple[int, int, int]:
    """Waits, operations and launches, once buffers are made."""
    part()
    before = cuda.operations.total(), cuda.launches.total()
    with cuda.watched() as waits:
        part()
    return waits.total(), cuda.operations.total() - before[0], cuda.launches.total() - before[1]


def test_an_update_waits_no_more_often_than_rsl_rls(cuda: SimulatedCuda) -> None:
    found, env = [], runner().env
    for algorithm in (runner().alg, stock_ppo(env, settings(), "cuda:0")):

        def update(algorithm: Any = algorithm) -> None:
            obs = env.get_observations()
            with torch.inference_mode():
                for _ in range(STEPS):
                    obs, rewards, dones, extras = env.step(algorithm.act(obs))
                    algorithm.process_env_step(obs, rewards, dones, extras)
                algorithm.compute_returns(obs)
            algorithm.update()

        found.append(counted(cuda, update))
    ours, theirs = found
    assert theirs[0] >= settings().epochs * settings().minibatches
    assert ours[0] <= theirs[0]


def test_launches_do_not_depend_on_the_number_of_environments(cuda: SimulatedCuda) -> None:
    found = []
    for num_envs in (8, 32):
        made = runner(num_envs)
        made.alg.schedule = "fixed"  # rsl-rl's other one compares the divergence with one bound or with two
        found.append(counted(cuda, functools.partial(made.learn, 1)))
    assert found[0] == found[1]


def test_a_population_is_trained_and_evaluated_on_one_device(cuda: SimulatedCuda, monkeypatch) -> None:
    """With ``auto`` its few evaluations would otherwise be on the CPU, and its networks on the device."""
    monkeypatch.setattr(names, "ENOUGH", 10)
    monkeypatch.setattr(evaluation.VoxelVecEnv, "max_episode_steps", 3)
    settings = training_preset("fast", {"steps": 2}, envs=8)
    factory = EnvFactory(replace(get_task("Walker-v0"), max_episode_steps=3), sim=SimOptions(threads=1))
    waits = []
    for steps in (2, 4):
        settings.ppo.steps = steps
        training = PopulationTraining(factory, [BODY] * 2, [0, 1], settings)
        training.iterate()  # in the first iteration buffers are made
        with cuda.watched() as seen:
            training.iterate()
        waits.append(dict(seen))
    assert waits[0] == waits[1], "more steps, and as many waits"
    assert training.env.device == training._judge.device == "cuda:0"
    assert bool(torch.isfinite(training.evaluate()).all())
