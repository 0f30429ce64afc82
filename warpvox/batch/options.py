"""Options of a simulation and their defaults: device, precision, arithmetic, physics, layout, lanes, threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypedDict

import numpy as np

from warpvox.checks import check_choice, check_shape
from warpvox.devices.names import resolve_device
from warpvox.errors import ConfigError, SimulationError
from warpvox.kernels.device import on_cuda
from warpvox.kernels.lanes import MAX_WIDTH
from warpvox.kernels.step import STAGES
from warpvox.keys import Settings, check_known
from warpvox.system import usable_cores
from warpvox.types import Physics

_WIDTHS = (1, 8, 16, 32)
"""Lane widths offered on the CPU."""


@dataclass(frozen=True)
class SimOptions:
    """Options of a simulation, passed together as ``sim`` or as separate keyword arguments.

    Attributes:
        device: ``auto`` (CUDA where there is one, from 256 environments on), ``cpu``, ``cuda[:<index>]``.
        dtype: precision of the springs and of what is returned, ``float32`` or ``float64``. State and contacts are
            float64 in both.
        arithmetic: ``fast``, or ``exact`` (float64 only), which repeats the released simulator bit for bit: the same
            physics, every sum in its order. None: ``fast`` in float32, ``exact`` in float64.
        physics: preset or constants; None: the preset of the rules of a task, ``evogym`` in a simulation alone.
        lanes: environments that one CPU thread advances at once (1, 8, 16 or 32); None chooses.
        threads: CPU threads; None takes all cores.
        layout: ``lanes``, one thread an environment (on the CPU as vectors over environments), or ``group``, 16 to 512
            threads an environment, with its state on the chip for a whole control step. None: ``group`` on CUDA in fast
            arithmetic where a world's state fits into 48 KiB, else ``lanes``. On the CPU ``group`` is slow, and meant
            for tests.
        grid: rows and columns that bodies have at most, those put in later, too; arrays, observations and actions have
            room for the largest of them. Only in fast arithmetic.
        cuda_graph: of environments: on CUDA launch a whole control step, from the physics to rewards and resets, as one
            graph (see :mod:`warpvox.envs.graph`). None: but for tasks with functions of one's own, of which a graph
            would repeat only what they do on the device. Means nothing on the CPU.
        memory_check: of environments: refuse at once what does not fit into the memory that is free.
    """

    device: str = "auto"
    dtype: str = "float32"
    arithmetic: str | None = None
    physics: str | Physics | None = None
    lanes: int | None = None
    threads: int | None = None
    layout: str | None = None
    grid: tuple[int, int] | None = None
    cuda_graph: bool | None = None
    memory_check: bool = True

    __repr__ = Settings.__repr__

    @classmethod
    def of(cls, sim: SimOptions | None, given: Mapping[str, Any], *functions: Callable[..., Any]) -> SimOptions:
        """Merge ``sim`` (None: defaults) with options ``given`` by keyword; other names are arguments of ``functions``.

        Raises:
            ConfigError: see :func:`check_known`; or ``sim`` is something else.
        """
        given = check_known(given, *functions, cls)
        if sim is not None and not isinstance(sim, SimOptions):
            raise ConfigError(f"sim must be SimOptions(device=..., ...), got {sim!r:.80}.")
        return replace(sim or cls(), **given)

    def resolved(self, num_envs: int, preset: str = "evogym") -> ResolvedOptions:
        """Replace None in all options but ``lanes`` by the value for ``num_envs`` environments.

        Args:
            preset: of the physics, if none is named.

        Raises:
            SimulationError, DeviceError, ConfigError: an option that is none, or does not go with the others.
        """
        if not isinstance(self.dtype, str) or self.dtype not in ("float32", "float64"):
            raise SimulationError(f"dtype must be 'float32' or 'float64', got {self.dtype!r:.80}.")
        arithmetic = resolve_arithmetic(self.arithmetic, self.dtype)
        device = resolve_device(self.device, num_envs)
        physics = preset if self.physics is None else self.physics
        if self.threads is not None and (type(self.threads) is not int or self.threads < 1):
            raise SimulationError(f"threads must be an integer >= 1 or None, got {self.threads!r:.80}.")
        if self.grid is not None and arithmetic == "exact":
            raise SimulationError("Packs of exact arithmetic hold one world each: grid needs arithmetic='fast'.")
        chosen: dict[str, Any] = dict(
            device=device,
            arithmetic=arithmetic,
            physics=physics if isinstance(physics, Physics) else Physics.preset(physics),
            threads=usable_cores() if self.threads is None else self.threads,
            layout=resolve_layout(self.layout, arithmetic, device, self.lanes),
            grid=None if self.grid is None else check_shape("grid", self.grid),
        )
        return ResolvedOptions(**(vars(self) | chosen))


class SimKeywords(TypedDict, total=False):
    """The fields of :class:`SimOptions` as keywords, for editors and type checkers."""

    device: str
    dtype: str
    arithmetic: str | None
    physics: str | Physics | None
    lanes: int | None
    threads: int | None
    layout: str | None
    grid: tuple[int, int] | None
    cuda_graph: bool | None
    memory_check: bool


@dataclass(frozen=True)
class ResolvedOptions(SimOptions):
    """Options of a simulation without None, except in ``lanes``; see :meth:`SimOptions.resolved`."""

    arithmetic: str = "fast"
    physics: Physics = field(default_factory=Physics)
    threads: int = 1
    layout: str = "lanes"


def resolve_arithmetic(arithmetic: str | None, dtype: str) -> str:
    """Choose 'fast' or 'exact' arithmetic; None means 'fast' in float32 and 'exact' in float64.

    Raises:
        SimulationError: neither of them, or 'exact' in float32.
    """
    if arithmetic is None:
        return "exact" if dtype == "float64" else "fast"
    check_choice("arithmetic", arithmetic, [*STAGES, None], SimulationError)
    if arithmetic == "exact" and dtype != "float64":
        raise SimulationError(
            f"arithmetic='exact' repeats sums of double precision and needs dtype='float64', got dtype={dtype!r}."
        )
    return arithmetic


def resolve_layout(layout: str | None, arithmetic: str, device: str, lanes: int | None) -> str:
    """Choose the layout 'group' or 'lanes'; None means 'group' on CUDA in fast arithmetic without ``lanes``.

    Raises:
        SimulationError: neither of them, or a group for exact arithmetic or with lanes.
    """
    if layout is None:
        return "group" if on_cuda(device) and arithmetic == "fast" and lanes is None else "lanes"
    check_choice("layout", layout, ["group", "lanes", None], SimulationError)
    if layout == "group" and (arithmetic != "fast" or lanes is not None):
        raise SimulationError(
            f"layout='group' is for arithmetic='fast' and lanes=None, got {arithmetic!r} and {lanes!r:.80}."
        )
    return layout


def lanes_for(environments: int) -> int:
    """Return the smallest lane width on the CPU that holds ``environments`` environments in one pack."""
    return next(width for width in _WIDTHS if width >= min(environments, most_lanes()))


def most_lanes() -> int:
    """Return the largest lane width on the CPU: 32 with AVX-512, else 16."""
    import torch

    return MAX_WIDTH if torch.backends.cpu.get_cpu_capability() == "AVX512" else 16


def choose_lanes(index: np.ndarray, lanes: int | None, device: str) -> int:
    """Choose the lane width of packs; environments with equal ``index`` can share a pack."""
    if device != "cpu":  # one thread each
        if lanes is not None and (type(lanes) is not int or lanes != MAX_WIDTH):
            raise SimulationError(f"lanes must be {MAX_WIDTH} or None on CUDA, got {lanes!r}.")
        return MAX_WIDTH
    if lanes is None:
        return lanes_for(int(np.bincount(index).max()))
    check_choice("lanes", lanes, _WIDTHS, SimulationError)
    return lanes
