"""Cached sensor readings of a simulation at one time, which terms use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from warpvox.errors import TaskError, did_you_mean, listing

if TYPE_CHECKING:
    from torch import Tensor

Quantity = tuple[Any, ...]
"""A sensing method of the simulation and its arguments."""


class Snapshot:
    """State of all environments at one time as terms see it: sensed on first use and cached.

    Quantities must be read before the simulation is stepped: :meth:`fetch` reads the quantities that rewards
    will ask of the state before the next step; :attr:`quantities` lists what has been read.

    Lengths are in simulator units (0.1 a voxel), velocities in those units per inner time (a control step
    lasts 30 x 1e-4 by default), angles in radians. Without ``copies`` terms must not write into the tensors.

    Args:
        sim: the simulation, or another object with its sensing methods.
        memory: the task's episode state, by name, which is then in ``memory_values``.
        values: quantities that are known already.
        copies: return copies, which terms may write to.
    """

    def __init__(
        self,
        sim: Any,
        memory: Mapping[str, Any] | None = None,
        values: Mapping[Quantity, Tensor] | None = None,
        copies: bool = False,
    ) -> None:
        self.sim = sim
        self.memory_values: Mapping[str, Tensor] = memory or {}
        self._copies = copies
        self._values: dict[Quantity, Tensor] = dict(values or {})

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Sensing methods and arguments used so far."""
        return tuple(self._values)

    def fetch(self, quantities: Iterable[Quantity]) -> Snapshot:
        """Sense ``quantities`` now; return this object."""
        for quantity in quantities:
            self._ask(*quantity)
        return self

    def value(self, quantity: Quantity) -> Tensor:
        """Return a sensed quantity without copying; read-only."""
        return self._values[quantity]

    def update(self, updates: Mapping[str, Callable[[Snapshot], Tensor]]) -> dict[str, Tensor]:
        """Compute the new values of all memories, one after another.

        Args:
            updates: by the name of a memory what gives its new value.
        """
        values = dict(self.memory_values)
        self.memory_values = values
        for name, update in updates.items():
            values[name] = update(self)
        return values

    def com(self, name: str) -> Tensor:
        """Return the centre of mass of an object, float64 ``[num_envs, 2]`` (p in B.1)."""
        return self._ask("com", name)

    def velocity(self, name: str) -> Tensor:
        """Return the velocity of an object's centre of mass, float64 ``[num_envs, 2]`` (v in B.1)."""
        return self._ask("velocity", name)

    def orientation(self, name: str) -> Tensor:
        """Return the rotation since time 0, float64 ``[num_envs]``, counter-clockwise in [0, 2 pi) (theta in B.1)."""
        return self._ask("orientation", name)

    def relative_positions(self, name: str) -> Tensor:
        """Return all points relative to the centre of mass, ``[num_envs, 2, points]`` (c in B.1)."""
        return self._ask("relative_positions", name)

    def positions(self, name: str) -> Tensor:
        """Return the positions of all points of an object, fixed ones included: ``[num_envs, points, 2]``."""
        return self._ask("object_positions", name)

    def velocities(self, name: str) -> Tensor:
        """Return the velocities of all points of an object, ``[num_envs, points, 2]``."""
        return self._ask("object_velocities", name)

    def actions(self, name: str) -> Tensor:
        """Return a robot's clipped actions of the last step, ``[num_envs, num_actions]``; 1 (at rest) without any.

        There are none behind those of a smaller body, and before the first step of an episode.
        """
        return self._ask("robot_actions", name)

    def floor_scan(self, name: str, reach: int, objects: tuple[str, ...]) -> Tensor:
        """Return distances down to ``objects`` in windows around an object: float64 ``[num_envs, 2 reach + 1]``."""
        return self._ask("floor_scan", name, reach, objects)

    def ceiling_scan(self, name: str, reach: int, objects: tuple[str, ...]) -> Tensor:
        """Return distances up to ``objects`` in windows around an object: float64 ``[num_envs, 2 reach + 1]``."""
        return self._ask("ceiling_scan", name, reach, objects)

    def extent(self, name: str) -> Tensor:
        """Return width and height of an object's bounding box, float64 ``[num_envs, 2]``."""
        return self._ask("extent", name)

    def hull_area(self, name: str) -> Tensor:
        """Return the area of the convex hull of all points of an object, float64 ``[num_envs]``."""
        return self._ask("hull_area", name)

    def memory(self, name: str) -> Tensor:
        """Return the value of a task's memory, ``[num_envs, ...]``.

        Raises:
            TaskError: the task has no such memory.
        """
        if name not in self.memory_values:
            hint = did_you_mean(name, self.memory_values)
            raise TaskError(f"The task has no memory {name!r}; it has {listing(self.memory_values)}.{hint}")
        value = self.memory_values[name]
        return value.clone() if self._copies else value

    def _ask(self, method: str, *args: object) -> Tensor:
        key = (method, *args)
        if key not in self._values:
            self._values[key] = getattr(self.sim, method)(*args)
        value = self._values[key]
        return value.clone() if self._copies else value
