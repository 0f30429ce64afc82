"""Shared code of the benchmarks: options, verified environments, EvoGym as reference, rates, tables.

Rates are control steps of single environments per second: of CPU time of the process where one thread computes, of
wall-clock time with more threads and on CUDA. A result is asserted before its time is measured.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import re
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, TypeVar

import numpy as np
import torch

import warpvox as wv
from warpvox.envs.vec_env import VoxelVecEnv

Item = TypeVar("Item")
ROOT = Path(__file__).resolve().parents[1]
WORKER = Path(__file__).with_name("evogym_worker.py")
ACTION_LOW, ACTION_HIGH = 0.6, 1.6

CHECKED_STEPS = 60
"""Control steps compared with EvoGym."""
TOLERANCE = 1e-6
"""Largest difference of the centre of mass to EvoGym in float64, in simulator units: over so few steps contacts have
not yet amplified what round-off leaves."""
ALONE_STEPS = 10
ALONE_TOLERANCE = {"float32": 1e-5, "float64": 1e-9}
"""Largest difference of the centre of mass between an environment in a batch and a single one in float64."""


# Command line


def options(description: str | None) -> argparse.ArgumentParser:
    """Build a command-line parser with the options of all benchmarks."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter, allow_abbrev=False
    )
    reference = os.environ.get("WARPVOX_REFERENCE") or str(ROOT / "build/reference/bin/python")
    add = parser.add_argument
    add("--task", default="Walker-v0", help="task id")
    add("--design", default="walker", help="body: an example, zoo:TASK, random or a file")
    add("--num-envs", type=int, default=512, help="environments of a batch")
    add("--steps", type=int, default=40, help="control steps of a timed repetition, at most")
    add("--repeats", type=int, default=5, help="repetitions, whose median is shown")
    add("--limit", type=float, default=4.0, help="seconds that a repetition may take")
    add("--device", default="cpu", help="cpu, cuda or cuda:<index>")
    add("--threads", type=int, default=1, help="CPU threads of the simulation")
    add("--seed", type=int, default=0, help="seed of bodies and actions")
    add("--no-training", action="store_true", help="leave out iterations of PPO")
    add("--reference", default=reference, help="Python with evogym 2.0.0 (make reference), if there is one")
    add("--output", default=str(ROOT / "build/report"), help="folder of the results")
    return parser


# Environments


def sampled_bodies(side: int, count: int, seed: int) -> list[np.ndarray]:
    """Sample ``count`` bodies int8 ``[side, side]`` by EvoGym's rule."""
    return [wv.sample_design((side, side), np.random.default_rng([seed, side, k])) for k in range(count)]


def full_body(side: int, seed: int) -> np.ndarray:
    """Build a body int8 ``[side, side]`` without empty cells, with actuators at both upper corners."""
    cells = np.array([wv.Cell.RIGID, wv.Cell.SOFT, wv.Cell.H_ACT, wv.Cell.V_ACT], np.int8)
    body = np.random.default_rng([seed, side]).choice(cells, (side, side))
    body[0, 0] = wv.Cell.H_ACT
    body[0, -1] = wv.Cell.V_ACT
    return body


class Batch:
    """Environments that were verified against a single one, and methods to measure rates.

    Args:
        args: options of the command line; ``designs``, ``num_envs``, ``task`` and ``given`` are those of
            :func:`warpvox.make_vec`.

    Attributes:
        built: seconds that making the environments took.
        error: largest difference of the centre of mass to an environment alone.
        steps: of a repetition: fewer than asked for where these would take longer than the limit.
    """

    def __init__(
        self,
        args: argparse.Namespace,
        designs: Sequence[Any],
        num_envs: int | None = None,
        task: str | None = None,
        **given: Any,
    ) -> None:
        self.num_envs = num_envs or args.num_envs
        given = {"device": args.device, "threads": args.threads} | given
        self._draw = torch.Generator().manual_seed(args.seed)

        began = time.perf_counter()
        self.env = wv.make_vec(task or args.task, designs, self.num_envs, **given)
        self.built = time.perf_counter() - began
        self.error = difference_to_one_alone(self.env, args.seed)

        # The first steps load kernels, and on CUDA record the graph.
        self.random_rate(4)
        seconds = self.num_envs / self.random_rate(1)
        self.steps = max(2, min(args.steps, int(args.limit / seconds)))

    def clock(self) -> float:
        """Return seconds: CPU time of the process with one thread, else wall-clock time once the device is idle."""
        if self.env.device != "cpu":
            torch.cuda.synchronize(self.env.device)
        elif self.env.sim.threads == 1:
            return time.process_time()
        return time.perf_counter()

    def random_rate(self, steps: int | None = None, physics_alone: bool = False) -> float:
        """Measure control steps per second under random actions; episodes continue from call to call."""
        steps = steps or self.steps
        size = steps, self.num_envs, self.env.num_actions
        shares = torch.rand(size, generator=self._draw, dtype=self.env.dtype).to(self.env.device)
        actions = ACTION_LOW + (ACTION_HIGH - ACTION_LOW) * shares
        step = self.env.sim.step if physics_alone else self.env.step

        began = self.clock()
        for row in actions:
            step(row)
        return steps * self.num_envs / (self.clock() - began)

    def assert_finite(self) -> None:
        """Assert that the state is finite and no contact was dropped."""
        assert self.env.sim.object_positions("robot").isfinite().all(), "the state is not finite"
        assert not self.env.sim.overflow.any(), "there was no room for all contacts"


