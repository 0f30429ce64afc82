"""Sensing in a simulation: positions of points, centres of mass, orientations, hulls, scans of the terrain."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
import warp as wp

from warpvox.batch.arrays import Buffers
from warpvox.batch.objects import Objects
from warpvox.kernels import sensing
from warpvox.kernels.device import Command
from warpvox.types import SIGHT

Recorded = wp.Launch | Command


class Sensing:
    """The sensors of :class:`warpvox.Simulation`; methods return new tensors."""

    num_envs: int
    device: str
    dtype: torch.dtype
    object_names: list[str]
    _state: Buffers
    _objects: Objects

    def _begin_sensing(self) -> None:
        self._sensors: dict[tuple, tuple[Recorded, list[torch.Tensor]]] = {}
        self._scans: dict[tuple[str, ...] | None, tuple] = {}
        self._fixed: dict[tuple[str, int], tuple[torch.Tensor, torch.Tensor]] = {}
        self._centres_are_new = False

    @contextmanager
    def sensing_anew(self) -> Iterator[dict[tuple[Any, ...], tuple[Recorded, list[torch.Tensor]]]]:
        """Use separate kernel launches and buffers for sensing in the block; yield them by (kernel, arguments)."""
        kept = self._sensors
        self._sensors = {}
        self._centres_are_new = False
        try:
            yield self._sensors
        finally:
            self._sensors = kept
            self._centres_are_new = False

    @property
    def sensing_buffers(self) -> list[torch.Tensor]:
        """The tensors that sensing kernels write to."""
        return [buffer for _, buffers in self._sensors.values() for buffer in buffers]

    def forget_sensed(self) -> None:
        """Discard cached centres of mass; call this after writing to points directly."""
        self._centres_are_new = False

    def object_positions(self, name: str) -> torch.Tensor:
        """Return positions of an object's points, [num_envs, points, 2], in simulator units, padded with 0."""
        return self._points(name, 0)

    def object_velocities(self, name: str) -> torch.Tensor:
        """Return the integrator's velocities of an object's points, [num_envs, points, 2], padded with 0."""
        return self._points(name, 1)

    def relative_positions(self, name: str) -> torch.Tensor:
        """Return an object's points relative to its centre of mass, [num_envs, 2, points], padded with 0."""
        return self._points(name, 2).transpose(1, 2)

    def _sense(self, key: tuple, dim, shapes: list[tuple], *inputs):
        """Launch the sensing kernel ``key[0]`` and return its buffers; recorded once for each ``key``."""
        if key not in self._sensors:
            buffers = [torch.zeros(shape, dtype=torch.float64, device=self.device) for shape in shapes]
            kind = wp.vec2d if key[0] in ("centres", "extents") else None
            arrays = [wp.from_torch(buffer, dtype=kind) for buffer in buffers]
            self._sensors[key] = sensing.record(self._state, key[0], dim, *inputs, *arrays), buffers
        command, buffers = self._sensors[key]
        command.launch()
        return buffers

    def _points(self, name: str, what: int) -> torch.Tensor:
        """Return points of an object as ``what`` says: positions (0), velocities (1), relative positions (2)."""
        objects = self._objects
        inputs = [objects.index(name), what]
        shape = (self.num_envs, objects.num_points[name], 2)
        if name in objects.movable:
            found = self._sense(("points", *inputs), self.num_envs, [shape], *inputs)[0]
            out = found.to(self.dtype, copy=True)
        else:
            out = torch.zeros(shape, dtype=self.dtype, device=self.device)
        if name in objects.terrain and what != 1:
            if (name, what) not in self._fixed:
                self._fixed[name, what] = objects.still_points(name, self.dtype, what == 2)
            fixed, is_fixed = self._fixed[name, what]
            out = torch.where(is_fixed, fixed, out)
        return out

    def com(self, name: str) -> torch.Tensor:
        """Return the centre of mass of a movable object, float64 [num_envs, 2] (B.1)."""
        return self._centres()[0][:, self._objects.moving(name)].clone()

    def velocity(self, name: str) -> torch.Tensor:
        """Return the velocity of an object's centre of mass, float64 [num_envs, 2] (B.1)."""
        return self._centres()[1][:, self._objects.moving(name)].clone()

    def _centres(self) -> list[torch.Tensor]:
        """Return centres of mass and their velocities, [num_envs, objects, 2] each, cached for one step."""
        shape = (self.num_envs, len(self.object_names), 2)
        if self._centres_are_new:
            return self._sensors["centres",][1]
        self._centres_are_new = True
        return self._sense(("centres",), shape[:2], [shape, shape])

    def orientation(self, name: str) -> torch.Tensor:
        """Return the rotation of an object since time 0, counter-clockwise, float64 [num_envs] in [0, 2 pi) (B.1)."""
        return self._sense_object("orientations", name)

    def extent(self, name: str) -> torch.Tensor:
        """Return width and height of a movable object's bounding box, float64 [num_envs, 2]."""
        return self._sense_object("extents", name, 2)

    def hull_area(self, name: str) -> torch.Tensor:
        """Return the area of a movable object's convex hull, float64 [num_envs] (B.6.1)."""
        return self._sense_object("hulls", name)

    def _sense_object(self, kernel: str, name: str, *sizes: int) -> torch.Tensor:
        """Run a sensing kernel for one object and return float64 [num_envs, *sizes]."""
        index = self._objects.moving(name)
        return self._sense((kernel, index), self.num_envs, [(self.num_envs, *sizes)], index)[0].clone()

    def floor_scan(self, name: str, reach: int, objects: Sequence[str] | None = None) -> torch.Tensor:
        """Return the depth of the terrain below an object's centre of mass, float64 [num_envs, 2 reach + 1].

        Window i, from -reach to reach voxels beside it and one voxel wide, holds the distance down to the highest
        point of the listed objects (None: all that never move) below the centre; 5 voxels (0.5) where there is none.
        """
        return self._scan(name, reach, objects, -1)

    def ceiling_scan(self, name: str, reach: int, objects: Sequence[str] | None = None) -> torch.Tensor:
        """Return the height of the terrain above an object's centre of mass, float64 [num_envs, 2 reach + 1]."""
        return self._scan(name, reach, objects, 1)

    def _scan(self, name: str, reach: int, objects: Sequence[str] | None, up: int) -> torch.Tensor:
        """Scan the terrain below (``up`` -1) or above (1) an object's centre of mass, [num_envs, 2 reach + 1]."""
        listed = tuple(objects) if objects is not None else None
        if listed not in self._scans:
            self._scans[listed] = self._objects.scan_tables(listed)
        shape = (self.num_envs, 2 * reach + 1)
        inputs = [self._objects.moving(name), reach, float(SIGHT), up]
        key = ("scans", *inputs, listed)
        return self._sense(key, self.num_envs, [shape], *inputs, *self._scans[listed])[0].clone()
