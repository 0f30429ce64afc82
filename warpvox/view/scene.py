"""Scenes: the worlds of a rollout as meshes for pictures, without positions."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from warpvox.compile import CompiledWorld
from warpvox.design import as_grid
from warpvox.errors import RolloutError
from warpvox.io.world_files import LARGEST_GRID
from warpvox.types import ACTUATORS, VOXEL, Cell


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of a scene.

    Attributes:
        name: of the object; a robot is the object that has actuators.
        grid: int8 ``[rows, columns]``, row 0 on top.
        x, y: cell of the lower left corner of ``grid`` at the start.
        first_point, num_points: its share of the points of an environment; no points if it never moves.
        corners: int32 ``[cells, 4]``: points of every cell that is not empty at the top left, top right,
            bottom right and bottom left, counted over all points of the environment; ``[0, 4]`` if it never
            moves.
    """

    name: str
    grid: np.ndarray
    x: int
    y: int
    first_point: int
    num_points: int
    corners: np.ndarray

    @property
    def is_static(self) -> bool:
        """True if the object is fixed terrain."""
        return self.num_points == 0

    @property
    def is_robot(self) -> bool:
        """Whether the object has actuators."""
        return bool(np.isin(self.grid, ACTUATORS).any())

    @property
    def cells(self) -> np.ndarray:
        """Types of the non-empty cells, in the order of ``corners``: int8 ``[cells]``."""
        return self.grid[self.grid != Cell.EMPTY]

    @property
    def places(self) -> np.ndarray:
        """Row and column in ``grid`` of the non-empty cells, int ``[cells, 2]``."""
        return np.argwhere(self.grid != Cell.EMPTY)


@dataclass(frozen=True, eq=False)
class Scene:
    """A distinct world of a rollout as meshes of its objects.

    Attributes:
        objects: in the order of the simulator: robots, then the rest, each by name.
    """

    width: int
    height: int
    objects: tuple[SceneObject, ...]

    @property
    def moving(self) -> tuple[SceneObject, ...]:
        """Movable objects; only these have points."""
        return tuple(obj for obj in self.objects if not obj.is_static)

    @property
    def robots(self) -> tuple[SceneObject, ...]:
        """Objects with actuators, or all movable objects if there are none."""
        return tuple(obj for obj in self.moving if obj.is_robot) or self.moving

    @cached_property
    def corners(self) -> np.ndarray:
        """Point indices of the corners of all movable cells, object after object: int32 ``[cells, 4]``."""
        return np.concatenate([obj.corners for obj in self.moving])

    @cached_property
    def cells(self) -> np.ndarray:
        """Types of all movable cells, in the order of ``corners``: int8 ``[cells]``."""
        return np.concatenate([obj.cells for obj in self.moving])

    @cached_property
    def robot_points(self) -> np.ndarray:
        """Indices of the robots' points, int ``[k]``."""
        return np.concatenate([np.arange(o.first_point, o.first_point + o.num_points) for o in self.robots])

    @property
    def num_points(self) -> int:
        """Number of points; a rollout's positions beyond them are padding."""
        return sum(obj.num_points for obj in self.moving)

    @cached_property
    def terrain(self) -> np.ndarray:
        """Types of all fixed cells, int8 ``[height, width]``, row 0 on top."""
        cells = np.zeros((self.height, self.width), np.int8)
        for obj in self.objects:
            if obj.is_static:
                rows, columns = obj.places.T
                cells[self.height - obj.y - obj.grid.shape[0] + rows, obj.x + columns] = obj.cells
        return cells


def scene_of(world: CompiledWorld) -> Scene:
    """Convert a compiled world to a scene."""
    objects = []
    moving = {body.name for body in world.bodies}
    for body in sorted(world.bodies + world.statics, key=lambda body: (not body.source.is_robot, body.name)):
        source = body.source
        corners = np.zeros((0, 4), np.int32)
        first = count = 0
        if body.name in moving:
            corners = np.array(list(body.corners.values()), np.int32) + body.first_point
            first = body.first_point
            count = len(body.points)
        objects.append(SceneObject(body.name, source.grid, source.x, source.y, first, count, corners))
    return Scene(world.width, world.height, tuple(objects))


