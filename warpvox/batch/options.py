"""Options of a simulation, checked and chosen: arithmetic, layout, lanes, threads."""

from __future__ import annotations


import numpy as np

from warpvox.errors import SimulationError, did_you_mean, listing
from warpvox.kernels.device import on_cuda
from warpvox.kernels.lanes import MAX_WIDTH
from warpvox.kernels.step import STAGES
from warpvox.system import usable_cores

__all__ = ["CUDA_LANES", "choose_lanes", "choose_threads", "lanes_for", "resolve_arithmetic", "resolve_layout"]

# Lane widths offered on the CPU; the narrowest that holds the environments that can share a pack is taken.
WIDTHS = (1, 8, 16, 32)
LAYOUTS = ("group", "lanes")
CUDA_LANES = 32  # environments of a pack on CUDA, one thread each


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


def resolve_layout(layout: str | None, arithmetic: str, device: str, lanes: int | None) -> str:
    """'group' or 'lanes': None means 'group' on CUDA in fast arithmetic, unless ``lanes`` are asked for.

    Raises:
        SimulationError: neither of them, or a group for exact arithmetic or with lanes.
    """
    if layout is None:
        return "group" if on_cuda(device) and arithmetic == "fast" and lanes is None else "lanes"
    if layout not in LAYOUTS:
        hint = did_you_mean(layout, LAYOUTS) if isinstance(layout, str) else ""
        raise SimulationError(f"layout must be 'group', 'lanes' or None, got {layout!r:.80}.{hint}")
    if layout == "group" and (arithmetic != "fast" or lanes is not None):
        raise SimulationError(
            f"layout='group' is for arithmetic='fast' and lanes=None, got {arithmetic!r} and {lanes!r:.80}."
        )
    return layout


def lanes_for(environments: int) -> int:
    """The lanes that are chosen on the CPU for a number of environments that can share packs."""
    return next((width for width in WIDTHS if width >= environments), MAX_WIDTH)


def choose_lanes(index: np.ndarray, lanes: int | None, device: str) -> int:
    """Lanes of a pack, from the number of what each environment can share a pack with."""
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
        raise SimulationError(f"threads must be an integer >= 1 or None, got {threads!r:.80}.")
    return threads
