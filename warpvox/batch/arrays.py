"""The arrays of a simulation: their sizes, allocation and values, from the tables of a batch."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpvox.batch.packs import Batch
from warpvox.kernels.broadphase import ENTRIES_PER_VOXEL, GRID_FROM
from warpvox.kernels.device import from_numpy, on_cuda, put, set_fields, zeros
from warpvox.kernels.group import LINKS, Group, choose
from warpvox.kernels.state import CONSTANTS, CONTACT, DATA, MODEL, STALE, allocate, structs
from warpvox.types import Physics

MARGIN = 0.04  # width added to boxes when candidates are collected, two fifths of a voxel
HITS, HITS_PER_VOXEL = 64, 12  # capacity for contacts that are put in order, in exact arithmetic
PAIRS_PER_VOXEL = 24  # capacity of the candidate list of an environment that has one of its own
CELLS_PER_VOXEL = 16  # the same for cells of the terrain, in the group layout
# Lanes share a list. One that holds all pairs cannot be filled by an environment that has collapsed or exploded at the
# cost of the others; up to so many surface voxels (33 MB a pack) it does.
ALL_PAIRS = 2048
SIZES = {
    "point": "rest_pos", "active": "active", "joint": "link_start", "spring": "spring_rest", "link": "link",
    "rigid": "rigid_spring", "twin": "twin", "twin_end": "twin_end", "voxel": "body", "movable": "movable",
    "robot": "fold_limit", "row": "order", "object": "object_range", "node": "node", "leaf": "leaf",
    "plot": "cell_leaf",
}  # fmt: skip
"""Capacities and the tables whose second axis has them."""


@dataclass
class Buffers:
    """The arguments of all kernels: the structs, their arrays and the places of environments in them.

    ``group`` says what the group kernel is compiled for (see :mod:`warpvox.kernels.group`), None in the lanes layout;
    ``scratch`` takes the place of its shared memory on the CPU.
    """

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
    model: Any
    data: Any
    arrays: Mapping[str, wp.array]
    env_pack: wp.array
    env_lane: wp.array
    group: Group | None = None
    scratch: wp.array | None = None


def allocate_buffers(batch: Batch, precision: str) -> Buffers | None:
    """Allocate and fill Model and Data for a batch; None where the group layout does not take them.

    It has no room for large worlds, and no twins: points that stand for one point where connections are cut.
    """
    device, lanes = batch.device, batch.lanes
    width = lanes if device == "cpu" else 1
    units, packs = lanes // width, len(batch.pack_group)
    tables, which = batch.tables()
    if batch.grid is not None:  # any pack may come to differ from the others
        tables, which = {name: values[which] for name, values in tables.items()}, np.arange(packs)
    tables |= batch.frame_tables()
    sizes = array_sizes(batch, tables, batch.capacities())
    sizes["mesh"] = len(which) if batch.grid else int(which.max()) + 1
    tables.pop("actions")
    taken = None
    if batch.layout == "group":
        links = np.diff(tables["link_start"])
        moves = ((links > 0) | (tables["free_lanes"] != 0)).any(0)
        sizes["mover"] = sizes["point"] if batch.grid else 1 + int(np.flatnonzero(moves).max(initial=0))
        taken = choose(sizes["point"], sizes["spring"], precision, device, sizes["mover"])
        if taken is None or batch.cut or links.max(initial=0) > LINKS:
            return None
    arrays = allocate(MODEL | DATA, sizes, precision, device)
    types = structs(precision)
    state = Buffers(
        batch.arithmetic, precision, device, width, lanes, units, packs, len(batch.index), batch.physics.dt, sizes,
        types.Model(), types.Data(), arrays,
        from_numpy(batch.env_pack, int, device), from_numpy(batch.env_lane, int, device), taken,
        zeros((1, 1) if taken is None or on_cuda(device) else (packs, taken.row), wp.float64, device),
    )  # fmt: skip
    set_fields(state.model, arrays, MODEL)
    set_fields(state.data, arrays, DATA)
    _set_constants(state, batch.physics)
    put_tables(state, tables | {"pack_mesh": which.astype(np.int32)})
    # Lanes without an environment hold a body at rest, frozen.
    rest_pos = tables["rest_pos"][which]
    put(arrays, "pos", (slice(None), slice(rest_pos.shape[1])), rest_pos)
    put(arrays, "drift", slice(None), STALE)
    return state


def array_sizes(batch: Batch, tables: dict[str, np.ndarray], room: dict[str, int]) -> dict[str, int]:
    """The shape symbols of :mod:`warpvox.kernels.state`, with one mesh for each of ``tables``.

    Args:
        tables: those of all packs and of all frames.
        room: sizes that they have at least (:meth:`Batch.capacities`).
    """
    width = batch.lanes if batch.device == "cpu" else 1
    packs = len(batch.pack_group)
    sizes = {symbol: tables[name].shape[1] for symbol, name in SIZES.items()}
    sizes |= {"point": sizes["point"] // 2, "active": sizes["active"] // 2}
    sizes |= {"action": int(tables["actions"].max(initial=0))}
    sizes |= {name: max(sizes[name], size) for name, size in room.items()}
    sizes |= {"frame": len(tables["terrain"]), "cell": tables["terrain_side"].shape[1], "mesh": len(tables["actions"])}
    exact = batch.arithmetic == "exact"
    sizes["pulled"] = sizes["spring" if exact else "point"]
    sizes["hit"] = HITS + HITS_PER_VOXEL * sizes["movable"] if exact else 1
    sizes |= {"pack": packs, "lane": batch.lanes, "unit": packs * batch.lanes // width}
    return sizes | _capacities(sizes["voxel"], sizes["movable"], width, batch.layout == "group")


def put_tables(state: Buffers, tables: dict[str, np.ndarray], rows: np.ndarray | None = None) -> None:
    """Copy tables into the beginning of every axis of the Model's arrays, or of some of their ``rows``."""
    for name in MODEL.keys() & tables.keys():
        if not tables[name].size:
            continue
        values = tables[name]
        place = (slice(len(values)) if rows is None else rows, *map(slice, values.shape[1:]))
        put(state.arrays, name, place, values)


def _set_constants(state: Buffers, physics: Physics) -> None:
    for name in CONSTANTS:
        setattr(state.model, name, MARGIN if name == "margin" else getattr(physics, name))
    contact = structs(state.precision).Contact()
    for name in CONTACT:
        setattr(contact, name, getattr(physics, name if name.startswith("friction") else f"contact_{name}"))
    state.model.contact = contact


def _capacities(voxels: int, movables: int, width: int, grouped: bool) -> dict[str, int]:
    """Capacities of the broad phase for a number of surface voxels, of those that are movable, and of lanes.

    A group lists the cells of the terrain that may be touched behind the pairs.
    """
    gridded = movables if movables >= GRID_FROM else 0
    every = voxels * (voxels - 1) // 2
    pairs = every if width > 1 and voxels <= ALL_PAIRS else min(every, PAIRS_PER_VOXEL * voxels)
    return {
        "pair": pairs + (CELLS_PER_VOXEL * movables if grouped else 0),
        "word": voxels * -(-voxels // 32),
        "entry": ENTRIES_PER_VOXEL * gridded,
        "slot": 1 << (2 * gridded).bit_length(),
    }
