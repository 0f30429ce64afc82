"""``warpvox bench suite=cuda``: the group kernel without a GPU: limits, instructions by stage, predicted speed."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp

from warpvox.bench.case import one_body
from warpvox.bench.ptxas import ARCHITECTURES, assemble, counted
from warpvox.bench.report import Report, number
from warpvox.envs.vec_env import make_vec
from warpvox.errors import ConfigError
from warpvox.kernels.device import record, zeros
from warpvox.kernels.group import WARP, Group, choose, group_kernel, places
from warpvox.kernels.step import record_actions
from warpvox.simulation import Simulation
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["instructions", "run"]

STAGES = {
    "candidates for contact": ("collect", "candidate"),
    "contacts": ("near_", "distant", "folds", "contact_"),
    "springs: relaxation of lengths": ("relax",),
    "springs: three Runge-Kutta stages": ("stretch", "stage"),
    "points: four Runge-Kutta stages": ("point", "floor", "gather", "finish"),
    "strain limits": ("limit",),
    "new positions and velocities": ("advance", "substep"),
}
"""The stages of a sub-step, and how the names of their places in the source begin."""
ENVS, SETTLING = 8, 20
"""Environments of which visits are counted, and control steps before."""


@dataclass(frozen=True)
class Device:
    """A GPU: multiprocessors, 10^9 cycles a second under load, float64 operations of a multiprocessor in a cycle."""

    processors: int
    clock: float
    wide: int


DEVICES = {
    "A100": Device(108, 1.41, 32), "RTX 4090": Device(128, 2.52, 2), "H100, H200 SXM": Device(132, 1.98, 64),
}  # fmt: skip
SCHEDULERS = 4
"""Of a multiprocessor: each issues an instruction of a warp in a cycle at most."""
EFFICIENCY = 0.25, 0.5
"""Share of the cycles in which they do: with 2 warps for each to choose from, an assumption."""
REGISTERS = 65536
"""Of a multiprocessor."""
SHARED = {80: 164, 89: 100, 90: 228, 100: 228}
"""Shared memory of a multiprocessor by compute capability, KiB."""


def visits(sim: Simulation, steps: int, seed: int) -> np.ndarray:
    """How often each place is visited in a sub-step by a warp: the most of its threads. Random actions, on the CPU."""
    state, names = sim.buffers, places()
    group, substeps = state.group, sim.physics.substeps
    rows = group.bytes // 8 + substeps * len(names)
    scratch = zeros((sim.num_envs, rows), wp.float64, "cpu")
    inputs = [state.model, state.data, scratch, 0, sim.num_envs, 0, substeps, state.dt]
    kernel = group_kernel(group, tallied=True)
    count = record(kernel, (sim.num_envs, group.parts), inputs, "cpu", WARP, together=True)
    actions = torch.zeros((sim.num_envs, sim.num_actions), dtype=sim.dtype)
    take = record_actions(state, wp.from_torch(actions), ACTION_LOW, ACTION_HIGH)
    draw, found = torch.Generator().manual_seed(seed), []
    for step in range(SETTLING + steps):
        actions.uniform_(ACTION_LOW, ACTION_HIGH, generator=draw)
        take.launch()
        count.launch()
        if step >= SETTLING:
            table = scratch.numpy()[:, group.bytes // 8 :].copy().view(np.int32)[:, : substeps * len(names)]
            found.append(table.reshape(sim.num_envs, substeps, len(names)))
    return np.stack(found).mean((0, 1, 2))


def instructions(sim: Simulation, steps: int, seed: int, architecture: int = 90) -> dict[str, tuple[float, float]]:
    """Warp instructions of an environment and sub-step by stage: all, and those in float64.

    The instructions of every place in the machine code, times its visits, over the environments of a warp. Loops that
    are unrolled stand in the code as often as they have rounds. What the compiler made in two versions counts twice.
    """
    sizes = sim.buffers.sizes
    group = choose(sizes["point"], sizes["spring"], "float32", "cuda:0")
    if group is None or group.springs > group.few * group.parts:
        raise ConfigError("Instructions are counted where all loops over springs are unrolled: take a smaller world.")
    rounds = dict.fromkeys(("relax", "stretch", "limit"), group.springs // group.parts)
    rounds |= dict.fromkeys(("point", "floor", "gather"), group.points // group.parts)
    static, wide, _ = counted(group_kernel(group), architecture)
    found = dict.fromkeys(STAGES, (0.0, 0.0))
    sim.buffers.group = group
    for name, visited in zip(places(), visits(sim, steps, seed), strict=True):
        stage = next(stage for stage, begins in STAGES.items() if name.startswith(begins))
        share = visited / rounds.get(name, 1) / (WARP // group.parts)
        every, double = found[stage]
        found[stage] = every + static[name] * share, double + wide[name] * share
    return found


def speed(device: Device, every: float, double: float, substeps: int, efficiency: float) -> float:
    """Control steps per second of a full GPU: by the instructions that are issued, and by those in float64."""
    issued = device.processors * SCHEDULERS * device.clock * 1e9 * efficiency / (every * substeps)
    return min(issued, device.processors * device.clock * 1e9 * device.wide / (WARP * double * substeps))


def _limits(report: Report, group: Group) -> list[dict[str, int]]:
    rows, found = [], []
    for architecture, name in ARCHITECTURES.items():
        with tempfile.TemporaryDirectory() as folder:
            limits = assemble(group_kernel(group), architecture, Path(folder))
        warps = min(REGISTERS // (-(-limits.registers // 8) * 8 * WARP), SHARED[architecture] * 1024 // limits.shared)
        values = [limits.registers, limits.spilled, limits.stack, limits.shared, warps * WARP // group.parts]
        rows.append([f"{architecture / 10} ({name})", *(f"{value:,}" for value in values)])
        found.append({"architecture": architecture} | vars(limits))
    heads = ["compute capability", "registers", "bytes spilled", "stack", "shared memory of a block", "environments"]
    report.table(
        f"Registers of a thread, bytes of memory, and environments of {group.parts} threads that a multiprocessor has"
        " registers and shared memory for",
        heads, rows,
    )  # fmt: skip
    return found


def run(config: Any, report: Report) -> dict[str, Any]:
    """Limits by compute capability, instructions by stage, predicted speeds."""
    env = make_vec(config.task, [one_body(config)], 1, device="cpu", dtype="float32", threads=1)
    sim = Simulation([env.sim.worlds[0]] * ENVS, env.sim.options, loose=env.sim.loose, layout="group")
    with report.status("compiling for CUDA, counting"):
        found = instructions(sim, config.steps, config.seed)
        group = choose(sim.buffers.sizes["point"], sim.buffers.sizes["spring"], "float32", "cuda:0")
        limits = _limits(report, group)
    every, double = (sum(pair[k] for pair in found.values()) for k in (0, 1))
    rows = [[stage, number(all_, 4), number(wide, 4)] for stage, (all_, wide) in found.items()]
    report.table(
        f"{config.task}: warp instructions of an environment and sub-step (machine code for 9.0; visits counted over"
        f" {config.steps} control steps with random actions)",
        ["stage", "all", "in float64"],
        [*rows, ["all stages", number(every, 4), number(double, 4)]],
    )
    speeds = {
        name: [speed(device, every, double, sim.physics.substeps, share) for share in EFFICIENCY]
        for name, device in DEVICES.items()
    }
    report.table(
        f"{config.task}: predicted control steps per second of the physics, of a full GPU; {EFFICIENCY[0]:.0%} and"
        f" {EFFICIENCY[1]:.0%} of the cycles issue an instruction",
        ["GPU", "least", "most"],
        [[name, *(f"{number(rate / 1e6)} M" for rate in rates)] for name, rates in speeds.items()],
    )
    return {"task": config.task, "instructions": found, "limits": limits, "predicted": speeds}
