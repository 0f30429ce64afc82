"""How much memory environments need, known before it is allocated.

Simulations are the larger part: their arrays are measured on a few environments of the largest designs and scaled by
the number of packs. The rest (observations, rewards, intermediate results of a step) is a sum over the
sizes of observations and actions, with factors that ``tests/envs/test_needs.py`` compares with what a process takes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from warpvox.devices.names import resolve_device
from warpvox.devices.out_of_memory import free_memory
from warpvox.errors import MemoryLimitError
from warpvox.kernels.lanes import MAX_WIDTH
from warpvox.kernels.state import DATA
from warpvox.simulation import Simulation
from warpvox.world import World

__all__ = [
    "PROBED",
    "check_environments",
    "check_fits",
    "environment_bytes",
    "is_small",
    "probed",
    "simulation_bytes",
]

SHARE = 0.9
"""Of the memory that is free, what may be asked for."""
MARGIN = 0.95
"""Of the number that fits by proportion: tables of designs and packs that are not full weigh more where it is small."""
MOST_PER_CELL = 16_000
"""Bytes that a cell of a body takes in any simulation, at most: where this fits many times nothing is measured."""
SMALL = 0.25
"""Of the memory that is free, what is taken without a closer look."""
PROBED = 2
"""Designs on which arrays are measured: those with the most cells."""
STEP_FACTORS = 6, 6
"""Copies of observations and of actions that exist during a step."""


def cells_of(world: World) -> int:
    """Cells of a world that may move or be part of a body that does."""
    return sum(int(np.count_nonzero(item.grid)) for item in world.objects.values() if not item.is_static)


def simulation_bytes(probe: Simulation, designs: int, per_design: int) -> int:
    """Bytes of a simulation's arrays.

    Args:
        probe: a simulation of some environments of the largest worlds, as :func:`probe_of` makes.
        designs, per_design: the worlds, and environments of each, that are asked for.
    """
    state = probe.buffers
    data = sum(state.arrays[name].capacity for name in DATA)
    tables = sum(array.capacity for name, array in state.arrays.items() if name not in DATA)
    # A pack takes as much when it is not full. In exact arithmetic it holds one design; in fast arithmetic any, and has
    # tables of its own unless all packs are alike.
    if probe.arithmetic == "exact":
        packs, meshes = designs * -(-per_design // state.lanes), designs
    else:
        packs = -(-designs * per_design // state.lanes)
        meshes = 1 if designs == 1 else packs
    return round(data * packs / state.packs + tables * meshes / state.sizes["mesh"])


def probed(worlds: Sequence[World], per_design: int) -> list[World]:
    """The environments on which sizes are measured: a pack of each of the designs with the most cells."""
    largest = sorted(worlds, key=cells_of, reverse=True)[:PROBED]
    return [world for world in largest for _ in range(min(per_design, MAX_WIDTH))]


def environment_bytes(num_envs: int, num_obs: int, num_actions: int, itemsize: int) -> int:
    """Bytes that environments take besides their simulation, at the peak of a step."""
    observations, actions = STEP_FACTORS
    return num_envs * itemsize * (observations * num_obs + actions * num_actions)


def is_small(worlds: Sequence[World], per_design: int, free: int | None) -> bool:
    """Whether environments fit without a measurement; also True where free memory is unknown."""
    cells = max(cells_of(world) for world in worlds)
    return free is None or len(worlds) * per_design * cells * MOST_PER_CELL <= SMALL * free


def check_environments(worlds: Sequence[World], per_design: int, device: str, make: Callable[..., Simulation]) -> None:
    """Refuse environments whose simulation does not fit into what is free; costs nothing where they are few.

    Args:
        worlds: one of each design.
        per_design: environments of each.
        device: as for :class:`warpvox.Simulation`.
        make: makes a simulation as it will be made, of other worlds, on a ``device``.

    Raises:
        MemoryLimitError: with the number of environments that fits.
    """
    device = resolve_device(device, len(worlds) * per_design)
    free = free_memory(device)
    if not is_small(worlds, per_design, free):
        needed = simulation_bytes(make(probed(worlds, per_design), device=device), len(worlds), per_design)
        check_fits(needed, free, len(worlds) * per_design, len(worlds), device)


def check_fits(
    needed: int, free: int, count: int, step: int, device: str, key: str = "num_envs", things: str = "environments"
) -> None:
    """Raise MemoryLimitError, with the number that fits, if ``needed`` bytes are more than may be taken.

    Args:
        count: of the ``things`` that need so much, which ``key`` sets.
        step: their number is a multiple of this.
    """
    if needed <= SHARE * free:
        return
    fits = int(MARGIN * SHARE * free / needed * count)
    whole = step * MAX_WIDTH if fits >= step * MAX_WIDTH else step  # packs that are full
    fits = fits // whole * whole
    remedy = f"{fits:,} fit: {key}={fits}" if fits else "not even the least number fits: free some memory"
    raise MemoryLimitError(
        f"{count:,} {things} need about {gib(needed)}, and {gib(free)} are free on {device}; {remedy}."
        " memory_check=false tries it all the same."
    )


def gib(size: float) -> str:
    """``1.5 GiB``."""
    return f"{size / 2**30:.3g} GiB"
