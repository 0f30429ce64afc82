"""``warpvox bench suite=kernels``: where a control step spends its time, memory, and the first compilation."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import torch
import warp as wp

from warpvox.bench.case import Case, one_body
from warpvox.bench.memory import groups
from warpvox.bench.report import Report, middle, number
from warpvox.bench.runner import HEADINGS, Runner, clock, measure
from warpvox.errors import SimulationError
from warpvox.kernels.device import Command, kernel, record
from warpvox.kernels.launch import stage_kernel
from warpvox.kernels.step import STAGES as STAGES_OF

__all__ = ["compile_seconds", "run", "stage_times"]

MICRO = 1e6
STAGES = {
    "boxes": "bounds of the voxels",
    "collect": "candidates for contact",
    "contacts": "contact, friction, floor",
    "runge_kutta": "springs: relaxation of lengths, four Runge-Kutta stages",
    "limit": "strain limits, new positions",
    "check": "self-folding",
}
"""Descriptions of the stages by the name of their function; one that is not listed is shown by its name."""


def run(config: Any, report: Report) -> dict[str, Any]:
    """Stages of a sub-step, parts of a control step, memory of an environment, seconds of compilation."""
    where = f"{config.task}, {config.num_envs} environments, {config.dtype}, {config.device}"
    case = Case(where, config.task, [one_body(config)], config.num_envs)
    with report.status("checking, then measuring"):
        runner = Runner(config, case)
        runner.fit()
        rates = measure({case.name: runner}, ["bare", *config.columns], config.repeats)[case.name]
        stages = stage_times(runner, config)
    parts = {HEADINGS[column]: MICRO / middle(values) for column, values in rates.items() if values}
    per = f"microseconds of {'CPU time' if config.device == 'cpu' else 'the device'} per control step of an environment"
    total = sum(stages.values())
    rows = [
        [STAGES.get(name, name), number(value), f"{value / total:.0%}" if total else "-"]
        for name, value in stages.items()
    ]
    report.table(f"{where}: stages, {per}", ["stage", "time", "share"], [*rows, ["all stages", number(total), ""]])
    report.table(f"{where}: parts, {per}", ["part", "time"], [[name, number(value)] for name, value in parts.items()])
    memory = groups(runner.env)
    shown = [[name, number(size / 1000)] for name, size in memory.items()]
    report.table(
        f"{where}: memory", ["arrays", "kB an environment"], [*shown, ["all", number(sum(memory.values()) / 1000)]]
    )
    report.note(f"Checked: within {runner.error:.1e} of one environment alone in float64.")
    report.note(
        "Stages run one by one over all environments here; in a control step a thread takes one pack through all of"
        " them, so that it stays in the cache, and their sum is not exactly the time of the physics."
    )
    figures = {"task": config.task, "check_error": runner.error, "stages": stages, "parts": parts, "bytes": memory}
    if config.compile:
        with report.status("compiling all kernels of a control step"):
            figures["compile"] = compile_seconds(config, report)
    return figures


def stage_times(runner: Runner, config: Any) -> dict[str, float]:
    """Microseconds per control step of an environment that each stage takes, by the name of its function.

    Raises:
        SimulationError: the stages do not do what the control step does.
    """
    sim = runner.env.sim
    state, device = sim.buffers, sim.device
    runner.env.reset()
    runner.rate("bare")
    stages = STAGES_OF[state.arithmetic]
    commands = [_record(build, state) for build in stages]
    times: dict[str, list[float]] = {build.__name__: [] for build in stages}
    before = sim.com("robot")
    substeps = sim.physics.substeps
    for turn in range((config.repeats + 1) * substeps):
        for build, command in zip(stages, commands, strict=True):
            began = clock(device)
            command.launch()
            seconds = clock(device) - began
            if turn >= substeps:  # the first control step warms up
                times[build.__name__].append(seconds)
    sim.forget_sensed()
    if not bool(torch.isfinite(sim.com("robot")).all()) or torch.equal(before, sim.com("robot")):
        raise SimulationError("The stages one by one do not move the bodies: their times mean nothing.")
    empty = _launch_seconds(device)
    share = MICRO * substeps / runner.num_envs
    return {name: max(middle(values or [0.0]) - empty, 0.0) * share for name, values in times.items()}


def _record(build: Callable, state: Any) -> wp.Launch | Command:
    inputs = [state.model, state.data, state.units, state.dt]
    return record(stage_kernel(build, state.precision, state.width), (state.packs, state.units), inputs, state.device)


@kernel
def _nothing():
    pass


def _launch_seconds(device: str) -> float:
    """Seconds of a launch and of reading the clock."""
    command = record(_nothing, 1, [], device)
    times = []
    for _ in range(200):
        began = clock(device)
        command.launch()
        times.append(clock(device) - began)
    return middle(times)


def compile_seconds(config: Any, report: Report) -> dict[str, float]:
    """CPU seconds of a fresh process that makes the environments and steps them, without and with cached kernels.

    Raises:
        SimulationError: that process has failed.
    """
    code = (
        "import warpvox as wv, numpy as np\n"
        f"env = wv.make_vec({config.task!r}, num_envs={config.num_envs}, dtype={config.dtype!r},"
        f" arithmetic={config.arithmetic!r}, device={config.device!r}, threads={config.threads})\n"
        "env.reset()\n"
        "env.step(np.ones((env.num_envs, env.num_actions)))\n"
        "env.sim.reset()\n"
        "print(env.sim.com('robot').cpu().isfinite().all().item())\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        seconds = {name: _cpu_seconds(code, folder) for name in ("first", "cached")}
    report.note(
        f"First run on a machine: {number(seconds['first'])} s of CPU time until the first control step and reset are"
        f" done, {number(seconds['cached'])} s with the kernels in the cache (start of Python and imports included)."
    )
    return seconds


def _cpu_seconds(code: str, cache: str) -> float:
    before, began = os.times(), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | {"WARP_CACHE_PATH": cache}, capture_output=True, text=True
    )
    after = os.times()
    if done.returncode or "True" not in done.stdout:
        raise SimulationError(f"The kernels could not be compiled: {done.stderr.strip()[-300:]}")
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return spent or time.perf_counter() - began
