"""Where the time of a training goes: shares of simulation and learning, and a GPU that waits for its host."""

import io
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from learning import ppo_settings, small_env
from rich.console import Console
from simulated_cuda import SimulatedCuda

from warpvox.algos.training.runner import Runner, Schedule, TimeSpent, adapt
from warpvox.progress.training import Terminal

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


def test_lines_say_where_time_goes() -> None:
    spent = TimeSpent(simulation=3.0, learning=1.0, launching=1.0, waiting=0.01)
    text = "simulation 75 %, learning 25 %; host-bound: more environments cost nothing"
    assert str(spent) == text
    console = Console(file=io.StringIO(), width=200)
    shown = Terminal(console)
    shown._figures = SimpleNamespace(text=lambda row: "figures")
    shown._spent, shown._total, shown._start, shown._began, shown._printed = spent, 2, 0, 0.0, 0.0
    shown({"iteration": 2, "eval_return": 1.0})
    assert f"({text})" in console.file.getvalue()
