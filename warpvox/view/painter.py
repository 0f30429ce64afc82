"""Scenes as pictures: camera, terrain, voxels; of a rollout, or of anything that gives positions.

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

SKY, GRID, GRID_STRONG = (249, 250, 252), (233, 237, 242), (214, 220, 229)
BEYOND, BEYOND_INK = (226, 230, 236), (120, 128, 140)
GROUND, GROUND_LINE, GROUND_EDGE = (74, 80, 92), (86, 93, 106), (40, 44, 52)
INK, PALE_INK = (28, 30, 36), (98, 100, 108)
LARGEST_SPRITE = 5e7  # pixels of terrain that are painted beforehand
MAX_PIXELS = 8192
SMOOTH = 4  # pictures of moving objects are painted this many times larger
VIEW = 12.0  # voxels from the bottom to the top of a picture, if the robot is not higher than half of that
BELOW = 1.25  # voxels that the camera shows below and beside the world
ANCHOR = 0.42  # height of the robot's centre in the picture, if the world's bottom does not come into view
STEADY = (9.0, 22.0)  # frames over which the camera's motion is smoothed, along x and along y


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Load the font that comes with Pillow: no files, no surprises."""
    return ImageFont.load_default(size)


PNG_SUFFIXES = (".png",)
"""Suffixes of what :func:`save_png` writes."""


def save_png(image: Image.Image, path: str | os.PathLike[str], optimize: bool = False) -> Path:
    """Write a picture as PNG, whole or not at all; returns the path."""
    with atomic_path(path, follow=True) as temporary:
        image.save(temporary, "PNG", optimize=optimize)
    return Path(path)


def camera_path(scene: Scene, positions: np.ndarray, view: tuple[float, float]) -> np.ndarray:
    """Lower left corner of the picture in voxels for every frame, float64 ``[T, 2]``.

    The camera follows the robot's centre, smoothed over past and future alike, so that it neither shakes nor
    lags. It shows no more of what lies beyond the world than it must to keep the robot in view.

    Args:
        positions: its points, ``[T, P, 2]`` in simulator units.
        view: width and height of the picture in voxels.
    """
    points = np.clip(positions[:, scene.robot_points] / np.float32(VOXEL), -1e4, 1e4)
    low, high = points.min(axis=1).astype(np.float64), points.max(axis=1).astype(np.float64)
    centre = points.mean(axis=1, dtype=np.float64)
    size, anchor = np.array(view), np.array([0.5, ANCHOR])
    corner = centre - size * anchor
    world = np.array([scene.width, scene.height], dtype=np.float64)
    room = world + 2 * BELOW - size
    middle = (world - size) / 2
    corner[:, 0] = np.clip(corner[:, 0], -BELOW, room[0] - BELOW) if room[0] > 0 else middle[0]
    # Upwards there is always air: only the bottom of the world is a border.
    corner[:, 1] = np.maximum(corner[:, 1], -BELOW)
    corner = np.stack([_smooth(corner[:, k], STEADY[k]) for k in (0, 1)], axis=1)
    # The robot as a whole stays in the picture, if there is room for it.
    least, most = high + 0.5 - size, low - 0.5
    return np.where(least <= most, np.clip(corner, least, most), centre - size / 2)


def fitting_scale(scene: Scene, size: tuple[int, int], voxels: float | None = None) -> int:
    """Pixels to a voxel: ``voxels`` from bottom to top, or (None) as many as suit the robots as they begin."""
    rows = [(obj.y + obj.grid.shape[0] - obj.places[:, 0]) for obj in scene.robots]  # upper edges of cells
    tall = max(row.max() for row in rows) - min(row.min() for row in rows) + 1
    return max(3, round(size[1] / (voxels or max(VIEW, 2.4 * tall))))


def _smooth(values: np.ndarray, width: float) -> np.ndarray:
    reach = int(3 * width)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    padded = np.pad(values, reach, mode="edge")
    return np.convolve(padded, weights / weights.sum(), mode="valid")


