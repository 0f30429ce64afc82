"""``warpvox bench suite=kernels``: where a control step spends its time, memory, and the first compilation."""

import json
import os
import subprocess
import sys
import tempfile
import time
from typing import Any

import torch

from warpvox.bench.cases import one_body
from warpvox.bench.machine import memory
from warpvox.bench.report import Report, middle, number
from warpvox.bench.runner import HEADINGS, Runner, measure, seconds
from warpvox.errors import SimulationError
from warpvox.kernels.device import kernel, record
from warpvox.kernels.step import STAGES as STAGES_OF, stage_kernel

MICRO = 1e6
LAUNCHES = 200
"""Empty launches whose median is what a launch takes."""
STAGES = {
    "boxes": "bounds of the voxels",
    "collect": "candidates for contact",
    "contacts": "contact, friction, floor",
    "runge_kutta": "springs: relaxation of lengths, four Runge-Kutta stages",
    "limit": "strain limits, new positions",
    "check": "self-folding",
}
"""Descriptions of the stages by the name of their function; one that is not listed is shown by its name."""


def run(config: Any, report: Report) -> None:
    """Stages of a sub-step (of the layout ``lanes``), parts of a control step, memory, seconds of compilation."""
    where = f"{config.task}, {config.num_envs} environments, {config.dtype}, {config.device}"
    with report.console.status("checking, then measuring"):
        runner = Runner(config, [one_body(config)])
        rates = measure({"": runner}, ["bare", *config.columns], config.repeats)[""]
        # those of a group are parts of one kernel
        stages = stage_times(runner, config) if runner.env.sim.layout == "lanes" else {}
    parts = {HEADINGS[column]: MICRO / middle(values) for column, values in rates.items() if values}
    per = f"microseconds of {'CPU time' if config.device == 'cpu' else 'the device'} per control step of an environment"
    if stages:
        total = sum(stages.values())
        rows = [[STAGES.get(name, name), t, f"{t / total:.0%}" if total else "-"] for name, t in stages.items()]
        report.table(f"{where}: stages, {per}", ["stage", "time", "share"], [*rows, ["all stages", total, ""]])
        report.note(
            "Stages run one by one over all environments here; in a control step a thread takes one pack through all"
            " of them, so that it stays in the cache, and their sum is not exactly the time of the physics."
        )
    report.table(f"{where}: parts, {per}", ["part", "time"], list(parts.items()))
    sizes = memory(runner.env)
    shown = [[name, size / 1000] for name, size in (sizes | {"all": sum(sizes.values())}).items()]
    report.table(f"{where}: memory", ["arrays", "kB an environment"], shown)
    report.note(f"Checked: within {runner.error:.1e} of one environment alone in float64.")
    report.figures["check_error"] = runner.error
    with report.console.status("compiling all kernels of a control step"):
        report.figures["compile"] = compile_seconds(config, report)


def stage_times(runner: Runner, config: Any) -> dict[str, float]:
    """Microseconds per control step of an environment that each stage takes, by the name of its function."""
    sim = runner.env.sim
    state, device, substeps = sim.buffers, sim.device, sim.physics.substeps
    runner.env.reset()
    runner.rate("bare")
    inputs, shape = [state.model, state.data, state.units, state.dt], (state.packs, state.units)
    commands = {
        build.__name__: record(stage_kernel(build, state.precision, state.width), shape, inputs, device)
        for build in STAGES_OF[state.arithmetic]
    }
    times: dict[str, list[float]] = {name: [] for name in commands}
    before = sim.com("robot")
    for turn in range((config.repeats + 1) * substeps):
        for name, command in commands.items():
            taken = seconds(command.launch, device)
            if turn >= substeps:  # the first control step warms up
                times[name].append(taken)
    sim.forget_sensed()
    if not bool(torch.isfinite(sim.com("robot")).all()) or torch.equal(before, sim.com("robot")):
        raise SimulationError("The stages one by one do not move the bodies: their times mean nothing.")
    nothing = record(_nothing, 1, [], device)
    empty = middle([seconds(nothing.launch, device) for _ in range(LAUNCHES)])
    share = MICRO * substeps / runner.num_envs
    return {name: max(middle(values) - empty, 0.0) * share for name, values in times.items()}


@kernel
def _nothing():
    pass


def compile_seconds(config: Any, report: Report) -> dict[str, float]:
    """CPU seconds of a fresh process that makes the environments and steps them, without and with cached kernels."""
    names = ("task", "num_envs", "dtype", "arithmetic", "device", "threads")
    options = json.dumps({name: getattr(config, name) for name in names})
    words, found = [sys.executable, "-m", "warpvox.bench.sample", options, "0", "1"], {}
    with tempfile.TemporaryDirectory() as folder:
        for name in ("first", "cached"):
            before, began = os.times(), time.perf_counter()
            done = subprocess.run(words, env=os.environ | {"WARP_CACHE_PATH": folder}, capture_output=True, text=True)
            after = os.times()
            if done.returncode or done.stdout != "finite\n":
                raise SimulationError(f"The kernels could not be compiled: {done.stderr.strip()[-300:]}")
            spent = after.children_user + after.children_system - before.children_user - before.children_system
            found[name] = spent or time.perf_counter() - began
    report.note(
        f"First run on a machine: {number(found['first'])} s of CPU time until the first control step and reset are"
        f" done, {number(found['cached'])} s with the kernels in the cache (start of Python and imports included)."
    )
    return found
