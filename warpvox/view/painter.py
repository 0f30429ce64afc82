"""Painting of scenes: camera, terrain and voxels, for any positions of the points.

Everything that does not move is painted once, as a wide sprite from which each frame is cut: an integer number
of pixels to a voxel and a camera that moves by whole pixels keep terrain and grid sharp without any
filtering. Only the boxes around moving objects are painted larger and scaled down, which is what makes their
edges smooth.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from warpvox.errors import RolloutError
from warpvox.io.writing import atomic_path
from warpvox.palette import colour_index, palette
from warpvox.types import VOXEL, Cell
from warpvox.view.rollout import Rollout, scenes_of
from warpvox.view.scene import Scene, stretch

SKY = (249, 250, 252)
GRID = (233, 237, 242)
INK = (28, 30, 36)
BELOW = 1.25
"""Margin of the camera below and beside the world, in voxels."""


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Load Pillow's built-in font."""
    return ImageFont.load_default(size)


PNG_SUFFIXES = (".png",)
"""File name suffixes that :func:`save_png` accepts."""


def save_png(image: Image.Image, path: str | os.PathLike[str], optimize: bool = False) -> Path:
    """Write a picture as PNG atomically; return the path."""
    with atomic_path(path, follow=True) as temporary:
        image.save(temporary, "PNG", optimize=optimize)
    return Path(path)


def camera_path(scene: Scene, positions: np.ndarray, view: tuple[float, float]) -> np.ndarray:
    """Return the camera's lower left corner in voxels for every frame, float64 ``[T, 2]``.

    The camera follows the robot's centre, smoothed over past and future alike, so that it neither shakes nor
    lags. It shows no more of what lies beyond the world than it must to keep the robot in view.

    Args:
        positions: its points, ``[T, P, 2]`` in simulator units.
        view: width and height of the picture in voxels.
    """
    # The robot in each frame, in voxels
    points = np.clip(positions[:, scene.robot_points] / np.float32(VOXEL), -1e4, 1e4)
    low = points.min(axis=1).astype(np.float64)
    high = points.max(axis=1).astype(np.float64)
    centre = points.mean(axis=1, dtype=np.float64)

    # Its centre stands in the middle of the picture, a little below half of its height.
    size = np.array(view)
    corner = centre - size * np.array([0.5, 0.42])

    # The world's ends on the left, on the right and at the bottom are borders; upwards there is always air.
    world = np.array([scene.width, scene.height], dtype=np.float64)
    room = world + 2 * BELOW - size
    if room[0] > 0:
        corner[:, 0] = np.clip(corner[:, 0], -BELOW, room[0] - BELOW)
    else:
        corner[:, 0] = (world[0] - size[0]) / 2
    corner[:, 1] = np.maximum(corner[:, 1], -BELOW)

    # Smooth the motion by a Gaussian over frames, wider along y.
    for axis, width in ((0, 9.0), (1, 22.0)):
        reach = int(3 * width)
        weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
        padded = np.pad(corner[:, axis], reach, mode="edge")
        corner[:, axis] = np.convolve(padded, weights / weights.sum(), mode="valid")

    # The robot as a whole stays in the picture, if there is room for it.
    least = high + 0.5 - size
    most = low - 0.5
    return np.where(least <= most, np.clip(corner, least, most), centre - size / 2)


def _fitting_scale(scene: Scene, size: tuple[int, int], voxels: float | None = None) -> int:
    """Return the scale in pixels per voxel: ``voxels`` fit the picture's height; None fits the robots."""
    if voxels is None:
        # Twelve, or as many as leave the robot less than half of the picture
        rows = [obj.y + obj.grid.shape[0] - obj.places[:, 0] for obj in scene.robots]  # upper edges of cells
        tall = max(row.max() for row in rows) - min(row.min() for row in rows) + 1
        voxels = max(12.0, 2.4 * tall)
    return max(3, round(size[1] / voxels))


