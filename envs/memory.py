"""Memory is asked for before it is taken: bytes an environment, times environments, against what is free.

What is counted stays as long as there are environments: the arrays of the kernels, with room for the largest bodies
that may come, where the environments lie in them, observations, and what PPO keeps of a rollout. Intermediate results
come on top; :data:`MEMORY_SHARE` leaves room for them.
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

MEMORY_SHARE = 0.8
"""Share of the free memory that may be asked for."""
FLOAT, LONG = 4, 8
SCALARS = 6
"""Numbers of a transition besides observation, action, mean and deviation: reward, end, value, ..."""


def environment_bytes(
    spec: TaskSpec, worlds: Sequence[World], count: int, sim: ResolvedOptions, *, obs: str = "task", ppo: Any = None
) -> float:
    """Bytes of each of ``count`` environments; nothing of their size is made.

    Args:
        worlds: one for each design. In fast arithmetic there is room for all bodies of their common box or of the grid.
        obs: as in :func:`warpvox.make_vec`.
        ppo: settings of the learning that goes on besides (``steps``, ``hidden``, ``minibatches``); None: none.
    """
    robots, exact = list(spec.robots), sim.arithmetic == "exact"
    bodies = [world.objects[name] for world in worlds for name in robots]
    box = max(body.height for body in bodies), max(body.width for body in bodies)
    grid = sim.grid or (box if len(worlds) > 1 and not exact else None)  # exact packs hold one design each
    count = max(1, count // len(worlds)) if exact else count
    lanes = sim.lanes or lanes_for(count) if sim.device == "cpu" and sim.layout == "lanes" else sim.lanes
    largest = max(worlds, key=lambda world: sum(np.count_nonzero(world.objects[name].grid) for name in robots))
    one = replace(sim, grid=None, lanes=lanes)
    batch = Batch({b"": largest}, [0], one, spec.randomized, sim.layout)
    room = {} if grid is None else capacities(batch.frames[0], *grid, any(is_cut(body) for body in bodies))
    sizes = array_sizes(batch, batch.tables()[0] | batch.frame_tables(), room)
    pack = bytes_of(DATA, sizes, sim.dtype) + (0 if grid is None else bytes_of(MODEL, sizes, sim.dtype))
    num_obs = _entries(spec, obs, sizes["point"], prod(grid or box))
    each = pack / min(batch.lanes, count) + sizes["point"] * (3 * LONG + 2)
    each += num_obs * (LONG + 2 * np.dtype(sim.dtype).itemsize)
    if ppo is None:
        return each
    # a rollout, and a minibatch of it with the activations of two networks and their derivatives
    transition = num_obs + 3 * sizes["action"] + SCALARS
    return each + FLOAT * ppo.steps * (transition + (transition + 4 * sum(ppo.hidden)) / ppo.minibatches)


def _entries(spec: TaskSpec, obs: str, points: int, cells: int) -> int:
    """Entries of an observation, at most; terms that do not say how many they have count as one."""
    terms = [term for term in spec.observations if "voxel" not in obs or term.function is not shape]
    about = [(about_of(term.function), dict(term.params)) for term in terms]
    grids = len(spec.robots) * cells * NUM_FEATURES if "voxel" in obs else 0
    return grids + sum(1 if known is None else known.size(params, points) for known, params in about)


def fitting(each: float, device: str) -> float:
    """The number of things of ``each`` bytes that may be asked for; infinite where it is not known what is free."""
    free = free_memory(device)
    return inf if free is None else MEMORY_SHARE * free / each


def ask(
    each: float, count: int, device: str, key: str = "num_envs", things: str = "environments", step: int = 1
) -> None:
    """Raise MemoryLimitError, with the number that fits, if ``count`` things of ``each`` bytes are too many.

    Args:
        device: resolved.
        key: sets how many they are; ``step``: in multiples of this.
    """
    if count <= (most := fitting(each, device)):
        return
    free, fits = most * each / MEMORY_SHARE, int(most)
    whole = step * MAX_WIDTH if fits >= step * MAX_WIDTH else step  # packs that are full
    fits = fits // whole * whole
    remedy = f"{fits:,} fit: {key}={fits}" if fits else "not even the least number fits: free some memory"
    raise MemoryLimitError(
        f"{count:,} {things} need about {_gib(each * count)}, and {_gib(free)} are free on {device}; {remedy}."
        " memory_check=false tries it all the same."
    )


def _gib(size: float) -> str:
    return f"{size / 2**30:.3g} GiB"
