"""The arrays of a simulation: their sizes, allocation and values, from the tables of a batch."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpvox.batch.packs import Batch
from warpvox.kernels.broadphase import ENTRIES_PER_VOXEL, GRID_FROM
from warpvox.kernels.device import from_numpy, on_cuda, put, set_fields, shared_memory, zeros
from warpvox.kernels.group import LINKS, Group, choose
from warpvox.kernels.state import CONSTANTS, CONTACT, DATA, MODEL, STALE, allocate, structs


@dataclass
class Buffers:
    """The arguments of all kernels: structs, arrays, and the pack and lane of each environment.

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
    """Allocate and fill Model and Data for a batch; return None if the group layout has no room for its worlds.

    It has no room for large worlds, and no twins: points that stand for one point where connections are cut.
    """
    device = batch.device
    lanes = batch.lanes
    width = lanes if device == "cpu" else 1
    units = lanes // width
    packs = len(batch.pack_group)

    # Tables, and which of them each pack has; with a grid every pack has its own, as its bodies may be exchanged
    tables, which = batch.tables()
    if batch.grid is not None:
        tables = {name: values[which] for name, values in tables.items()}
        which = np.arange(packs)
    tables |= batch.frame_tables()

    # Sizes
    sizes = array_sizes(batch, tables, batch.capacities())
    sizes["mesh"] = len(which) if batch.grid else int(which.max()) + 1
    tables.pop("actions")
    group = None
    if batch.layout == "group":
        links = np.diff(tables["link_start"])
        moves = ((links > 0) | (tables["free_lanes"] != 0)).any(0)
        sizes["mover"] = sizes["active"] if batch.grid else 1 + int(np.flatnonzero(moves).max(initial=0))
        group = choose(sizes, precision, device, shared_memory(device))
        if group is None or batch.cut or links.max(initial=0) > LINKS:
            return None

    # Structs and their arrays
    arrays = allocate(MODEL | DATA, sizes, precision, device)
    types = structs(precision)
    scratch_shape = (1, 1)
    if group is not None and not on_cuda(device):
        scratch_shape = (packs, group.row)
    state = Buffers(
        arithmetic=batch.arithmetic,
        precision=precision,
        device=device,
        width=width,
        lanes=lanes,
        units=units,
        packs=packs,
        num_envs=len(batch.index),
        dt=batch.physics.dt,
        sizes=sizes,
        model=types.Model(),
        data=types.Data(),
        arrays=arrays,
        env_pack=from_numpy(batch.env_pack, int, device),
        env_lane=from_numpy(batch.env_lane, int, device),
        group=group,
        scratch=zeros(scratch_shape, wp.float64, device),
    )
    set_fields(state.model, arrays, MODEL)
    set_fields(state.data, arrays, DATA)

    # Constants. The margin is added to boxes when candidates are collected: two fifths of a voxel.
    physics = batch.physics
    for name in CONSTANTS:
        setattr(state.model, name, 0.04 if name == "margin" else getattr(physics, name))
    contact = types.Contact()
    for name in CONTACT:
        setattr(contact, name, getattr(physics, name if name.startswith("friction") else f"contact_{name}"))
    state.model.contact = contact

    # Values
    put_tables(state, tables | {"pack_mesh": which.astype(np.int32)})
    # Lanes without an environment hold a body at rest, frozen.
    rest_pos = tables["rest_pos"][which]
    put(arrays, "pos", (slice(None), slice(rest_pos.shape[1])), rest_pos)
    put(arrays, "drift", slice(None), STALE)
    return state


