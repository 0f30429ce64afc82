"""An iteration of PPO as one CUDA graph, on a simulated device and on a real one: the same bits as run as it is.

A graph repeats what was recorded on fixed addresses, and knows nothing of what Python does meanwhile.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning import ENVS, TIMING, assert_same_weights, ppo_settings, small_env
from population_cases import bodies, factory, small
from simulated_cuda import SimulatedCuda
from torch.utils._python_dispatch import TorchDispatchMode

from warpvox.algos.generators import Generators
from warpvox.algos.population.training import PopulationTraining
from warpvox.algos.ppo.iteration import Iteration
from warpvox.algos.training.bodies import Bodies, draw_bodies
from warpvox.algos.training.runner import Runner, Schedule, adapt

LIMIT = 7
"""Control steps of an episode: most iterations end some."""
ITERATIONS = 6
"""Two run as they are, one is captured, which stands for its first replay, the others are replayed."""
MOST_NODES = 2_500
"""Nodes that the graph of an iteration with 16 steps and 20 minibatches may have."""
TASKS = {
    "Walker-v0": {"normalize_reward": True},
    "Catcher-v0": {"bootstrap_time_limit": False, "clip_values": True},  # draws at random
    "UpStepper-v0": {"schedule": "linear", "activation": "elu"},
}
"""Tasks, and settings of PPO that differ from the defaults."""

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def cuda() -> Iterator[SimulatedCuda]:
    with SimulatedCuda() as found:
        yield found


@pytest.fixture(params=["simulated", pytest.param("real", marks=pytest.mark.gpu)])
def device(request: pytest.FixtureRequest) -> Iterator[None]:
    """A device ``cuda``, on which iterations are captured: with a failure it would be said that they are not."""
    with warnings.catch_warnings(), nullcontext() if request.param == "real" else SimulatedCuda():
        warnings.filterwarnings("error", message=".*cannot be captured")
        yield


def make_runner(task: str, graph: bool, ppo: dict[str, Any], total: int = ITERATIONS, **options: Any) -> Runner:
    settings = ppo_settings(**ppo)
    options = dict(device="cuda", layout="group", lanes=None, max_episode_steps=LIMIT, cuda_graph=graph) | options
    env = adapt(small_env(task=task, **options), settings)
    return Runner(env, settings, Schedule(total, evaluate=10**6), generators=Generators(3, "cuda"))


def rows_of(runner: Runner) -> list[dict[str, float]]:
    """The rows that the runner will report, but for the timing."""
    rows: list[dict[str, float]] = []
    runner.report = lambda row: rows.append({name: value for name, value in row.items() if name not in TIMING})
    return rows


def recorded(iteration: Iteration | None) -> bool:
    """True if iterations are replayed."""
    return iteration is not None and iteration.is_replayed


def assert_same(one: Any, other: Any) -> None:
    """Bit for bit."""
    if isinstance(one, torch.Tensor):
        assert torch.equal(one, other)
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            assert_same(one[name], other[name])
    else:
        assert one == other


def same_runs(runners: Sequence[Runner], iterations: int = ITERATIONS) -> None:
    """Have runners learn, and assert that they do the same."""
    rows = [rows_of(runner) for runner in runners]
    for _ in range(iterations):
        for runner in runners:
            runner.learn(1, init_at_random_ep_len=True)
        assert str(rows[0]) == str(rows[1])  # as text, because NaN is not equal to itself
        assert runners[0].logger.means == runners[1].logger.means
        assert_same_weights(*runners)
        assert_same(*(runner.env.state() for runner in runners))
        assert_same(*(runner.alg.save()["optimizer_state_dict"]["state"] for runner in runners))


@pytest.mark.parametrize("task", TASKS)
def test_captured_iterations_are_those_run_as_they_are(task: str, device: None) -> None:
    runners = [make_runner(task, graph, TASKS[task]) for graph in (False, True)]
    same_runs(runners)
    assert [recorded(runner._iteration) for runner in runners] == [False, True]


def test_captured_iterations_of_a_population_are_those_run_as_they_are(device: None) -> None:
    """Also where designs are dropped: the others are captured again."""
    designs = 3
    trainings = [
        PopulationTraining(
            factory().computed(device="cuda", cuda_graph=graph), bodies(designs), list(range(designs)), small()
        )
        for graph in (False, True)
    ]
    for number in range(2 * ITERATIONS):
        for training in trainings:
            training.iterate()
            if number == ITERATIONS:
                training.keep([0, 2])
        for design in range(trainings[0].num_designs):
            assert_same(*(training.policy(design) for training in trainings))
        assert_same(*(training.env.state() for training in trainings))
    assert [recorded(training._iterate) for training in trainings] == [False, True]


def test_the_host_waits_once_an_iteration_and_never_within(cuda: SimulatedCuda) -> None:
    runner = make_runner("Walker-v0", True, {})
    runner.learn(4)
    written = {("copy_", "warpvox.algos.ppo.adam", "prepare"): 1}  # beforehand, when the device has nothing to do
    with cuda.watched() as waits:
        runner._iteration()
    assert waits == written
    with cuda.watched() as waits, runner._own_torch():
        runner._iterate(end=10**6)
    assert waits == written | {("tolist", "warpvox.algos.ppo.iteration", "read"): 1}


def test_an_iteration_has_few_nodes(cuda: SimulatedCuda) -> None:
    """Each takes about 2 us on a GPU, whatever the number of environments."""
    usual = {"steps": 16, "hidden": [64, 64], "epochs": 5, "minibatches": 4}
    runner = make_runner("Walker-v0", True, usual, designs=["walker"])
    runner.learn(3)
    assert recorded(runner._iteration)
    assert len(cuda.captured[-1].tape.done) <= MOST_NODES


class Operations(TorchDispatchMode):
    """Names and shapes of all operations, in their order."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[tuple] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None) -> Any:
        found = func(*args, **(kwargs or {}))
        self.seen.append((func._schema.name, found.shape if isinstance(found, torch.Tensor) else None))
        return found


