"""What tasks see of the simulation at one moment."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from warpvox.sim import Simulation

__all__ = ["State"]

Quantity = tuple[object, ...]


class State:
    """Quantities of all environments, asked from the simulator on first use and kept from then on.

    It must be read while the simulator stands at the moment it is about: what was not asked for in time is
    lost. :attr:`quantities` says what has been asked for, so that a state that rewards will need as their
    "before" can be filled with :meth:`remember` in time.

    Lengths are in simulator units (0.1 a voxel), velocities in those units per inner time (a control step
    lasts 30 x 1e-4), angles in radians. Terms must not write into the tensors.
    """

    def __init__(self, sim: Simulation) -> None:
        self._sim = sim
        self._values: dict[Quantity, Tensor] = {}

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What has been asked for: the simulator's method and its arguments."""
        return tuple(self._values)

    def remember(self, quantities: Iterable[Quantity]) -> State:
        """Ask for ``quantities`` of another state now; return this state."""
        for quantity in quantities:
            self._ask(*quantity)
        return self

    def com(self, name: str) -> Tensor:
        """float64 ``[num_envs, 2]``: centre of mass of an object (p in B.1)."""
        return self._ask("com", name)

    def velocity(self, name: str) -> Tensor:
        """float64 ``[num_envs, 2]``: velocity of the centre of mass (v in B.1)."""
        return self._ask("velocity", name)

    def orientation(self, name: str) -> Tensor:
        """float64 ``[num_envs]``: turn since time 0, counter-clockwise in [0, 2 pi) (theta in B.1)."""
        return self._ask("orientation", name)

    def relative_positions(self, name: str) -> Tensor:
        """``[num_envs, 2, points]``: x row and y row of all points about the centre of mass (c in B.1)."""
        return self._ask("relative_positions", name)

    def positions(self, name: str) -> Tensor:
        """``[num_envs, points, 2]``: all points of an object, fixed ones included."""
        return self._ask("object_positions", name)

    def floor_scan(self, name: str, reach: int, objects: tuple[str, ...]) -> Tensor:
        """float64 ``[num_envs, 2 reach + 1]``: distances down to ``objects`` in windows about an object."""
        return self._ask("floor_scan", name, reach, objects)

    def _ask(self, method: str, *args: object) -> Tensor:
        key = (method, *args)
        if key not in self._values:
            self._values[key] = getattr(self._sim, method)(*args)
        return self._values[key]