def array_sizes(batch: Batch, tables: dict[str, np.ndarray], room: dict[str, int]) -> dict[str, int]:
    """Return the size of every symbol in array shapes (:mod:`warpvox.kernels.state`) that holds these tables.

    Args:
        tables: those of all packs and of all frames.
        room: sizes that they have at least (:meth:`Batch.capacities`).
    """
    width = batch.lanes if batch.device == "cpu" else 1
    packs = len(batch.pack_group)

    # Meshes; x and y have a row each
    # capacities, and the tables whose second axis has them
    sizes_of = {
        "point": "rest_pos",
        "active": "active",
        "joint": "link_start",
        "spring": "spring_rest",
        "link": "link",
        "rigid": "rigid_spring",
        "twin": "twin",
        "twin_end": "twin_end",
        "voxel": "body",
        "movable": "movable",
        "robot": "fold_limit",
        "row": "order",
        "object": "object_range",
        "node": "node",
        "leaf": "leaf",
        "plot": "cell_leaf",
    }
    sizes = {symbol: tables[name].shape[1] for symbol, name in sizes_of.items()}
    sizes["point"] //= 2
    sizes["active"] //= 2
    sizes["action"] = int(tables["actions"].max(initial=0))
    for name, size in room.items():
        sizes[name] = max(sizes[name], size)
    sizes["mesh"] = len(tables["actions"])

    # Terrain
    sizes["frame"] = len(tables["terrain"])
    sizes["cell"] = tables["terrain_side"].shape[1]

    # Environments
    sizes["pack"] = packs
    sizes["lane"] = batch.lanes
    sizes["unit"] = packs * batch.lanes // width
    if batch.arithmetic == "exact":
        sizes["pulled"] = sizes["spring"]
        sizes["hit"] = 64 + 12 * sizes["movable"]  # contacts that are put in order
    else:
        sizes["pulled"] = sizes["point"]
        sizes["hit"] = 1
    return sizes | _capacities(sizes["voxel"], sizes["movable"], width, batch.layout == "group")


def put_tables(state: Buffers, tables: dict[str, np.ndarray], rows: np.ndarray | None = None) -> None:
    """Copy tables to the beginning of the Model's arrays, or into the given ``rows`` of their first axis."""
    if state.group is not None:
        tables = tables | {"links": _links(tables["link_start"], tables["link"])}
    for name in MODEL.keys() & tables.keys():
        if not tables[name].size:
            continue
        values = tables[name]
        place = (slice(len(values)) if rows is None else rows, *map(slice, values.shape[1:]))
        put(state.arrays, name, place, values)


def _links(link_start: np.ndarray, link: np.ndarray) -> np.ndarray:
    """Return the table ``links`` of groups, int32 ``[meshes, points, 4]``, from the tables of springs by point.

    Springs s that pull off fill the eight places of a point from the left, those that pull on the last ones, as 2 + s.
    Places between them hold 0, in the right half 1. Place 3 takes either; its highest bit is that of pulling on.
    """
    count = np.diff(link_start)
    mesh, point, n = np.nonzero(np.arange(LINKS) < count[:, :, None])
    spring = link[mesh, link_start[mesh, point] + n]
    pulls_on = spring >= 0
    place = np.where(pulls_on, LINKS - count[mesh, point] + n, n)
    marked = pulls_on & (place == LINKS // 2 - 1)
    number = np.maximum(spring, -1 - spring)
    shape = (*count.shape, LINKS)
    places = np.zeros(shape, np.uint16)
    places[:, :, LINKS // 2 :] = 1
    places[mesh, point, place] = 2 + number + (marked << 15)
    return places.view(np.int32)


def _capacities(voxels: int, movables: int, width: int, grouped: bool) -> dict[str, int]:
    """Return the sizes of the broad phase's arrays for ``voxels`` surface voxels and ``movables`` movable ones.

    A group lists the cells of the terrain that may be touched behind the pairs.
    """
    # Lanes share a list. One that holds all pairs cannot be filled by an environment that has collapsed or exploded at
    # the cost of the others; up to 2048 surface voxels (33 MB a pack) it does.
    pairs = voxels * (voxels - 1) // 2
    if width == 1 or voxels > 2048:
        pairs = min(pairs, 24 * voxels)
    if grouped:
        pairs += 16 * movables

    gridded = movables if movables >= GRID_FROM else 0
    return {
        "pair": pairs,
        "word": voxels * -(-voxels // 32),
        "entry": ENTRIES_PER_VOXEL * gridded,
        "slot": 1 << (2 * gridded).bit_length(),
    }