@dataclass(frozen=True)
class Mesh:
    """A moving object's cells and sides for painting; a side shared by two cells is listed once."""

    corners: np.ndarray  # [cells, 4]
    columns: np.ndarray  # [cells] where the object's cells lie among all that move
    points: np.ndarray  # [k]
    inner: np.ndarray  # [m, 2] sides between two cells
    inner_dark: np.ndarray  # bool [m]: both cells are dark
    outer: np.ndarray  # [n, 2] sides of one cell

    @classmethod
    def of(cls, scene: Scene, number: int) -> Mesh:
        """Build the mesh of a scene's moving object."""
        obj = scene.moving[number]
        begin = sum(len(other.cells) for other in scene.moving[:number])

        # Sides of cells, those between two cells once
        sides = np.stack([obj.corners, np.roll(obj.corners, -1, axis=1)], axis=-1).reshape(-1, 2)
        ends = np.sort(sides, axis=1)
        _, first, index, counts = np.unique(ends, axis=0, return_index=True, return_inverse=True, return_counts=True)
        is_inner = counts > 1

        # Whether all cells of a side are dark
        owners = np.repeat(np.arange(len(obj.cells)), 4)
        pale = ~np.isin(obj.cells, (int(Cell.RIGID), int(Cell.FIXED)))
        all_dark = np.bincount(index.reshape(-1), pale[owners]) == 0
        return cls(
            corners=obj.corners,
            columns=np.arange(begin, begin + len(obj.cells)),
            points=np.arange(obj.first_point, obj.first_point + obj.num_points),
            inner=sides[first[is_inner]],
            inner_dark=all_dark[is_inner],
            outer=sides[first[counts == 1]],
        )


