"""What is timed: environments of one task under random actions, with a policy, and in training."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from warpvox.cli.config import load
from warpvox.envs.vec_env import make_vec
from warpvox.errors import SimulationError
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["Subject", "clock", "measure"]

LEAST_STEPS = 2
"""Control steps of a repetition, at the least."""
LOADING = 4
"""Control steps that load kernels, and on CUDA capture the graph."""
PATIENCE, SHORT = 4, 2
"""An iteration of training may take so many times the limit; one beyond the limit is repeated so often."""


def clock(device: str) -> float:
    """Seconds: CPU time of this process on the CPU, the wall's on CUDA once the device is idle."""
    if device == "cpu":
        return time.process_time()
    torch.cuda.synchronize(device)
    return time.perf_counter()


class Subject:
    """Environments and the ways to spend time with them. Episodes go on from one repetition to the next.

    Args:
        config: of ``warpvox bench``: precision, device, threads, seed, limits.
        task, body, num_envs: what to make.
        options: of ``make_vec``, other than the configuration's.
    """

    def __init__(self, config: Any, task: str, body: np.ndarray, num_envs: int, **options: Any) -> None:
        common = dict(device=config.device, dtype=config.dtype, arithmetic=config.arithmetic, threads=config.threads)
        self.env = make_vec(task, [body], num_envs, **(common | options))
        self.device, self.num_envs, self.limit = self.env.device, num_envs, config.limit
        self._random = torch.Generator(self.device).manual_seed(config.seed)
        self._runner: Any = None
        self._obs = self.env.reset()[0]
        self.steps = config.steps

    def actions(self) -> torch.Tensor:
        """Random actions of one control step."""
        shape = (self.num_envs, self.env.num_actions)
        share = torch.rand(shape, generator=self._random, dtype=self.env.dtype, device=self.device)
        return ACTION_LOW + (ACTION_HIGH - ACTION_LOW) * share

    def settle(self) -> bool:
        """Load the kernels, and cut ``steps`` so that a repetition keeps to the limit; False if it cannot."""
        self.timed("step", LOADING)
        seconds = self.num_envs / self.timed("step", 1)
        self.steps = max(LEAST_STEPS, min(self.steps, int(self.limit / seconds)))
        return LEAST_STEPS * seconds <= self.limit

    def timed(self, column: str, steps: int | None = None) -> float:
        """Control steps of all environments per second, over one repetition of a column."""
        steps = steps or self.steps
        run = {"bare": self._bare, "step": self._step, "inference": self._infer, "training": self._learn}[column]
        part = run(steps)
        began = clock(self.device)
        done = part()
        return done / (clock(self.device) - began)

    def check_finite(self) -> None:
        """Raise SimulationError if the state has left the finite numbers or contacts were left out."""
        sim = self.env.sim
        if not bool(torch.isfinite(sim.object_positions("robot")).all()):
            raise SimulationError("The simulation has left the finite numbers: its speed means nothing.")
        if bool(sim.overflow.any()):
            raise SimulationError("Contacts were left out for want of room: the speed means nothing.")

    def _bare(self, steps: int) -> Callable[[], int]:
        actions = [self.actions() for _ in range(steps)]

        def run() -> int:
            for action in actions:
                self.env.sim.step(action)
            return steps * self.num_envs

        return run

    def _step(self, steps: int) -> Callable[[], int]:
        actions = [self.actions() for _ in range(steps)]

        def run() -> int:
            for action in actions:
                self._obs = self.env.step(action)[0]
            return steps * self.num_envs

        return run

    def _infer(self, steps: int) -> Callable[[], int]:
        policy = self._trainer().controller

        def run() -> int:
            for _ in range(steps):
                self._obs = self.env.step(policy(self._obs))[0]
            return steps * self.num_envs

        return run

    def _learn(self, steps: int) -> Callable[[], int]:
        """One iteration of ``ppo=parallel``, whatever ``steps``: as many as that takes."""
        runner = self._trainer()

        def run() -> int:
            runner.learn(1)
            return runner.ppo.steps * self.num_envs

        return run

    def _trainer(self) -> Any:
        if self._runner is None:
            from warpvox.algos.training.runner import Runner, Schedule, adapt

            ppo = load("train", []).ppo
            self._runner = Runner(adapt(self.env, ppo), ppo, Schedule(total=10**6, evaluate=10**6))
            self._obs = self._runner.env.get_observations()["policy"].to(self.env.dtype)
        return self._runner

    @property
    def training_steps(self) -> int:
        """Control steps of an environment in an iteration of training."""
        return int(load("train", []).ppo.steps)


def measure(subject: Subject, columns: list[str], repeats: int, between: Callable[[], None] = int) -> dict[str, list]:
    """Rates of ``columns``, repetition by repetition in turns; ``between`` runs after each round.

    Training takes whole iterations: of long ones there are fewer, and none where one would take PATIENCE limits.
    """
    seconds = subject.training_steps * subject.num_envs / subject.timed("step", LEAST_STEPS)
    times = dict.fromkeys(columns, repeats)
    if "training" in times and seconds > subject.limit:
        times["training"] = 0 if seconds > PATIENCE * subject.limit else min(repeats, SHORT)
    for column in columns:
        if column != "step" and times[column]:
            subject.timed(column, LEAST_STEPS)  # the first time builds networks and buffers
    rates: dict[str, list[float]] = {column: [] for column in columns}
    for k in range(repeats):
        for column in columns:
            if k < times[column]:
                rates[column].append(subject.timed(column))
        between()
    subject.check_finite()
    return rates
