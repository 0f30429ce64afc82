"""``warpvox bench suite=cuda``: the group kernel without a GPU: limits, instructions by stage, predicted speed."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
import warp as wp

from warpvox.bench.cases import make, one_body, sampled_bodies
from warpvox.bench.ptxas import ARCHITECTURES, Limits, assemble, counted
from warpvox.bench.report import Report, number
from warpvox.bench.wavefronts import by_place
from warpvox.errors import ConfigError
from warpvox.kernels.device import record, zeros
from warpvox.kernels.group import WARP, Group, choose, group_kernel, places
from warpvox.kernels.step import record_actions
from warpvox.simulation import Simulation
from warpvox.types import ACTION_HIGH, ACTION_LOW

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
SIDE, DIFFERENT = 5, 4
"""Cells of a side of random bodies, and how many of these share a warp."""
HEADS = ["instructions", "in float64", "wavefronts", "of these by conflicts"]
"""Counts of a warp, by environment and sub-step: instructions; wavefronts of shared memory, and those of them
that conflicts of banks cause, which are counted where the addresses are in tables of the body."""
DEVICES = {"A100": (108, 1.41, 32), "RTX 4090": (128, 2.52, 2), "H100, H200 SXM": (132, 1.98, 64)}
"""Multiprocessors, 10^9 cycles a second under load, float64 operations of a multiprocessor in a cycle."""
SCHEDULERS = 4
"""Schedulers of a multiprocessor: each issues an instruction of a warp in a cycle at most."""
EFFICIENCY = 0.25, 0.5
"""Share of the cycles in which they do: with 2 warps for each to choose from, an assumption."""
REGISTERS = 65536
"""Registers of a multiprocessor."""
SHARED = {80: 164, 89: 100, 90: 228, 100: 228}
"""Shared memory of a multiprocessor by compute capability, KiB."""
RESERVED = 1024
"""Bytes of it that CUDA takes for every block."""


def run(config: Any, report: Report) -> None:
    """Limits by compute capability, instructions by stage, predicted speeds, different bodies."""
    sim = _simulation(config, [one_body(config)])
    with report.status("compiling for CUDA, counting"):
        found = instructions(sim, config.steps, config.seed)
        _limits(report, _group(sim))
    whole = np.sum(list(found.values()), axis=0)
    _table(
        report,
        f"{config.task}: warp instructions and wavefronts of shared memory, of an environment and sub-step (machine"
        f" code for 9.0; visits counted over {config.steps} control steps with random actions; conflicts of banks are"
        " not counted for candidates, contacts and corrections of strain)",
        "stage",
        found | {"all stages": whole},
    )
    speeds = {name: _speeds(device, whole, sim.physics.substeps) for name, device in DEVICES.items()}
    report.table(
        f"{config.task}: predicted control steps per second of the physics, of a full GPU; {EFFICIENCY[0]:.0%} and"
        f" {EFFICIENCY[1]:.0%} of the cycles issue an instruction",
        ["GPU", "least", "most"],
        [[name, *(f"{number(rate / 1e6)} M" for rate in rates)] for name, rates in speeds.items()],
    )
    bodies = sampled_bodies(SIDE, DIFFERENT, config.seed)
    cases = {f"{DIFFERENT} different bodies": bodies} | {f"body {k} in all": [body] for k, body in enumerate(bodies)}
    with report.status("counting for different bodies"):
        counts = {
            name: instructions(_simulation(config, those), config.steps, config.seed) for name, those in cases.items()
        }
        different = {name: np.sum(list(count.values()), axis=0) for name, count in counts.items()}
    title = f"{config.task}, random {SIDE}x{SIDE} bodies: the same of an environment in a warp of such"
    _table(report, title, "", different)


def _simulation(config: Any, bodies: Sequence[np.ndarray]) -> Simulation:
    """Whole warps of environments, in which the bodies take turns."""
    options: dict[str, Any] = dict(device="cpu", dtype="float32", arithmetic=None, threads=1)
    sims = [make(config, [body], 1, **options).sim for body in bodies]
    worlds = [sims[k % len(sims)].worlds[0] for k in range(ENVS)]
    return Simulation(worlds, sims[0].options, loose=sims[0].loose, layout="group")


def _group(sim: Simulation) -> Group:
    """The group of threads that computes such worlds on CUDA; bodies that are measured here are small enough."""
    group = choose(sim.buffers.sizes["point"], sim.buffers.sizes["spring"], "float32", "cuda:0")
    assert group is not None
    return group


def _table(report: Report, title: str, head: str, counts: Mapping[str, np.ndarray]) -> None:
    rows = [[name, *map(float, count)] for name, count in counts.items()]
    report.table(title, [head, *HEADS], rows, partial(number, digits=4))


def visits(sim: Simulation, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """How often each place is visited in a sub-step by a warp: the most of its threads. Random actions, on the CPU.

    Also the shared memory of all groups, uint8 ``[environments, bytes]``, as the last sub-step has left it.
    """
    state, names = sim.buffers, places()
    group, substeps = state.group, sim.physics.substeps
    assert group is not None
    rows = group.row + substeps * len(names)
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
            table = scratch.numpy()[:, group.row :].copy().view(np.int32)[:, : substeps * len(names)]
            found.append(table.reshape(sim.num_envs, substeps, len(names)))
    return np.stack(found).mean((0, 1, 2)), scratch.numpy().view(np.uint8)[:, : group.bytes]


def instructions(sim: Simulation, steps: int, seed: int, architecture: int = 90) -> dict[str, np.ndarray]:
    """The counts of ``HEADS`` of an environment and sub-step, by stage.

    The instructions of every place in the machine code, times its visits, over the environments of a warp. Loops that
    are unrolled stand in the code as often as they have rounds. What the compiler made in two versions counts twice.
    Wavefronts come from the addresses in the tables of the bodies, else from the code, without conflicts.
    """
    group = _group(sim)
    if group is None or group.springs > group.few * group.parts:
        raise ConfigError("Instructions are counted where all loops over springs are unrolled: take a smaller world.")
    rounds = dict.fromkeys(("relax", "stretch", "limit"), group.springs // group.parts)
    rounds |= dict.fromkeys(("point", "floor", "gather"), group.points // group.parts)
    static = counted(group_kernel(group), architecture)
    sim.buffers.group, together = group, WARP // group.parts
    visited, memory = visits(sim, steps, seed)
    warps = [by_place(group, warp) for warp in memory.reshape(-1, together, group.bytes)]
    known = {name: np.mean([warp[name] for warp in warps], axis=0) for name in warps[0]}
    found = {stage: np.zeros(len(HEADS)) for stage in STAGES}
    for name, times in zip(places(), visited, strict=True):
        stage = next(stage for stage, begins in STAGES.items() if name.startswith(begins))
        every, wide, shared = static[name]
        waves, least = known.get(name, (shared, shared))
        share = times / cast(Any, rounds).get(name, 1) / together
        found[stage] += share * np.array([every, wide, waves, waves - least])
    return found


def _speeds(device: tuple[int, float, int], count: np.ndarray, substeps: int) -> list[float]:
    """Control steps per second of a full GPU: the least by all instructions, by those in float64, by shared memory."""
    (processors, clock, at_once), (every, wide, wavefronts, _) = device, count
    cycles = processors * clock * 1e9 / substeps
    by_others = min(cycles * at_once / (WARP * wide), cycles / wavefronts)
    return [float(min(cycles * SCHEDULERS * share / every, by_others)) for share in EFFICIENCY]


def blocks(limits: Limits, architecture: int) -> int:
    """Blocks of a warp that a multiprocessor has registers and shared memory for."""
    by_registers = REGISTERS // (-(-limits.registers // 8) * 8 * WARP)
    return min(by_registers, SHARED[architecture] * 1024 // (limits.shared + RESERVED))


def _limits(report: Report, group: Group) -> None:
    rows = []
    for architecture, name in ARCHITECTURES.items():
        with tempfile.TemporaryDirectory() as folder:
            limits = assemble(group_kernel(group), architecture, Path(folder))
        warps = blocks(limits, architecture)
        values = [limits.registers, limits.spilled, limits.stack, limits.shared, warps, warps * WARP // group.parts]
        rows.append([f"{architecture / 10} ({name})", *values])
    report.table(
        f"Registers of a thread, bytes of memory, and warps and environments of {group.parts} threads that a"
        " multiprocessor has registers and shared memory for",
        ["compute capability", *"registers,bytes spilled,stack,shared memory of a block,warps,environments".split(",")],
        rows,
    )
