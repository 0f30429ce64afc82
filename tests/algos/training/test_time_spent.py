"""Where the time of a training goes: shares of simulation and learning, and a GPU that waits for its host."""

import re
from collections.abc import Iterator

import pytest
import torch
from learning import ppo_settings, small_env
from simulated_cuda import SimulatedCuda
from tiny import tiny

from warpvox.algos.training.runner import Runner, Schedule, TimeSpent, adapt

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def cuda() -> Iterator[SimulatedCuda]:
    with SimulatedCuda() as found:
        yield found


def make_runner(**changes: object) -> Runner:
    ppo = ppo_settings()
    return Runner(adapt(small_env(**changes), ppo), ppo, Schedule(3, evaluate=10**6))


def test_nothing_is_said_before_the_first_iteration_and_all_of_it_afterwards() -> None:
    runner = make_runner()
    assert not {"time", "host_bound"} & runner.summary().keys()
    runner.run()
    summary = runner.summary()
    assert summary["time"].keys() == {"simulation", "learning"}
    assert sum(summary["time"].values()) == pytest.approx(1, abs=2e-3)
    assert min(summary["time"].values()) > 0
    assert "host_bound" not in summary  # there is no GPU


@pytest.mark.parametrize("extra", [None, {"normalize_advantage_per_mini_batch": True}], ids=["graph", "rsl-rl"])
def test_a_gpu_that_waits_for_its_host_is_told_from_one_that_keeps_it_waiting(
    extra: dict | None, cuda, monkeypatch
) -> None:
    """The simulated device has done all that it was told when the host has told it."""
    ppo = ppo_settings(extra=extra)
    runner = Runner(adapt(small_env(device="cuda", layout="group", lanes=None), ppo), ppo, Schedule(9))
    runner.run()
    assert runner.summary()["host_bound"]
    assert str(runner.spent).endswith("; host-bound: more environments cost nothing")
    runner.spent.waiting = runner.spent.launching
    assert not runner.summary()["host_bound"]
    assert "host" not in str(runner.spent)


def test_a_torch_that_cannot_measure_parts_of_a_graph_says_nothing_of_them(cuda, monkeypatch) -> None:
    """Before version 2.9 its events had no argument ``external``."""

    class Event:
        def __init__(self, enable_timing: bool = False) -> None:
            raise AssertionError("made without being external")

    monkeypatch.setattr(torch.cuda, "Event", Event)
    runner = make_runner(device="cuda", layout="group", lanes=None)
    runner.run()
    assert runner._iteration.is_replayed
    assert "time" not in runner.summary()


def test_lines_say_where_time_goes(warpvox) -> None:
    spent = TimeSpent(simulation=3.0, learning=1.0, launching=1.0, waiting=0.01)
    assert str(spent) == "simulation 75 %, learning 25 %; host-bound: more environments cost nothing"
    assert str(TimeSpent()) == ""
    said = " ".join(warpvox(*tiny("train", "num_envs=4", "max_iterations=2", "ppo.minibatches=1")).out.split())
    assert len(re.findall(r"simulation \d+ %, learning \d+ %", said)) == 2  # at the last iteration, and at the end
    assert "host-bound" not in said
