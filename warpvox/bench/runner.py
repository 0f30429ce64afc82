"""The runner of cases: environments that are checked when they are made, and rates measured alternately."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import torch

from warpvox.bench.case import Case
from warpvox.bench.check import against_scalar
from warpvox.cli.config import load
from warpvox.envs.vec_env import make_vec
from warpvox.errors import SimulationError
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["HEADINGS", "LOADING", "Runner", "clock", "measure", "training_of", "unit"]

HEADINGS = {"bare": "physics alone", "step": "step only", "inference": "with inference", "training": "with training"}
"""Columns: the simulator alone, the whole control step, a policy in the loop, iterations of ``ppo=parallel``."""
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


def unit(device: str) -> str:
    """The unit of time of rates."""
    return "second of CPU time" if device == "cpu" else "second"


class Runner:
    """The environments of a case and the ways to spend time with them. Episodes go on from repetition to repetition.

    Args:
        config: of ``warpvox bench``: precision, device, threads, seed, limits.
        case: what to make.
        checked: whether the batch is compared with environments alone first.
        now: gives seconds; by default :func:`clock`.

    Attributes:
        built: seconds that making the environments took.
        error: the largest difference to environments alone; None if they were not compared.

    Raises:
        SimulationError: the batch differs from one environment alone.
    """

    steps: int

    def __init__(self, config: Any, case: Case, checked: bool = True, now: Callable[[], float] | None = None) -> None:
        common = dict(device=config.device, dtype=config.dtype, arithmetic=config.arithmetic, threads=config.threads)
        began = clock(config.device)
        self.env = make_vec(case.task, case.bodies, case.num_envs, **(common | case.options))
        self.built = clock(config.device) - began
        self.error = against_scalar(self.env, config.seed) if checked else None
        self.num_envs, self.limit, self.steps = case.num_envs, config.limit, config.steps
        self.now = now or partial(clock, self.env.device)
        self._draw = torch.Generator(self.env.device).manual_seed(config.seed)
        self._training: Any = None
        self._obs = self.env.reset()[0]

    def actions(self) -> torch.Tensor:
        """Random actions of one control step."""
        shape = (self.num_envs, self.env.num_actions)
        share = torch.rand(shape, generator=self._draw, dtype=self.env.dtype, device=self.env.device)
        return ACTION_LOW + (ACTION_HIGH - ACTION_LOW) * share

    def fit(self) -> bool:
        """Load the kernels, and cut ``steps`` so that a repetition keeps to the limit; False if it cannot."""
        self.rate("step", LOADING)
        seconds = self.num_envs / self.rate("step", 1)
        self.steps = max(LEAST_STEPS, min(self.steps, int(self.limit / seconds)))
        return LEAST_STEPS * seconds <= self.limit

    def rate(self, column: str, steps: int | None = None) -> float:
        """Control steps of all environments per second, over one repetition of a column.

        That of training is one iteration, whatever ``steps``.
        """
        count = steps or self.steps
        if column == "training":
            training = self._trainer()
            count = training.ppo.steps
            began = self.now()
            training.learn(1)
        elif column == "inference":
            policy = self._trainer().controller
            began = self.now()
            for _ in range(count):
                self._obs = self.env.step(policy(self._obs))[0]
        else:
            step = self.env.sim.step if column == "bare" else self.env.step
            actions = [self.actions() for _ in range(count)]
            began = self.now()
            for action in actions:
                step(action)
        return count * self.num_envs / (self.now() - began)

    def repeats(self, column: str, repeats: int) -> int:
        """Repetitions of a column: fewer where an iteration of training is longer than the limit."""
        if column != "training":
            return repeats
        seconds = load("train", []).ppo.steps * self.num_envs / self.rate("step", LEAST_STEPS)
        if seconds <= self.limit:
            return repeats
        return 0 if seconds > PATIENCE * self.limit else min(repeats, SHORT)

    def check_finite(self) -> None:
        """Raise SimulationError if the state is not finite or contacts were left out."""
        sim = self.env.sim
        if not bool(torch.isfinite(sim.object_positions("robot")).all()):
            raise SimulationError("The state is not finite: its speed means nothing.")
        if bool(sim.overflow.any()):
            raise SimulationError("There was no room for all contacts: the speed means nothing.")

    def _trainer(self) -> Any:
        if self._training is None:
            self._training = training_of(self.env)
            self._obs = self._training.env.get_observations()["policy"].to(self.env.dtype)
        return self._training


def training_of(env: Any) -> Any:
    """The training of a policy in these environments, by the defaults of ``warpvox train``, without evaluations."""
    from warpvox.algos.training.runner import Runner as Training, Schedule, adapt

    ppo = load("train", []).ppo
    return Training(adapt(env, ppo), ppo, Schedule(total=10**6, evaluate=10**6))


def measure(
    runners: Mapping[str, Runner],
    columns: Sequence[str],
    repeats: int,
    others: Mapping[str, Callable[[], float]] | None = None,
) -> dict[str, dict[str, list[float]]]:
    """Rates by name and column, repetition by repetition, alternating; ``others`` give rates of step only.

    Raises:
        SimulationError: a state is not finite at the end.
    """
    found: dict[str, dict[str, list[float]]] = {}
    turns: list[tuple[int, list[float], Callable[[], float]]] = []
    for name, runner in runners.items():
        found[name] = {column: [] for column in columns}
        for column, values in found[name].items():
            times = runner.repeats(column, repeats)
            if times and column != "step":
                runner.rate(column, LEAST_STEPS)  # the first time builds networks and buffers
            turns.append((times, values, partial(runner.rate, column)))
    for name, rate in (others or {}).items():
        found[name] = {"step": []}
        turns.append((repeats, found[name]["step"], rate))
    for k in range(repeats):
        for times, values, rate in turns:
            if k < times:
                values.append(rate())
    for runner in runners.values():
        runner.check_finite()
    return found