def difference_to_one_alone(env: VoxelVecEnv, seed: int) -> float:
    """Compare the first and last environment's centre of mass with single environments; return the maximum.

    Those alone are computed on the CPU in float64, one lane wide: by the code that repeats the recordings of EvoGym.
    The batch is left at the start of an episode.
    """
    alone = wv.make_vec(
        env.spec,
        [env.designs[0], env.designs[-1]],
        2,
        device="cpu",
        dtype="float64",
        rules=env.rules,
        physics=env.sim.physics,
        seed=env.seed,
        auto_reset=False,
        threads=1,
        lanes=1,
    )
    env.reset(seed=env.seed)
    drawn = {}
    for name, own in alone.memory.items():
        drawn[name] = env.memory[name][[0, -1]][..., : own.shape[-1]].cpu()
    alone.reset(memory=drawn or None)

    error = 0.0
    actions = np.rint(waves(ALONE_STEPS, env.num_actions, seed) * 1024) / 1024  # exact in every precision
    for step, action in enumerate(actions):
        # The environments between do something else.
        batch = torch.as_tensor(np.roll(action, step)).repeat(env.num_envs, 1)
        batch[0] = batch[-1] = torch.as_tensor(action)
        env.step(batch.to(env.device))
        alone.step(np.tile(action[: alone.num_actions], (2, 1)))
        apart = env.sim.com("robot")[[0, -1]].cpu() - alone.sim.com("robot")
        error = max(error, float(apart.abs().max()))
    env.reset(seed=env.seed)

    allowed = ALONE_TOLERANCE[env.sim.options.dtype]
    assert error < allowed, f"{env.spec.id}: an environment of the batch differs from one alone by {error:.1e}"
    return error


def waves(steps: int, actuators: int, seed: int) -> np.ndarray:
    """Create actions float64 ``[steps, actuators]``: sine waves with a period of 25 steps and random phases."""
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, actuators)
    return 1.1 + 0.45 * np.sin(2 * np.pi * np.arange(steps)[:, None] / 25 + phase)


# Rates

WARM = 3
"""Iterations of a training that are not measured: they build networks, buffers and CUDA graphs."""
COLUMNS = ("physics alone", "step only", "with training")
"""Measured quantities: simulation and environments under random actions, iterations of PPO."""


def measure(args: argparse.Namespace, batch: Batch) -> dict[str, list[float]]:
    """Measure all rates of a batch of one body, by column; [] for training if disabled."""
    physics = partial(batch.random_rate, physics_alone=True)
    found = alternate({"physics alone": physics, "step only": batch.random_rate}, args.repeats)
    batch.assert_finite()
    trained = [] if args.no_training else training_rates(args, batch)
    return {**found, "with training": trained}


def training_rates(args: argparse.Namespace, batch: Batch, **ppo: Any) -> list[float]:
    """Measure control steps per second in iterations of PPO; ``ppo``: changed settings."""
    ends: list[float] = []
    iterations = WARM + args.repeats + 1
    run = wv.train(
        batch.env.spec.id,
        batch.env.designs[0],
        num_envs=batch.num_envs,
        max_iterations=iterations,
        eval_interval=iterations,
        device=args.device,
        threads=args.threads,
        seed=args.seed,
        ppo=wv.Ppo(**ppo),
        folder=None,
        progress=False,
        listeners=[lambda row: ends.append(batch.clock())],
    )
    steps = run.summary["steps"] / iterations
    # The last iteration is followed by an evaluation, and does not count.
    return [steps / (end - begin) for begin, end in pairwise(ends[WARM - 1 : -1])]


def alternate(rates: Mapping[str, Callable[[], float]], repeats: int) -> dict[str, list[float]]:
    """Measure several rates in turn, repeatedly, as the machine's speed varies; return them by name."""
    found: dict[str, list[float]] = {name: [] for name in rates}
    for _ in range(repeats):
        for name, rate in rates.items():
            found[name].append(rate())
    return found


# EvoGym


