"""Environments that are checked when they are made, and their rates, measured alternately."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any

import torch

from warpvox.bench.cases import make
from warpvox.bench.check import against_scalar
from warpvox.cli.config import load
from warpvox.errors import SimulationError
from warpvox.types import ACTION_HIGH, ACTION_LOW

HEADINGS = {"bare": "physics alone", "step": "step only", "inference": "with inference", "training": "with training"}
"""Columns: the simulator alone, the whole control step, a policy in the loop, iterations of ``ppo=parallel``."""
TICK = 1e-7
"""Seconds for which a clock may stand still, as that of CPU time does on Windows."""
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


def seconds(action: Callable[[], object], device: str) -> float:
    """Seconds of an action by :func:`clock`."""
    began = clock(device)
    action()
    return clock(device) - began


def unit(device: str) -> str:
    """The unit of time of rates."""
    return "second of CPU time" if device == "cpu" else "second"


class Runner:
    """Environments with loaded kernels, and the ways to spend time with them. Episodes go on between repetitions.

    Args:
        config: of ``warpvox bench``; ``task``, ``num_envs`` and ``options`` of ``make_vec`` go before it.
        checked: whether the batch is compared with environments alone first.
        now: gives seconds; by default :func:`clock`.

    Attributes:
        built: seconds that making the environments took.
        error: the largest difference to environments alone; None if they were not compared.
        steps: of a repetition: fewer than configured where they would take longer than the limit.
        fits: whether the shortest repetition keeps to the limit.
    """

    def __init__(
        self,
        config: Any,
        bodies: Any,
        num_envs: int | None = None,
        task: str | None = None,
        checked: bool = True,
        now: Callable[[], float] | None = None,
        **options: Any,
    ) -> None:
        self.num_envs, self.limit = num_envs or config.num_envs, config.limit
        began = clock(config.device)
        self.env = make(config, bodies, self.num_envs, task, **options)
        self.built = clock(config.device) - began
        self.error = against_scalar(self.env, config.seed) if checked else None
        self.now = now or partial(clock, self.env.device)
        self._draw = torch.Generator(self.env.device).manual_seed(config.seed)
        self.env.reset()
        self.rate("step", LOADING)
        seconds = self.num_envs / self.rate("step", 1)
        self.steps = max(LEAST_STEPS, min(config.steps, int(self.limit / seconds)))
        self.fits = LEAST_STEPS * seconds <= self.limit

    @cached_property
    def training(self) -> Any:
        """The training of a policy in these environments."""
        return training_of(self.env)

    def rate(self, column: str, steps: int | None = None) -> float:
        """Control steps of all environments per second, over one repetition of a column.

        That of training is one iteration, whatever ``steps``.
        """
        count, env = steps or self.steps, self.env
        if column == "training":
            count = self.training.ppo.steps
            began = self.now()
            self.training.learn(1)
        elif column == "inference":
            policy = self.training.controller
            obs = self.training.env.get_observations()["policy"].to(env.dtype)
            began = self.now()
            for _ in range(count):
                obs = env.step(policy(obs))[0]
        else:
            step = env.sim.step if column == "bare" else env.step
            shares = (
                torch.rand((self.num_envs, env.num_actions), generator=self._draw, dtype=env.dtype, device=env.device)
                for _ in range(count)
            )
            actions = [ACTION_LOW + (ACTION_HIGH - ACTION_LOW) * share for share in shares]
            began = self.now()
            for action in actions:
                step(action)
        return count * self.num_envs / max(self.now() - began, TICK)

    def repeats(self, column: str, repeats: int) -> int:
        """Repetitions of a column, made ready: fewer where an iteration of training is longer than the limit."""
        if column == "training":
            seconds = load("train", []).ppo.steps * self.num_envs / self.rate("step", LEAST_STEPS)
            if seconds > self.limit:
                repeats = 0 if seconds > PATIENCE * self.limit else min(repeats, SHORT)
        if repeats and column != "step":
            self.rate(column, LEAST_STEPS)  # the first time builds networks and buffers
        return repeats

    def check_finite(self) -> None:
        """Raise SimulationError if the state is not finite or contacts were left out."""
        if not bool(torch.isfinite(self.env.sim.object_positions("robot")).all()):
            raise SimulationError("The state is not finite: its speed means nothing.")
        if bool(self.env.sim.overflow.any()):
            raise SimulationError("There was no room for all contacts: the speed means nothing.")


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
    """Rates by name and column, repetition by repetition, alternating; ``others`` give rates of step only."""
    found: dict[str, dict[str, list[float]]] = {name: {column: [] for column in columns} for name in runners}
    turns: list[tuple[int, list[float], Callable[[], float]]] = []
    for name, runner in runners.items():
        for column, values in found[name].items():
            turns.append((runner.repeats(column, repeats), values, partial(runner.rate, column)))
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
