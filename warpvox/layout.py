"""How environments lie in memory: packs and lanes of equal designs, and the arrays of a simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import warp as wp

from warpvox.compile import Design, model_arrays
from warpvox.errors import SimulationError, did_you_mean, listing
from warpvox.kernels.broadphase import ENTRIES_PER_VOXEL, GRID_FROM
from warpvox.kernels.lanes import MAX_WIDTH
from warpvox.kernels.reset import STALE
from warpvox.kernels.state import CONSTANTS, CONTACT, DATA, MODEL, REAL, allocate, structs
from warpvox.kernels.step import STAGES
from warpvox.system import usable_cores
from warpvox.types import Physics
from warpvox.world import World

__all__ = ["MARGIN", "State", "choose_lanes", "choose_threads", "group", "lanes_for", "layout", "resolve_arithmetic"]

# Lane widths offered on the CPU; the narrowest that holds a design's environments is taken.
WIDTHS = (1, 8, 16, 32)
CUDA_LANES = 32  # environments of a pack on CUDA, one thread each
MARGIN = 0.04  # width added to boxes when candidates are collected, two fifths of a voxel
HITS, HITS_PER_VOXEL = 64, 12  # capacity for contacts that are put in order, in exact arithmetic
PAIRS_PER_VOXEL = 24  # capacity of the candidate list of an environment that has one of its own
# Lanes share a list. One that holds all pairs cannot be filled by an environment that has collapsed or exploded at the
# cost of the others; up to so many surface voxels (33 MB a pack) it does.
ALL_PAIRS = 2048


@dataclass
class State:
    """What kernels need to run: the structs, their arrays and how environments lie in them."""

    arithmetic: str
    precision: str
    device: str
    width: int
    lanes: int
    units: int
    packs: int
    num_envs: int
    dt: float
    sizes: dict[str, int]
    model: object
    data: object
    arrays: dict[str, wp.array]
    env_pack: wp.array
    env_lane: wp.array
    ranges: wp.array | None = None


def group(worlds: Sequence[World]) -> list[int]:
    """For every world the number of its design; equal worlds have one."""
    seen: dict[bytes, int] = {}
    by_id: dict[int, int] = {}
    index = []
    for world in worlds:
        if id(world) not in by_id:
            by_id[id(world)] = seen.setdefault(world.key(), len(seen))
        index.append(by_id[id(world)])
    return index


def lanes_for(environments: int) -> int:
    """The lanes that are chosen on the CPU for a number of environments of one design."""
    return next((width for width in WIDTHS if width >= environments), MAX_WIDTH)


def choose_lanes(index: list[int], lanes: int | None, device: str) -> int:
    if device != "cpu":
        if lanes is not None and (type(lanes) is not int or lanes != CUDA_LANES):
            raise SimulationError(f"lanes must be {CUDA_LANES} or None on CUDA, got {lanes!r}.")
        return CUDA_LANES
    if lanes is None:
        return lanes_for(int(np.bincount(index).max()))
    if type(lanes) is not int or lanes not in WIDTHS:
        raise SimulationError(f"lanes must be one of {listing(WIDTHS)}, got {lanes!r:.80}.")
    return lanes


def choose_threads(threads: int | None) -> int:
    if threads is None:
        return usable_cores()
    if type(threads) is not int or threads < 1:
        raise SimulationError(f"threads must be a whole number >= 1 or None, got {threads!r:.80}.")
    return threads


def resolve_arithmetic(arithmetic: str | None, dtype: str) -> str:
    """'fast' or 'exact'; None means 'fast' in float32 and 'exact' in float64.

    Raises:
        SimulationError: neither of them, or 'exact' in float32.
    """
    if arithmetic is None:
        return "exact" if dtype == "float64" else "fast"
    if not isinstance(arithmetic, str) or arithmetic not in STAGES:
        hint = did_you_mean(arithmetic, list(STAGES)) if isinstance(arithmetic, str) else ""
        raise SimulationError(f"arithmetic must be 'fast', 'exact' or None, got {arithmetic!r:.80}.{hint}")
    if arithmetic == "exact" and dtype != "float64":
        raise SimulationError(
            f"arithmetic='exact' repeats sums of double precision and needs dtype='float64', got dtype={dtype!r}."
        )
    return arithmetic


def layout(
    designs: list[Design], index: list[int], physics: Physics, arithmetic: str, precision: str, lanes: int, device: str
) -> State:
    """Lay the environments out in packs of one design each, and allocate Model and Data."""
    ordered = arithmetic == "exact"
    width = lanes if device == "cpu" else 1
    pack_design, env_pack, env_lane = [], np.zeros(len(index), np.int32), np.zeros(len(index), np.int32)
    for design in range(len(designs)):
        members = np.flatnonzero(np.asarray(index) == design)
        env_pack[members] = len(pack_design) + np.arange(len(members)) // lanes
        env_lane[members] = np.arange(len(members)) % lanes
        pack_design += [design] * -(-len(members) // lanes)
    host, sizes = model_arrays(designs, ordered)
    units = lanes // width
    sizes |= _capacities(sizes["voxel"], sizes["mobile"], width) | {
        "hit": HITS + HITS_PER_VOXEL * sizes["mobile"] if ordered else 1,
        "pack": len(pack_design),
        "lane": lanes,
        "unit": len(pack_design) * units,
    }
    host["pack_design"] = np.asarray(pack_design, dtype=np.int32)
    model, data = allocate(MODEL, sizes, precision, device), allocate(DATA, sizes, precision, device)
    for name, values in host.items():
        if values.size:
            vector = values.shape[len(model[name].shape) :]  # reshape, because assign would take any shape of that size
            values = values.reshape(model[name].shape + vector)
            model[name].assign(values.astype(precision) if MODEL[name][0] is REAL else values)
    types = structs(precision)
    state = State(
        arithmetic, precision, device, width, lanes, units, len(pack_design), len(index), physics.dt, sizes,
        types.Model(), types.Data(), model | data,
        wp.array(env_pack, dtype=int, device=device), wp.array(env_lane, dtype=int, device=device),
    )  # fmt: skip
    for struct, arrays in ((state.model, model), (state.data, data)):
        for name, array in arrays.items():
            setattr(struct, name, array)
    for name in CONSTANTS:
        setattr(state.model, name, MARGIN if name == "margin" else getattr(physics, name))
    contact = types.Contact()
    for name in CONTACT:
        setattr(contact, name, getattr(physics, name if name.startswith("friction") else f"contact_{name}"))
    state.model.contact = contact
    # Lanes without an environment hold the design at rest, frozen.
    home = wp.to_torch(model["home"])[torch.as_tensor(pack_design, device=device)]
    wp.to_torch(data["pos"]).copy_(home[:, :, None].expand(-1, -1, lanes))
    wp.to_torch(data["drift"]).fill_(STALE)
    return state


def _capacities(voxels: int, mobiles: int, width: int) -> dict[str, int]:
    """Capacities of the broad phase for a number of surface voxels, of those that are mobile, and of lanes."""
    gridded = mobiles if mobiles >= GRID_FROM else 0
    every = voxels * (voxels - 1) // 2
    return {
        "pair": every if width > 1 and voxels <= ALL_PAIRS else min(every, PAIRS_PER_VOXEL * voxels),
        "word": voxels * -(-voxels // 32),
        "entry": ENTRIES_PER_VOXEL * gridded,
        "slot": 1 << (2 * gridded).bit_length(),
    }