@pytest.mark.parametrize("task", TASKS)
def test_each_iteration_does_the_same_operations_on_the_same_shapes(task: str, cuda: SimulatedCuda) -> None:
    runner = make_runner(task, False, TASKS[task])
    runner.learn(2, init_at_random_ep_len=True)
    seen = []
    for _ in range(2):
        with Operations() as operations:
            runner._iteration()
        seen.append(operations.seen)
    assert seen[0] == seen[1]
    assert len(seen[0]) > 500


@pytest.mark.parametrize("task", ["Walker-v0", "UpStepper-v0"])
def test_a_resumed_run_is_the_run_that_was_not_interrupted(task: str, device: None) -> None:
    whole = make_runner(task, True, TASKS[task], total=9)
    whole.learn(9, init_at_random_ep_len=True)
    first = make_runner(task, True, TASKS[task], total=9)
    first.learn(4, init_at_random_ep_len=True)
    second = make_runner(task, True, TASKS[task], total=9)
    second.learn(1)  # what it has learned so far is dropped
    second.set_state(first.state())
    second.learn(5)
    assert_same_weights(whole, second)
    assert_same(whole.env.state(), second.env.state())


def test_bodies_are_exchanged_between_captured_iterations(device: None) -> None:
    runners = []
    for graph in (False, True):
        pool = draw_bodies(12, (3, 3), np.random.default_rng(0))
        others = Bodies(pool, "performance", np.random.default_rng(0))
        options = dict(designs=others.first(ENVS), obs="voxel", grid=(3, 3))
        runner = make_runner("Walker-v0", graph, {}, **options)
        runner.bodies = others
        runners.append(runner)
    same_runs(runners)
    assert_same(*(runner.bodies.state(runner.env) for runner in runners))
    assert runners[0].bodies.seen > ENVS
    assert [recorded(runner._iteration) for runner in runners] == [False, True]


def test_a_capture_that_fails_is_said_once_and_learning_goes_on(cuda: SimulatedCuda, monkeypatch) -> None:
    @contextmanager
    def failing(*_: Any, **__: Any) -> Iterator[None]:
        algorithm = runners[1]._iteration.algorithm
        algorithm.storage.step = 3
        for generator in algorithm.streams.generators:
            generator.is_stuck = True
        raise RuntimeError("operation failed due to a previous error during capture")
        yield

    runners = [make_runner("Walker-v0", graph, {}) for graph in (False, True)]
    runners[1].learn(1)  # the control step has been captured
    runners[0].learn(1)
    monkeypatch.setattr(torch.cuda, "graph", failing)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        same_runs(runners, 4)
    assert ["Iterations of PPO cannot be captured" in str(warning.message) for warning in said] == [True]


@pytest.mark.parametrize(
    "changes",
    [{"rnn": {"rnn_type": "gru", "rnn_hidden_dim": 4}}, {"extra": {"normalize_advantage_per_mini_batch": True}}, None],
    ids=["rnn", "extra", "cpu"],
)
def test_rsl_rl_learns_all_else(changes: dict | None, cuda: SimulatedCuda) -> None:
    if "rnn" in (changes or {}) and torch.version.cuda is not None:
        pytest.skip("cuDNN's layers cannot be simulated")
    options = {"device": "cpu", "cuda_graph": None} if changes is None else {}
    runner = make_runner("Walker-v0", False, changes or {}, **options)
    runner.learn(1)
    assert runner._iteration is None


def test_the_pretrained_network_is_gone_on_from(cuda: SimulatedCuda, tmp_path: Path) -> None:
    source = make_runner("Walker-v0", True, {})
    source.learn(2)
    state = source.state()
    runner = make_runner("Walker-v0", True, {})
    runner.learn(1)
    runner.begin_with(state, optimizer=True)
    assert_same_weights(source, runner)
    runner.learn(1)
    steps = source.alg.optimizer.state_dict()["state"][0]["step"]
    assert runner.alg.optimizer.state_dict()["state"][0]["step"] == 1.5 * steps


@pytest.mark.gpu
@pytest.mark.parametrize("graphs", [(True, True), (False, True)], ids=["twice", "as it is"])
def test_on_cuda_the_same_seed_gives_the_same_weights(graphs: tuple[bool, bool]) -> None:
    """In networks and batches of the size that they usually have."""
    usual = {"steps": 16, "hidden": [64, 64], "epochs": 5, "minibatches": 4}
    runners = [make_runner("Walker-v0", graph, usual, 20, num_envs=512, designs=["walker"]) for graph in graphs]
    for runner in runners:
        runner.learn(20, init_at_random_ep_len=True)
    assert recorded(runners[1]._iteration)
    assert_same_weights(*runners)