@dataclass(frozen=True)
class Mesh:
    """The painted parts of a moving object: cells, and sides once each with what they separate."""

    corners: np.ndarray  # [cells, 4]
    columns: np.ndarray  # [cells] where the object's cells lie among all that move
    points: np.ndarray  # [k]
    inner: np.ndarray  # [m, 2] sides between two cells
    inner_dark: np.ndarray  # bool [m]: both cells are dark
    outer: np.ndarray  # [n, 2] sides of one cell


class Canvas:
    """Paints one scene, wherever its points and the camera are.

    Args:
        size: width and height of the picture in pixels.
        scale: pixels to a voxel.
    """

    def __init__(self, scene: Scene, size: tuple[int, int], scale: int) -> None:
        self.scene, self.size, self.scale = scene, size, scale
        self._meshes = [_mesh(scene, number) for number in range(len(scene.moving))]
        self._colours = [tuple(colour) for colour in palette().tolist()]
        self._low = self._high = np.zeros(2, int)
        self._sprite: Image.Image | None = None

    def picture(self, positions: np.ndarray, corner: tuple[int, int]) -> Image.Image:
        """The scene with its points at ``positions`` ``[P, 2]``, seen from a camera.

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
        """Paint an object onto the picture through an enlarged copy of the box around it."""
        own = points[mesh.points]
        low = np.maximum(np.floor(own.min(axis=0)) - 2, 0).astype(int)
        high = np.minimum(np.ceil(own.max(axis=0)) + 3, self.size).astype(int)
        if (low >= high).any():
            return
        box = (*low.tolist(), *high.tolist())
        patch = image.crop(box)
        large = patch.resize((patch.width * SMOOTH, patch.height * SMOOTH), Image.Resampling.NEAREST)
        draw = ImageDraw.Draw(large)
        xy = (points - low) * SMOOTH
        thin, thick = (max(1, round(SMOOTH * self.scale * share)) for share in (1 / 30, 1 / 16))
        quads = seen(xy[mesh.corners], large.size)
        for quad, colour in zip(xy[mesh.corners[quads]].reshape(-1, 8).tolist(), colours[quads].tolist(), strict=True):
            draw.polygon(quad, fill=self._colours[colour])
        inner = seen(xy[mesh.inner], large.size, thin)
        inks = mesh.inner_dark[inner].tolist()
        for side, dark in zip(xy[mesh.inner[inner]].reshape(-1, 4).tolist(), inks, strict=True):
            draw.line(side, fill=PALE_INK if dark else INK, width=thin)
        outer = mesh.outer[seen(xy[mesh.outer], large.size, thick)]
        for side in xy[outer].reshape(-1, 4).tolist():
            draw.line(side, fill=INK, width=thick)
        radius = (thick - 1) / 2  # round joints: lines alone would leave notches at corners
        for x, y in xy[np.unique(outer)].tolist():
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=INK)
        image.paste(large.reduce(SMOOTH), box[:2])

    def cover(self, low: np.ndarray, high: np.ndarray) -> Image.Image:
        """Paint beforehand what cameras with corners from ``low`` to ``high`` (pixels, ``[2]`` each) will see."""
        low = np.asarray(low) // self.scale
        high = -(-(np.asarray(high) + self.size) // self.scale)
        self._low, self._high = low, high
        self._sprite = self._terrain()
        return self._sprite

    def _backdrop(self, left: int, bottom: int) -> Image.Image:
        corner = np.array([left, bottom])
        seen = self._low * self.scale <= corner, corner + self.size <= self._high * self.scale
        sprite = self._sprite
        if sprite is None or not np.all(seen):
            sprite = self.cover(corner - np.array(self.size) // 2, corner + np.array(self.size) // 2)
        x, y = left - self._low[0] * self.scale, self._high[1] * self.scale - bottom - self.size[1]
        return sprite.crop((x, y, x + self.size[0], y + self.size[1]))

    def _terrain(self) -> Image.Image:
        """All cells of the world from ``_low`` to ``_high`` that never move."""
        scale = self.scale
        columns, rows = np.arange(self._low[0], self._high[0]), np.arange(self._low[1], self._high[1])[::-1]
        height, width = self.scene.terrain.shape
        inside_x, terrain = (columns >= 0) & (columns < width), np.zeros((len(rows), len(columns)), np.int8)
        seen = (rows >= 0) & (rows < height)
        terrain[np.ix_(seen, inside_x)] = self.scene.terrain[np.ix_(height - 1 - rows[seen], columns[inside_x])]
        inside = (rows >= 0)[:, None] & inside_x[None, :]
        colours = np.where(inside[..., None], np.array(SKY, np.uint8), np.array(BEYOND, np.uint8))
        colours[terrain != Cell.EMPTY] = GROUND
        pixels = np.repeat(np.repeat(colours, scale, axis=0), scale, axis=1)
        _rule(pixels, terrain, inside, rows, columns, scale)
        _edge(pixels, terrain, scale)
        image = Image.fromarray(pixels)
        _number(image, rows, columns, scale, self.scene.width)
        return image


class Painter:
    """Paints frames of one environment of a rollout.

    Args:
        size: width and height of the picture in pixels.
        voxels: voxels from bottom to top; None fits the robot.
    """

    def __init__(self, rollout: Rollout, env: int, size: tuple[int, int], voxels: float | None = None) -> None:
        self.rollout, self.env = rollout, env
        scene = rollout.scene(env)
        scale = fitting_scale(scene, size, voxels)
        self._canvas = Canvas(scene, size, scale)
        view = (size[0] / scale, size[1] / scale)
        self.camera = np.rint(camera_path(scene, rollout.positions[:, env], view) * scale).astype(int)
        low, high = self.camera.min(axis=0), self.camera.max(axis=0)
        if np.prod((high - low + size).astype(float)) < LARGEST_SPRITE:  # a robot may be flung away
            self._canvas.cover(low, high)

    def frame(self, frame: int) -> Image.Image:
        """The picture of a frame."""
        return self._canvas.picture(self.rollout.positions[frame, self.env], self.camera[frame])


def _mesh(scene: Scene, number: int) -> Mesh:
    obj = scene.moving[number]
    begin = sum(len(other.cells) for other in scene.moving[:number])
    sides = np.stack([obj.corners, np.roll(obj.corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    owners = np.repeat(np.arange(len(obj.cells)), 4)
    ends = np.sort(sides, axis=1)
    _, first, index, counts = np.unique(ends, axis=0, return_index=True, return_inverse=True, return_counts=True)
    pale = ~np.isin(obj.cells, (int(Cell.RIGID), int(Cell.FIXED)))
    all_dark = np.bincount(index.reshape(-1), pale[owners]) == 0
    return Mesh(
        corners=obj.corners,
        columns=np.arange(begin, begin + len(obj.cells)),
        points=np.arange(obj.first_point, obj.first_point + obj.num_points),
        inner=sides[first[counts > 1]],
        inner_dark=all_dark[counts > 1],
        outer=sides[first[counts == 1]],
    )


def seen(shapes: np.ndarray, size: tuple[int, int], rim: int = 0) -> np.ndarray:
    """bool ``[k]``: of which shapes ``[k, corners, 2]`` some part, with a rim, may lie in the picture.

    Bridges are longer than it.
    """
    return ((shapes.max(axis=1) >= -rim) & (shapes.min(axis=1) <= np.array(size) + rim)).all(axis=1)


def _rule(
    pixels: np.ndarray, terrain: np.ndarray, inside: np.ndarray, rows: np.ndarray, columns: np.ndarray, scale: int
) -> None:
    """Draw the grid: a line at the left and at the bottom of every cell of the world, stronger every ten."""
    ground, seen = (np.kron(cells, np.ones((scale, scale), bool)) for cells in (terrain != Cell.EMPTY, inside))
    fine = scale < 8  # lines closer than that would be a haze

    def line(where: tuple, strong: bool) -> None:
        if not fine or strong:
            pixels[where][seen[where]] = GRID_STRONG if strong else GRID
        if not fine:
            pixels[where][ground[where]] = GROUND_LINE

    for k, column in enumerate(columns.tolist()):
        line((slice(None), k * scale), column % 10 == 0)
    for k, row in enumerate(rows.tolist()):
        line(((k + 1) * scale - 1, slice(None)), row % 10 == 0)


def _edge(pixels: np.ndarray, terrain: np.ndarray, scale: int) -> None:
    """Draw the surface of the terrain: a dark rim on cells that have none beside them."""
    width = max(1, round(scale / 15))
    solid = terrain != Cell.EMPTY
    padded = np.pad(solid, 1, mode="edge")
    near, far, whole = slice(0, width), slice(scale - width, scale), slice(0, scale)
    tiles = pixels.reshape(terrain.shape[0], scale, terrain.shape[1], scale, 3).swapaxes(1, 2)  # a view, cell by cell
    for beside, rows, columns in (
        (padded[:-2, 1:-1], near, whole),
        (padded[2:, 1:-1], far, whole),
        (padded[1:-1, :-2], whole, near),
        (padded[1:-1, 2:], whole, far),
    ):
        for r, c in np.argwhere(solid & ~beside):
            tiles[r, c, rows, columns] = GROUND_EDGE


def _number(image: Image.Image, rows: np.ndarray, columns: np.ndarray, scale: int, width: int) -> None:
    """Write the distance in voxels below the world's bottom, every ten voxels."""
    draw = ImageDraw.Draw(image)
    size = max(9, round(scale * 0.42))
    if scale * BELOW < size + 2:
        return
    y = (int(rows[0]) + 1) * scale + round(scale * BELOW / 2)
    for k, column in enumerate(columns.tolist()):
        if column % 10 == 0 and 0 <= column <= width:
            draw.text((k * scale, y), str(column), fill=BEYOND_INK, font=font(size), anchor="mm")