class Canvas:
    """Paints pictures of one scene for any point positions and any camera.

    Args:
        size: width and height of the picture in pixels.
        scale: pixels to a voxel.
    """

    def __init__(self, scene: Scene, size: tuple[int, int], scale: int) -> None:
        self.scene = scene
        self.size = size
        self.scale = scale
        self._meshes = [Mesh.of(scene, number) for number in range(len(scene.moving))]
        self._colours = [tuple(colour) for colour in palette().tolist()]
        self._low = self._high = np.zeros(2, int)
        self._sprite: Image.Image | None = None

    def picture(self, positions: np.ndarray, corner: tuple[int, int]) -> Image.Image:
        """Paint the scene with its points at ``positions`` ``[P, 2]``.

        Args:
            positions: in simulator units; points beyond those of the scene are ignored.
            corner: pixels from the world's origin to the lower left corner of the picture.
        """
        left, bottom = (int(value) for value in corner)
        image = self._backdrop(left, bottom)
        points = positions * np.float32(self.scale / VOXEL)
        points = np.stack([points[:, 0] - left, self.size[1] + bottom - points[:, 1]], axis=1)
        colours = colour_index(self.scene.cells, stretch(self.scene.cells, positions[self.scene.corners]))
        for mesh in self._meshes:
            self._paint(image, points, mesh, colours[mesh.columns])
        return image

    def _paint(self, image: Image.Image, points: np.ndarray, mesh: Mesh, colours: np.ndarray) -> None:
        """Paint an object onto the picture with smooth edges, by drawing it larger and scaling down."""
        # The box around the object, as far as it lies in the picture
        own = points[mesh.points]
        low = np.maximum(np.floor(own.min(axis=0)) - 2, 0).astype(int)
        high = np.minimum(np.ceil(own.max(axis=0)) + 3, self.size).astype(int)
        if (low >= high).any():
            return
        box = (*low.tolist(), *high.tolist())
        patch = image.crop(box)

        # Four times larger, which is what makes edges smooth
        smooth = 4
        large = patch.resize((patch.width * smooth, patch.height * smooth), Image.Resampling.NEAREST)
        draw = ImageDraw.Draw(large)
        xy = (points - low) * smooth
        thin = max(1, round(smooth * self.scale / 30))
        thick = max(1, round(smooth * self.scale / 16))

        # Cells
        is_seen = seen(xy[mesh.corners], large.size)
        quads = xy[mesh.corners[is_seen]].reshape(-1, 8)
        for quad, colour in zip(quads.tolist(), colours[is_seen].tolist(), strict=True):
            draw.polygon(quad, fill=self._colours[colour])

        # Sides between two cells, pale where both are dark
        is_seen = seen(xy[mesh.inner], large.size, thin)
        sides = xy[mesh.inner[is_seen]].reshape(-1, 4)
        for side, dark in zip(sides.tolist(), mesh.inner_dark[is_seen].tolist(), strict=True):
            draw.line(side, fill=(98, 100, 108) if dark else INK, width=thin)

        # Sides of one cell, with round joints: lines alone would leave notches at corners
        outer = mesh.outer[seen(xy[mesh.outer], large.size, thick)]
        for side in xy[outer].reshape(-1, 4).tolist():
            draw.line(side, fill=INK, width=thick)
        radius = (thick - 1) / 2
        for x, y in xy[np.unique(outer)].tolist():
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=INK)
        image.paste(large.reduce(smooth), box[:2])

    def cover(self, low: np.ndarray, high: np.ndarray) -> Image.Image:
        """Paint and cache the terrain for all cameras with corners between ``low`` and ``high`` (pixels)."""
        low = np.asarray(low) // self.scale
        high = -(-(np.asarray(high) + self.size) // self.scale)
        self._low = low
        self._high = high
        self._sprite = self._terrain()
        return self._sprite

    def _backdrop(self, left: int, bottom: int) -> Image.Image:
        """Crop the terrain behind a picture from the cached terrain, which is painted if needed."""
        corner = np.array([left, bottom])
        is_covered = np.all(self._low * self.scale <= corner) and np.all(corner + self.size <= self._high * self.scale)
        sprite = self._sprite
        if sprite is None or not is_covered:
            half = np.array(self.size) // 2
            sprite = self.cover(corner - half, corner + half)
        x = left - self._low[0] * self.scale
        y = self._high[1] * self.scale - bottom - self.size[1]
        return sprite.crop((x, y, x + self.size[0], y + self.size[1]))

    def _terrain(self) -> Image.Image:
        """Paint all fixed cells between ``_low`` and ``_high``."""
        scale = self.scale
        columns = np.arange(self._low[0], self._high[0])
        rows = np.arange(self._low[1], self._high[1])[::-1]

        # Cells [rows, columns], and which of them belong to the world or lie above it
        height, width = self.scene.terrain.shape
        in_width = (columns >= 0) & (columns < width)
        in_height = (rows >= 0) & (rows < height)
        terrain = np.zeros((len(rows), len(columns)), np.int8)
        own_cells = np.ix_(height - 1 - rows[in_height], columns[in_width])
        terrain[np.ix_(in_height, in_width)] = self.scene.terrain[own_cells]
        solid = terrain != Cell.EMPTY
        inside = (rows >= 0)[:, None] & in_width

        # Colours, a square of pixels each
        colours = np.where(inside[..., None], np.array(SKY, np.uint8), np.array((226, 230, 236), np.uint8))
        colours[solid] = (74, 80, 92)
        pixels = np.repeat(np.repeat(colours, scale, axis=0), scale, axis=1)

        # The grid: a line at the left and at the bottom of every cell, stronger every ten. Lines closer than eight
        # pixels would be a haze.
        square = np.ones((scale, scale), bool)
        solid_pixels = np.kron(solid, square)
        inside_pixels = np.kron(inside, square)
        lines = [((slice(None), k * scale), number) for k, number in enumerate(columns.tolist())]
        lines += [(((k + 1) * scale - 1, slice(None)), number) for k, number in enumerate(rows.tolist())]
        for line, number in lines:
            is_strong = number % 10 == 0
            if scale >= 8 or is_strong:
                pixels[line][inside_pixels[line]] = (214, 220, 229) if is_strong else GRID
            if scale >= 8:
                pixels[line][solid_pixels[line]] = (86, 93, 106)

        # The surface of the terrain: a dark rim on cells that have none beside them
        rim = max(1, round(scale / 15))
        near = slice(0, rim)
        far = slice(scale - rim, scale)
        whole = slice(0, scale)
        padded = np.pad(solid, 1, mode="edge")
        tiles = pixels.reshape(len(rows), scale, len(columns), scale, 3).swapaxes(1, 2)  # a view, cell by cell
        for neighbour, tile_rows, tile_columns in (
            (padded[:-2, 1:-1], near, whole),
            (padded[2:, 1:-1], far, whole),
            (padded[1:-1, :-2], whole, near),
            (padded[1:-1, 2:], whole, far),
        ):
            for row, column in np.argwhere(solid & ~neighbour):
                tiles[row, column, tile_rows, tile_columns] = (40, 44, 52)

        # The distance in voxels below the world's bottom, every ten voxels
        image = Image.fromarray(pixels)
        size = max(9, round(scale * 0.42))
        if scale * BELOW >= size + 2:
            draw = ImageDraw.Draw(image)
            y = (int(rows[0]) + 1) * scale + round(scale * BELOW / 2)
            for k, column in enumerate(columns.tolist()):
                if column % 10 == 0 and 0 <= column <= self.scene.width:
                    draw.text((k * scale, y), str(column), fill=(120, 128, 140), font=font(size), anchor="mm")
        return image


class Painter:
    """Paints frames of one environment of a rollout.

    Args:
        size: width and height of the picture in pixels.
        voxels: voxels from bottom to top; None fits the robot.
    """

    def __init__(self, rollout: Rollout, env: int, size: tuple[int, int], voxels: float | None = None) -> None:
        self.rollout = rollout
        self.env = env
        scene = rollout.scene(env)
        scale = _fitting_scale(scene, size, voxels)
        self._canvas = Canvas(scene, size, scale)
        view = (size[0] / scale, size[1] / scale)
        self.camera = np.rint(camera_path(scene, rollout.positions[:, env], view) * scale).astype(int)

        # Terrain is painted once, unless the robot is flung too far away for that.
        low = self.camera.min(axis=0)
        high = self.camera.max(axis=0)
        if np.prod((high - low + size).astype(float)) < 5e7:
            self._canvas.cover(low, high)

    def frame(self, frame: int) -> Image.Image:
        """Paint one frame of the rollout."""
        return self._canvas.picture(self.rollout.positions[frame, self.env], self.camera[frame])


def seen(shapes: np.ndarray, size: tuple[int, int], rim: int = 0) -> np.ndarray:
    """Return a mask of the shapes ``[k, corners, 2]`` that may overlap the picture plus a margin ``rim``, bool ``[k]``.

    Bridges are longer than it.
    """
    return ((shapes.max(axis=1) >= -rim) & (shapes.min(axis=1) <= np.array(size) + rim)).all(axis=1)


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return a picture's ``size`` as integers; RolloutError: too small, too large or no size."""
    try:
        width, height = map(operator.index, size)
    except (TypeError, ValueError):
        raise RolloutError(f"A size is (width, height) in whole pixels, got {size!r}.") from None
    if not (16 <= width <= 8192 and 16 <= height <= 8192):
        raise RolloutError(f"Width and height must lie in 16 to 8192 pixels, got {width} x {height}.")
    return width, height


class LiveView:
    """Paints environments of a running simulation.

    Args:
        sim: a :class:`warpvox.Simulation`; bodies other than those of ``worlds``, its world_numbers, need another view.
        size: width and height of a picture in pixels.

    Raises:
        RolloutError: a size that cannot be drawn.
    """

    def __init__(self, sim: Any, size: tuple[int, int] = (640, 360)) -> None:
        self.size = check_size(size)
        self.worlds = sim.world_numbers
        scenes, self._positions = scenes_of(sim)
        canvases = [Canvas(scene, self.size, _fitting_scale(scene, self.size)) for scene in scenes]
        self._canvases = [canvases[design] for design in sim.design_index.tolist()]

    def pictures(self, envs: Sequence[int] | None = None) -> list[np.ndarray]:
        """Paint the present state of all environments, or of ``envs``: uint8 ``[height, width, 3]`` each."""
        positions = self._positions().cpu().numpy()
        pictures = []
        for env in range(len(positions)) if envs is None else envs:
            canvas = self._canvases[env]
            points = positions[env]
            view = (self.size[0] / canvas.scale, self.size[1] / canvas.scale)
            corner = np.rint(camera_path(canvas.scene, points[None], view)[0] * canvas.scale).astype(int)
            pictures.append(np.array(canvas.picture(points, corner)))
        return pictures