def stretch(cells: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Compute each cell's length along its axis of actuation, relative to rest length.

    Cells that are no actuators have the mean of both axes.

    Args:
        cells: types ``[cells]``.
        corners: their points in simulator units, ``[..., cells, 4, 2]``.

    Returns:
        ``[..., cells]``, of the type of ``corners``.
    """
    sides = np.linalg.norm(np.roll(corners, -1, axis=-2) - corners, axis=-1) / VOXEL
    across = (sides[..., 0] + sides[..., 2]) / 2
    upright = (sides[..., 1] + sides[..., 3]) / 2
    both = (across + upright) / 2
    return np.select([cells == Cell.H_ACT, cells == Cell.V_ACT], [across, upright], both)


def scene_to_json(scene: Scene) -> dict[str, Any]:
    """Convert a scene to JSON values (format: ``docs/formats.md``)."""
    arrays = [{"grid": obj.grid.tolist(), "corners": obj.corners.tolist()} for obj in scene.objects]
    objects = [vars(obj) | parts for obj, parts in zip(scene.objects, arrays, strict=True)]
    return {"width": scene.width, "height": scene.height, "objects": objects}


def scene_from_json(scene: Mapping[str, Any]) -> Scene:
    """Build a scene from JSON values; KeyError, TypeError, ValueError, OverflowError: not a valid scene."""
    objects = []
    for obj in scene["objects"]:
        name = obj["name"]
        if not isinstance(name, str) or not name:
            raise TypeError(f"expected a name, got {name!r:.80}")
        rows = obj["corners"]
        if not all(len(row) == 4 and all(type(number) is int for number in row) for row in rows):
            raise TypeError("expected four points a cell")
        objects.append(
            SceneObject(
                name=name,
                grid=as_grid(obj["grid"], what=f"grid of {name!r:.80}", error=ValueError),
                x=_check_index(obj["x"]),
                y=_check_index(obj["y"]),
                first_point=_check_index(obj["first_point"]),
                num_points=_check_index(obj["num_points"]),
                corners=np.array(rows, np.int32).reshape(-1, 4),
            )
        )
    return Scene(_check_index(scene["width"]), _check_index(scene["height"]), tuple(objects))


def _check_index(value: object) -> int:
    """Return ``value`` if it is an integer from 0 to 2^31 - 1; TypeError otherwise."""
    # int() would take "7", 7.9 and True without a word
    if type(value) is not int or not 0 <= value < 2**31:
        raise TypeError(f"expected an integer from 0 on, got {value!r:.80}")
    return value


def check_scene(scene: Scene, number: int, points: int) -> None:
    """Raise RolloutError unless a scene's parts fit together and have at most ``points`` points."""
    if not scene.moving:
        raise RolloutError(f"Scene {number} has nothing that moves.")
    if scene.width * scene.height > LARGEST_GRID:
        raise RolloutError(f"Scene {number} is {scene.width} x {scene.height}; {LARGEST_GRID:,} cells are the limit.")
    if len({obj.name for obj in scene.objects}) < len(scene.objects):
        raise RolloutError(f"Scene {number} has two objects of one name.")
    for obj in scene.objects:
        what = f"The object '{obj.name}' of scene {number}"
        if obj.grid.ndim != 2 or not np.isin(obj.grid, [int(cell) for cell in Cell]).all():
            raise RolloutError(f"{what} has a grid that is not made of cells.")
        rows, columns = obj.grid.shape
        if obj.x < 0 or obj.y < 0 or obj.x + columns > scene.width or obj.y + rows > scene.height:
            raise RolloutError(f"{what} sticks out of its world.")
        if obj.is_static:
            continue
        first = obj.first_point
        end = obj.first_point + obj.num_points
        if first < 0 or obj.num_points < 0 or end > points:
            raise RolloutError(f"{what} has points {first} to {end - 1}, but there are {points}.")
        if obj.corners.shape != (len(obj.cells), 4) or obj.corners.min() < first or obj.corners.max() >= end:
            raise RolloutError(f"{what} has corners that are not its points.")
