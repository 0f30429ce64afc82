"""Evaluation on Ray: on two nodes, with workers that die, the results are those of this process."""

import functools
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import parallel
import pytest
from codesign_toys import POPULATION, ToyEvaluator, make_loop
from refusals import refused

from warpvox.algos.archive import Archive
from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.codesign.loop import Batch
from warpvox.algos.listener import Listener
from warpvox.errors import ConfigError, RunError

ray = pytest.importorskip("ray", reason="Ray is not installed")

from warpvox.algos.codesign import ray_executor  # noqa: E402

PLACES = os.pathsep.join([str(Path(__file__).parent), *sys.path])
"""Where workers find the modules of the tests, as this process does."""
pytestmark = pytest.mark.usefixtures("alone")


class Mortal(ToyEvaluator):
    """Ends its process once at each of some candidates."""

    def __init__(self, folder: Path, fatal: Sequence[int]) -> None:
        super().__init__(seconds=0.05)
        self.folder, self.fatal = folder, fatal

    def evaluate(self, candidates: Sequence[Candidate], *more: Any) -> list[Outcome]:
        number = candidates[0].id
        mark = self.folder / f"died_{number}"
        if number in self.fatal and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super().evaluate(candidates, *more)


class Failing(ToyEvaluator):
    """Fails in three ways, by candidate."""

    def evaluate(self, candidates: Sequence[Candidate], *more: Any) -> list[Outcome]:
        if candidates[0].id == 0:
            raise RunError("Learning diverged.")
        if candidates[0].id == 1:
            raise ZeroDivisionError("a defect")
        os.kill(os.getpid(), signal.SIGKILL)
        return []


@pytest.fixture(scope="module")
def alone() -> Iterator[None]:
    """One cluster at a time, also where tests run in several processes: its head has a port that is its own."""
    with parallel.turn("ray"), pytest.MonkeyPatch.context() as patch:
        patch.setattr(ray_executor, "POLL_SECONDS", 0.05)
        yield


def test_no_cluster_and_no_ray_are_clear_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    with refused(RunError, "127.0.0.1:1"):
        ray_executor.RayExecutor(ToyEvaluator, address="127.0.0.1:1")
    monkeypatch.setitem(sys.modules, "ray", None)
    with refused(ConfigError, "warpvox[ray]"):
        ray_executor.RayExecutor(ToyEvaluator)


def test_started_here_and_without_room(tmp_path: Path, undisturbed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", PLACES)
    with refused(RunError, "a worker takes 1 and 64"):
        ray_executor.RayExecutor(ToyEvaluator, gpus=64)
    handler = signal.getsignal(signal.SIGTERM)
    executor = ray_executor.RayExecutor(functools.partial(ToyEvaluator, 0.0), workers=2)
    assert signal.getsignal(signal.SIGTERM) is handler  # a request to end is ours to answer, not Ray's
    loop = make_loop(tmp_path, executor=executor)
    loop.run()
    executor.close()
    with Archive.read(loop.archive.path) as archive:
        assert archive.digest() == undisturbed


def test_errors_of_an_evaluator_come_through_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", PLACES)
    monkeypatch.setattr(ray_executor, "MAX_ATTEMPTS", 1)
    monkeypatch.chdir(tmp_path)  # workers have another current folder
    body = make_loop(tmp_path / "x").search.ask()[0].body
    executor = ray_executor.RayExecutor(Failing, workers=1)
    for number, error, said in (
        (0, RunError, "Learning diverged"),
        (1, ZeroDivisionError, "a defect"),
        (2, RunError, "has ended its worker 1 times"),
    ):
        with pytest.raises(error, match=said):
            list(executor.run([Batch([Candidate(number, body)])], {}, lambda place, event: None))
    executor.close()


@pytest.fixture(scope="module")
def cluster() -> Iterator[tuple]:
    """Two nodes with a CPU each on this machine, and a head without; the tests below leave fewer of them."""
    from ray.cluster_utils import Cluster

    handler = signal.getsignal(signal.SIGTERM)  # a node takes it over
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", PLACES)
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
        nodes = [cluster.add_node(num_cpus=1) for _ in range(2)]
        cluster.wait_for_nodes()
        yield cluster, nodes
        ray.shutdown()
        cluster.shutdown()
    signal.signal(signal.SIGTERM, handler)


@pytest.mark.slow
def test_two_nodes_with_dying_workers_give_the_results_of_one_process(cluster, tmp_path, undisturbed: str) -> None:
    where, nodes = cluster
    make = functools.partial(Mortal, tmp_path, fatal=(1,))
    executor = ray_executor.RayExecutor(make, address=where.address)
    assert executor.size == 2

    class LosingANode(Listener):
        def told(self, generation: int, fresh: bool) -> None:
            if generation == 2:
                where.remove_node(nodes.pop(), allow_graceful=False)

    run = tmp_path / "run"
    heard: list[int] = []
    listener = LosingANode()
    listener.progress = lambda batch, event: heard.append(event["id"])
    loop = make_loop(run, executor=executor, listeners=[listener])
    loop.run()
    executor.close()
    assert loop.archive.digest() == undisturbed
    assert [file.name for file in tmp_path.glob("died_*")] == ["died_1"]
    assert nodes == [nodes[0]]
    assert heard
    assert set(heard) <= {record.id for record in loop.archive.records() if record.reused is None}


@pytest.mark.slow
def test_when_the_last_node_is_lost_the_wait_for_another_has_an_end(cluster: tuple, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(ray_executor, "WORKER_TIMEOUT", 5.0)
    where, nodes = cluster
    executor = ray_executor.RayExecutor(functools.partial(ToyEvaluator, 0.2), address=where.address)

    class LosingAllNodes(Listener):
        def progress(self, batch: Sequence[Candidate], event: dict) -> None:
            while nodes:
                where.remove_node(nodes.pop(), allow_graceful=False)

    loop = make_loop(tmp_path / "run", executor=executor, listeners=[LosingAllNodes()])
    with refused(RunError, "No worker has come up for 5 s"):
        loop.run()
    assert loop.archive.count() == POPULATION
