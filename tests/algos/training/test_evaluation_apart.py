"""Evaluations in a thread while a graph is replayed: the same rows, files and ends as those that learning waits for."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from learning import assert_same_weights, ppo_settings, rows, small_env
from simulated_cuda import SimulatedCuda

from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.evaluate import EpisodeReturns, evaluator
from warpvox.algos.generators import Generators
from warpvox.algos.ppo.iteration import Iteration
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.errors import ActionError, DivergenceError
from warpvox.runs import BEST, STATE

LIMIT = 7
ITERATIONS = 14
MAIN = threading.main_thread()

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(autouse=True)
def cuda() -> Iterator[SimulatedCuda]:
    with SimulatedCuda() as found:
        yield found


class Slow:
    """An evaluator that ends an iteration later than it could, where it is in a thread of its own."""

    def __init__(self, runner: Runner) -> None:
        self.runner = runner
        self.judge = evaluator(small_env(2, max_episode_steps=LIMIT, auto_reset=False), seed=0)
        self.apart = 0
        """Evaluations during which learning went on."""

    def __call__(self, policy: Any) -> EpisodeReturns:
        iteration = self.runner.current_learning_iteration
        is_apart = threading.current_thread() is not MAIN and iteration < ITERATIONS  # after the last it is waited for
        began = time.monotonic()
        while is_apart and time.monotonic() < began + 30:
            if self.runner.current_learning_iteration > iteration:
                self.apart += 1
                break
            time.sleep(0.001)
        return self.judge(policy)


def make_runner(folder: Path | None, goal: float | None = None) -> Runner:
    ppo = ppo_settings()
    env = adapt(small_env(device="cuda", layout="group", lanes=None, max_episode_steps=LIMIT), ppo)
    schedule = Schedule(ITERATIONS, save=5, evaluate=4, stop_return=goal)
    runner = Runner(env, ppo, schedule, folder, generators=Generators(3, "cuda"), logger="none")
    runner.evaluator = Slow(runner)
    return runner


def run_both(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, goal: float | None = None) -> tuple[Runner, Runner]:
    """A run whose evaluations learning waits for, and one with a thread for them."""
    runners = []
    for name in ("at once", "apart"):
        (tmp_path / name).mkdir()
        runner = make_runner(tmp_path / name, goal)
        with monkeypatch.context() as patched:
            if name == "at once":
                patched.setattr(Iteration, "is_replayed", False)
            runner.run()
        runners.append(runner)
    assert runners[0].evaluator.apart == 0
    assert runners[1].evaluator.apart > 0
    return runners[0], runners[1]


def assert_same_ends(tmp_path: Path, one: Runner, other: Runner) -> None:
    assert rows(tmp_path / "at once") == rows(tmp_path / "apart")
    assert_same_weights(one, other)
    assert one.current_learning_iteration == other.current_learning_iteration
    names = [{path.name for path in (tmp_path / name).glob("*.pt")} for name in ("at once", "apart")]
    assert names[0] == names[1]
    for name in names[0]:
        found = [load_checkpoint(tmp_path / folder / name) for folder in ("at once", "apart")]
        assert [content["iter"] for content in found] == [found[0]["iter"]] * 2
        assert found[0]["eval_return"] == pytest.approx(found[1]["eval_return"], rel=0, abs=0, nan_ok=True)
        for weight, value in found[0]["actor_state_dict"].items():
            assert torch.equal(value, found[1]["actor_state_dict"][weight]), (name, weight)


def test_rows_and_files_are_those_of_evaluations_that_learning_waits_for(tmp_path: Path, monkeypatch) -> None:
    runners = run_both(tmp_path, monkeypatch)
    assert_same_ends(tmp_path, *runners)
    assert runners[0].current_learning_iteration == ITERATIONS
    assert {BEST, STATE, "model_5.pt", "model_10.pt", f"model_{ITERATIONS}.pt"} <= {
        path.name for path in (tmp_path / "apart").iterdir()
    }


def test_a_run_that_reaches_its_goal_ends_where_it_would_have(tmp_path: Path, monkeypatch) -> None:
    """Iterations that were made while a thread evaluated are taken back."""
    reached = []
    (tmp_path / "free").mkdir()
    free = make_runner(tmp_path / "free")
    free.report = lambda row: reached.append(row["eval_return"])
    free.run()
    returns = [value for value in reached if value == value]
    goal = max(returns[1:3])
    assert goal > returns[0], "the first evaluation, which is made at once, must not reach the goal"
    runners = run_both(tmp_path, monkeypatch, goal)
    assert_same_ends(tmp_path, *runners)
    assert runners[0].current_learning_iteration < ITERATIONS


def test_a_policy_that_has_diverged_is_said_of_its_iteration(tmp_path: Path) -> None:
    runner = make_runner(tmp_path)
    judge = runner.evaluator

    def failing(policy: Any) -> EpisodeReturns:
        if threading.current_thread() is MAIN:
            return judge(policy)
        time.sleep(0.05)
        raise ActionError("Actions must be finite.")

    runner.evaluator = failing
    with pytest.raises(DivergenceError, match="in iteration 8 "):
        runner.run()
    assert runner.current_learning_iteration == 7
    assert "'iteration': 7.0" in rows(tmp_path)
    assert "'iteration': 8.0" not in rows(tmp_path)
