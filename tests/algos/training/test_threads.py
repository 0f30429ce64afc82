"""Trainings beside other threads and under the caller's settings of torch: the same bits, and nothing left behind."""

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import torch
from episodes import short_episodes

import warpvox as wv
from warpvox.algos.candidate import Candidate, Outcome

HOW = {"device": "cpu", "threads": 1, "memory_check": False}
TRAINED = {"num_envs": 4, "max_iterations": 2, "episodes": 1, "folder": None, "progress": False}
PPO = {"steps": 4, "hidden": [8], "epochs": 2, "minibatches": 2, "random_start": True}
SEARCHED = {"envs": 2, "iterations": 1, "eval_interval": 1, "ppo": {"steps": 4, "hidden": [8], "epochs": 1}}


@pytest.fixture(scope="module", autouse=True)
def short_walks() -> Iterator[None]:
    with short_episodes("Walker-v0"):
        yield


def trained(seed: int) -> list[float]:
    """The weights of a small policy."""
    return weights_of(wv.train("Walker-v0", "mini", seed=seed, ppo=PPO, **TRAINED, **HOW).policy)


def weights_of(policy: torch.nn.Module) -> list[float]:
    return torch.cat([value.flatten() for value in policy.state_dict().values()]).tolist()


def searched() -> Any:
    """The best fitness of a small design search."""
    search = wv.GA(population=2, max_designs=2, min_survivors=1)
    how = {"shape": (2, 2), "training": SEARCHED, "folder": None, "progress": False, **HOW}
    return wv.codesign("Walker-v0", search=search, seed=3, **how).summary["best_fitness"]


def evaluated() -> list[float]:
    """Returns of a function under noise."""
    how = {"task": "Walker-v0", "design": "mini", "episodes": 2, "protocol": "noise", **HOW}
    return [row.interval.mean for row in wv.evaluate(lambda obs: torch.ones(len(obs), 8), **how)]


def recorded() -> Any:
    env = wv.make_vec("Walker-v0", "mini", 2, seed=1, device="cpu", threads=1)
    return wv.record(env, "random", num_steps=5).rewards.tolist()


TOGETHER: dict[str, list[Callable[[], Any]]] = {
    "trainings": [lambda: trained(0), lambda: trained(1), lambda: trained(0)],
    "others": [lambda: trained(0), searched, evaluated, recorded],
}


@contextlib.contextmanager
def drawing() -> Iterator[None]:
    """Another thread draws from torch's own generator all the time."""
    done = threading.Event()

    def draw() -> None:
        while not done.is_set():
            torch.rand(3)

    thread = threading.Thread(target=draw)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


@pytest.mark.parametrize("name", TOGETHER)
def test_threads_get_what_each_gets_alone(name: str) -> None:
    works = TOGETHER[name]
    alone, out = [work() for work in works], sys.stdout
    with drawing(), ThreadPoolExecutor(len(works)) as pool:
        together = [future.result() for future in [pool.submit(work) for work in works]]
    assert together == alone
    assert sys.stdout is out


def test_torch_is_the_callers_again() -> None:
    torch.manual_seed(11)
    state, threads = torch.get_rng_state(), torch.get_num_threads()
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(trained, (0, 1)))
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.get_num_threads() == threads


@contextlib.contextmanager
def default(kind: str, value: Any) -> Iterator[None]:
    """One of torch's default settings."""
    before = getattr(torch, f"get_{kind}")()
    getattr(torch, f"set_{kind}")(value)
    try:
        yield
        assert getattr(torch, f"get_{kind}")() == (torch.device(value) if kind == "default_device" else value)
    finally:
        getattr(torch, f"set_{kind}")(None if kind == "default_device" else before)


AMBIENT = {
    "type": lambda: default("default_dtype", torch.float64),
    "device": lambda: default("default_device", "meta"),
    "device of a block": lambda: torch.device("meta"),
    "gradients": torch.no_grad,
    "inference": torch.inference_mode,
    "autocast": lambda: torch.autocast("cpu"),
    "threads": lambda: default("num_threads", 3),
}


def test_settings_of_the_caller_change_nothing(tmp_path: Path) -> None:
    source = {**TRAINED, "folder": tmp_path / "run"}
    wv.train("Walker-v0", "mini", ppo=PPO, **source, **HOW)

    def everything() -> list[Any]:
        return [trained(0), weights_of(wv.load_policy(tmp_path / "run"))]

    usual = everything()
    for name, setting in AMBIENT.items():
        with setting():
            found = everything()
        assert found == usual, name


def test_an_evaluation_may_train_in_threads_of_its_own() -> None:
    class Pool:
        def evaluate(self, candidates: Sequence[Candidate], *_: object) -> list[Outcome]:
            with ThreadPoolExecutor(2) as pool:
                results = list(pool.map(trained, range(len(candidates))))
            return [Outcome(sum(weights)) for weights in results]

    search = wv.GA(population=2, max_designs=2, min_survivors=1)
    how = {"shape": (2, 2), "folder": None, "progress": False, **HOW}
    found = wv.codesign("Walker-v0", search=search, fitness=Pool(), **how)
    assert found.summary["best_fitness"] == max(sum(trained(seed)) for seed in (0, 1))