def check_size(size: tuple[int, int]) -> tuple[int, int]:
    """``size`` of a picture as integers; RolloutError: it cannot be drawn."""
    try:
        width, height = map(operator.index, size)
    except (TypeError, ValueError):
        raise RolloutError(f"A size is (width, height) in whole pixels, got {size!r}.") from None
    if not (16 <= width <= MAX_PIXELS and 16 <= height <= MAX_PIXELS):
        raise RolloutError(f"Width and height must lie in 16 to {MAX_PIXELS} pixels, got {width} x {height}.")
    return width, height


class LiveView:
    """Looks at environments of a simulation; each picture depends on the present state alone.

    Args:
        sim: a :class:`warpvox.Simulation`; bodies other than those of ``worlds``, its world_numbers, need another view.
        size: width and height of a picture in pixels.

    Raises:
        RolloutError: a size that cannot be drawn.
    """

    def __init__(self, sim: Any, size: tuple[int, int] = (640, 360)) -> None:
        self.size, self.worlds = check_size(size), sim.world_numbers
        scenes, self._positions = scenes_of(sim)
        canvases = [Canvas(scene, self.size, fitting_scale(scene, self.size)) for scene in scenes]
        self._canvases = [canvases[design] for design in sim.design_index.tolist()]

    def pictures(self, envs: Sequence[int] | None = None) -> list[np.ndarray]:
        """A picture of each environment, or of those numbers, uint8 ``[height, width, 3]``."""
        positions = self._positions().cpu().numpy()
        pictures = []
        for env in range(len(positions)) if envs is None else envs:
            canvas, points = self._canvases[env], positions[env]
            view = (self.size[0] / canvas.scale, self.size[1] / canvas.scale)
            corner = np.rint(camera_path(canvas.scene, points[None], view)[0] * canvas.scale).astype(int)
            pictures.append(np.array(canvas.picture(points, corner)))
        return pictures