class Reference:
    """EvoGym in its own Python process, called by JSON lines; a context manager."""

    def __init__(self, python: str) -> None:
        # Isolated: neither this folder nor PYTHONPATH can shadow what EvoGym imports.
        command = [python, "-I", str(WORKER)]
        self._process: Any = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def __enter__(self) -> Reference:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()

    def start(self, task: str, body: np.ndarray) -> dict[str, str]:
        """Create the environment for later calls in EvoGym's process; return the versions."""
        return self._ask(task=task, body=body.tolist())

    def rate(self, steps: int, actuators: int, rng: np.random.Generator) -> float:
        """Measure EvoGym's control steps per second of CPU time under random actions."""
        actions = rng.uniform(ACTION_LOW, ACTION_HIGH, (steps, actuators))
        return steps / self._ask(actions=actions.tolist(), centres=False)

    def difference(self, task: str, body: np.ndarray, seed: int, steps: int = CHECKED_STEPS) -> float:
        """Return the largest difference of the centre of mass between warpvox in float64 and EvoGym."""
        env = wv.make_vec(task, [body], device="cpu", dtype="float64", auto_reset=False, threads=1)
        env.reset()
        actions = waves(steps, env.num_actions, seed)
        ours = []
        for action in actions:
            env.step(action[None])
            ours.append(env.sim.com("robot")[0].tolist())
        self.start(task, body)
        theirs = self._ask(actions=actions.tolist(), centres=True)
        error = float(np.abs(np.array(ours) - np.array(theirs)).max())
        assert error < TOLERANCE, f"{task}: the centre of mass differs from EvoGym by {error:.1e} in {steps} steps"
        return error

    def _ask(self, **request: Any) -> Any:
        print(json.dumps(request), file=self._process.stdin, flush=True)
        line = self._process.stdout.readline()
        assert line, "EvoGym has ended without an answer"
        return json.loads(line)


def open_reference(args: argparse.Namespace) -> Reference | nullcontext[None]:
    """Start EvoGym's process; None if the Python to run it is missing."""
    return Reference(args.reference) if Path(args.reference).is_file() else nullcontext()


# Results


class Report:
    """Results of a benchmark, printed and written to ``OUTPUT/NAME``.

    ``rows.jsonl`` has each row with all repetitions as soon as it is there, ``tables.md`` all tables and sentences so
    far, so that a benchmark that is cut off leaves what it has found.

    Attributes:
        end: when, by ``time.perf_counter()``, no row begins any more.
        left_out: rows for which there was no time.
    """

    end = math.inf

    def __init__(self, name: str, args: argparse.Namespace) -> None:
        self.folder = Path(args.output) / name
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "rows.jsonl").write_text("")
        (self.folder / "tables.md").unlink(missing_ok=True)
        self.left_out: list[str] = []
        self._machine = f"Machine: {machine()}."
        self._texts: list[str] = []
        print(self._machine)

    def row(self, name: str, *values: Any) -> None:
        """Store a row of an unfinished table."""
        print(name, *map(number, values), sep="  ", flush=True)
        with (self.folder / "rows.jsonl").open("a") as file:
            print(json.dumps([name, *values]), file=file)

    def table(self, title: str, headings: Sequence[str], rows: Sequence[Sequence[Any]], ranges: bool = False) -> None:
        """Add a table of texts and numbers; ``ranges``: with minimum and maximum of repeated measurements."""
        show = spread if ranges else number
        texts = [[cell if isinstance(cell, str) else show(cell) for cell in row] for row in rows]
        rule = ["---", *["---:"] * (len(headings) - 1)]
        lines = [f"| {' | '.join(line)} |" for line in [headings, rule, *texts]]
        self.note("\n".join([f"{title}:", "", *lines]))

    def note(self, text: str) -> None:
        """Add a sentence below the tables."""
        print(f"\n{text}", flush=True)
        self._texts.append(text)
        (self.folder / "tables.md").write_text("\n\n".join([*self._texts, self._machine]) + "\n")

    def in_time(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield items until the time is over."""
        for item in items:
            if time.perf_counter() < self.end:
                yield item
            else:
                self.left_out.append(str(item))


def machine() -> str:
    """Describe GPUs, processor and versions as text."""
    gpus = [torch.cuda.get_device_name(k) for k in range(torch.cuda.device_count())]
    info = Path("/proc/cpuinfo")
    names = re.findall("model name.*: (.+)", info.read_text()) if info.is_file() else [platform.processor()]
    cpu = f"{os.cpu_count()} cores of {names[0]} ({torch.backends.cpu.get_cpu_capability()})"
    versions = [f"{name} {version(name)}" for name in ("torch", "warp-lang", "warpvox")]
    return ", ".join([*gpus, cpu, f"Python {platform.python_version()}", *versions])


def number(value: float | Sequence[float] | None) -> str:
    """Format a number, or the median of several, with at least three digits; - for none."""
    if value is None or value == []:
        return "-"
    value = median(value) if isinstance(value, Sequence) else value
    return f"{value:,.0f}" if isinstance(value, int) or abs(value) >= 100 else f"{value:.3g}"


def spread(value: float | Sequence[float] | None) -> str:
    """Format the median of several numbers with minimum and maximum in parentheses."""
    if not isinstance(value, Sequence) or len(value) < 2:
        return number(value)
    return f"{number(value)} ({number(min(value))} to {number(max(value))})"
