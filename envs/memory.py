"""Memory check before environments are created: estimated bytes against free memory.

What is counted stays as long as there are environments: the arrays of the kernels, with room for the largest bodies
that may come, where the environments lie in them, observations, and what PPO keeps of a rollout. Intermediate results
come on top; :data:`_MEMORY_SHARE` leaves room for them.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf, prod
from typing import Any

import numpy as np

from warpvox.batch.arrays import array_sizes
from warpvox.batch.frames import capacities, is_cut
from warpvox.batch.options import ResolvedOptions, lanes_for
from warpvox.batch.packs import Batch
from warpvox.devices.out_of_memory import free_memory
from warpvox.envs.about import about_of
from warpvox.envs.spec import TaskSpec
from warpvox.envs.terms.observations import shape
from warpvox.envs.voxels import NUM_FEATURES
from warpvox.errors import MemoryLimitError
from warpvox.kernels.lanes import MAX_WIDTH
from warpvox.kernels.state import DATA, MODEL, bytes_of
from warpvox.world import World

_MEMORY_SHARE = 0.8
"""Maximum fraction of the free memory that environments may take."""


def environment_bytes(
    spec: TaskSpec, worlds: Sequence[World], count: int, sim: ResolvedOptions, *, obs: str = "task", ppo: Any = None
) -> float:
    """Estimate the memory of each of ``count`` environments in bytes, without creating them.

    Args:
        worlds: one for each design. In fast arithmetic there is room for all bodies of their common box or of the grid.
        obs: as in :func:`warpvox.make_vec`.
        ppo: settings of the learning that goes on besides (``steps``, ``hidden``, ``minibatches``); None: none.
    """
    robots = list(spec.robots)
    bodies = [world.objects[name] for world in worlds for name in robots]
    exact = sim.arithmetic == "exact"

    # The grid that bodies have room on; exact packs hold one design each.
    box = max(body.height for body in bodies), max(body.width for body in bodies)
    grid = sim.grid
    if grid is None and len(worlds) > 1 and not exact:
        grid = box
    room_for = grid or box

    # The lanes of a pack
    if exact:
        count = max(1, count // len(worlds))
    lanes = sim.lanes
    if not lanes and sim.device == "cpu" and sim.layout == "lanes":
        lanes = lanes_for(count)

    # The sizes of arrays, from a pack with the largest body
    largest = max(worlds, key=lambda world: sum(np.count_nonzero(world.objects[name].grid) for name in robots))
    batch = Batch({b"": largest}, [0], replace(sim, grid=None, lanes=lanes), spec.randomized, sim.layout)
    room = {}
    if grid is not None:
        room = capacities(batch.frames[0], *grid, any(is_cut(body) for body in bodies))
    sizes = array_sizes(batch, batch.tables()[0] | batch.frame_tables(), room)

    # Kernels, places in them (numbers of 8 bytes) and observations, those that episodes begin with included
    pack = bytes_of(DATA, sizes, sim.dtype)
    if grid is not None:
        pack += bytes_of(MODEL, sizes, sim.dtype)
    num_obs = _entries(spec, obs, sizes["point"], prod(room_for))
    each = pack / min(batch.lanes, count) + sizes["point"] * (3 * 8 + 2)
    each += num_obs * (8 + 3 * np.dtype(sim.dtype).itemsize)
    if ppo is None:
        return each

    # A rollout in float32, and a minibatch of it with the activations of two networks and their derivatives. Besides
    # observation, action, mean and deviation a transition has six numbers: reward, end, value, ...
    transition = num_obs + 3 * sizes["action"] + 6
    learning = (transition + 4 * sum(ppo.hidden)) / ppo.minibatches
    if sim.device != "cpu":  # a graph keeps scaled inputs and means, and the rollout in the order of learning
        learning += 2 * transition
    return each + 4 * ppo.steps * (transition + learning)


def _entries(spec: TaskSpec, obs: str, points: int, cells: int) -> int:
    """Estimate the number of columns of an observation, from above; a term without :class:`About` counts as one."""
    by_voxel = "voxel" in obs
    entries = len(spec.robots) * cells * NUM_FEATURES if by_voxel else 0
    for term in spec.observations:
        if by_voxel and term.function is shape:
            continue
        about = about_of(term.function)
        entries += 1 if about is None else about.size(dict(term.params), points)
    return entries


def fitting(each: float, device: str) -> float:
    """Return how many items of ``each`` bytes fit into free memory; infinity if that is unknown."""
    free = free_memory(device)
    return inf if free is None else _MEMORY_SHARE * free / each


def ask(
    each: float, count: int, device: str, key: str = "num_envs", things: str = "environments", step: int = 1
) -> None:
    """Raise MemoryLimitError if ``count`` items of ``each`` bytes exceed free memory; the message says how many fit.

    Args:
        device: resolved.
        key: sets how many they are; ``step``: in multiples of this.
    """
    if count <= (most := fitting(each, device)):
        return
    free = most * each / _MEMORY_SHARE
    fits = int(most)
    whole = step * MAX_WIDTH if fits >= step * MAX_WIDTH else step  # packs that are full
    fits = fits // whole * whole
    remedy = f"{fits:,} fit: {key}={fits}" if fits else "not even the least number fits: free some memory"
    raise MemoryLimitError(
        f"{count:,} {things} need about {_gib(each * count)}, and {_gib(free)} are free on {device}; {remedy}."
        " memory_check=false tries it all the same."
    )


def _gib(size: float) -> str:
    return f"{size / 2**30:.3g} GiB"
