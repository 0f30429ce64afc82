"""One environment of a rollout as pictures: camera, terrain, voxels.

Everything that does not move is painted once, as a wide sprite from which each frame is cut: a whole number
of pixels to a voxel and a camera that moves by whole pixels keep terrain and grid sharp without any
filtering. Only the boxes around moving objects are painted larger and scaled down, which is what makes their
edges smooth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from warpvox.palette import colour_index, palette
from warpvox.rollout import Rollout
from warpvox.scene import Scene
from warpvox.types import VOXEL, Cell

__all__ = ["INK", "Painter", "camera_path", "font"]

SKY, GRID, GRID_STRONG = (249, 250, 252), (233, 237, 242), (214, 220, 229)
BEYOND, BEYOND_INK = (226, 230, 236), (120, 128, 140)
GROUND, GROUND_LINE, GROUND_EDGE = (74, 80, 92), (86, 93, 106), (40, 44, 52)
INK, PALE_INK = (28, 30, 36), (98, 100, 108)
SMOOTH = 4  # pictures of moving objects are painted this many times larger
VIEW = 12.0  # voxels from the bottom to the top of a picture, if the robot is not higher than half of that
BELOW = 1.25  # voxels that the camera shows below and beside the world
ANCHOR = 0.42  # height of the robot's centre in the picture, if the world's bottom does not come into view
STEADY = (9.0, 22.0)  # frames over which the camera's motion is smoothed, along x and along y


def font(size: int) -> ImageFont.FreeTypeFont:
    """The font that comes with Pillow: no files, no surprises."""
    return ImageFont.load_default(size)


def camera_path(rollout: Rollout, env: int, view: tuple[float, float]) -> np.ndarray:
    """Lower left corner of the picture in voxels for every frame, float64 ``[T + 1, 2]``.

    The camera follows the robot's centre, smoothed over past and future alike, so that it neither shakes nor
    lags. It shows no more of what lies beyond the world than it must to keep the robot in view.

    Args:
        rollout, env: what to follow.
        view: width and height of the picture in voxels.
    """
    scene = rollout.scene(env)
    points = np.clip(rollout.positions[:, env, scene.robot_points] / np.float32(VOXEL), -1e4, 1e4)
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


def _smooth(values: np.ndarray, width: float) -> np.ndarray:
    reach = int(3 * width)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    padded = np.pad(values, reach, mode="edge")
    return np.convolve(padded, weights / weights.sum(), mode="valid")


@dataclass(frozen=True)
class Mesh:
    """What of a moving object is painted: cells, and sides once each with what they separate."""

    corners: np.ndarray  # [cells, 4]
    cells: np.ndarray  # [cells]
    columns: np.ndarray  # [cells] where the object's cells lie among all that move
    points: np.ndarray  # [k]
    inner: np.ndarray  # [m, 2] sides between two cells
    inner_dark: np.ndarray  # bool [m]: both cells are dark
    outer: np.ndarray  # [n, 2] sides of one cell


class Painter:
    """Paints frames of one environment.

    Args:
        rollout: what was recorded.
        env: which environment.
        size: width and height of the picture in pixels.
        voxels: voxels from bottom to top; None fits the robot.
    """

    def __init__(self, rollout: Rollout, env: int, size: tuple[int, int], voxels: float | None = None) -> None:
        self.rollout, self.env, self.size = rollout, rollout.check_env(env), size
        self.scene = rollout.scene(env)
        start = rollout.positions[0, env, self.scene.robot_points] / VOXEL
        tall = float(np.ptp(start[:, 1]))
        self.scale = max(3, round(size[1] / (voxels or max(VIEW, 2.4 * tall))))
        view = (size[0] / self.scale, size[1] / self.scale)
        self.camera = np.rint(camera_path(rollout, env, view) * self.scale).astype(int)
        self._meshes = [_mesh(self.scene, number) for number in range(len(self.scene.moving))]
        self._colours = [tuple(colour) for colour in palette().tolist()]

    def frame(self, frame: int) -> Image.Image:
        """The picture of a frame."""
        left, bottom = self.camera[frame]
        image = self._backdrop(left, bottom)
        points = self.rollout.positions[frame, self.env] * np.float32(self.scale / VOXEL)
        points = np.stack([points[:, 0] - left, self.size[1] + bottom - points[:, 1]], axis=1)
        colours = colour_index(self.scene.cells, self.rollout.stretch(frame, self.env))
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
        for quad, colour in zip(xy[mesh.corners].reshape(-1, 8).tolist(), colours.tolist(), strict=True):
            draw.polygon(quad, fill=self._colours[colour])
        thin, thick = self._pens
        for side, dark in zip(xy[mesh.inner].reshape(-1, 4).tolist(), mesh.inner_dark.tolist(), strict=True):
            draw.line(side, fill=PALE_INK if dark else INK, width=thin)
        for side in xy[mesh.outer].reshape(-1, 4).tolist():
            draw.line(side, fill=INK, width=thick)
        radius = (thick - 1) / 2  # round joints: lines alone would leave notches at corners
        for x, y in xy[np.unique(mesh.outer)].tolist():
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=INK)
        image.paste(large.reduce(SMOOTH), box[:2])

    @cached_property
    def _pens(self) -> tuple[int, int]:
        """Widths of inner and outer sides in enlarged pixels, a constant share of a voxel."""
        return tuple(max(1, round(SMOOTH * self.scale * share)) for share in (1 / 30, 1 / 16))

    # ------------------------------------------------------------ what stands still

    def _backdrop(self, left: int, bottom: int) -> Image.Image:
        sprite, origin, top = self._sprite
        x, y = left - origin, top - bottom - self.size[1]
        return sprite.crop((x, y, x + self.size[0], y + self.size[1]))

    @cached_property
    def _sprite(self) -> tuple[Image.Image, int, int]:
        """All that the camera will see of the world, with the pixels of its left and of its top."""
        scale = self.scale
        low = self.camera.min(axis=0) // scale
        high = -(-(self.camera.max(axis=0) + self.size) // scale)
        columns, rows = np.arange(low[0], high[0]), np.arange(low[1], high[1])[::-1]
        terrain = _window(self.scene.terrain, rows, columns)
        inside_x = (columns >= 0) & (columns < self.scene.width)
        inside = (rows >= 0)[:, None] & inside_x[None, :]
        colours = np.where(inside[..., None], np.uint8(SKY), np.uint8(BEYOND))
        colours[terrain != Cell.EMPTY] = GROUND
        pixels = np.repeat(np.repeat(colours, scale, axis=0), scale, axis=1)
        _rule(pixels, terrain, inside, rows, columns, scale)
        _edge(pixels, terrain, scale)
        image = Image.fromarray(pixels)
        _number(image, rows, columns, scale, self.scene.width)
        return image, int(low[0]) * scale, int(high[1]) * scale


def _mesh(scene: Scene, number: int) -> Mesh:
    obj = scene.moving[number]
    begin = sum(len(other.cells) for other in scene.moving[:number])
    sides = np.stack([obj.corners, np.roll(obj.corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    owners = np.repeat(np.arange(len(obj.cells)), 4)
    _, first, index, counts = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    dark = np.isin(obj.cells, (int(Cell.RIGID), int(Cell.FIXED)))
    all_dark = np.ones(len(first), bool)
    np.logical_and.at(all_dark, index.reshape(-1), dark[owners])
    return Mesh(
        corners=obj.corners,
        cells=obj.cells,
        columns=np.arange(begin, begin + len(obj.cells)),
        points=np.arange(obj.first_point, obj.first_point + obj.num_points),
        inner=sides[first[counts > 1]],
        inner_dark=all_dark[counts > 1],
        outer=sides[first[counts == 1]],
    )


def _window(terrain: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Cells of the terrain at rows (counted upward) and columns that may lie outside of the world."""
    height, width = terrain.shape
    out = np.zeros((len(rows), len(columns)), np.int8)
    r, c = (rows >= 0) & (rows < height), (columns >= 0) & (columns < width)
    out[np.ix_(r, c)] = terrain[np.ix_(height - 1 - rows[r], columns[c])]
    return out


def _rule(
    pixels: np.ndarray,
    terrain: np.ndarray,
    inside: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    scale: int,
) -> None:
    """Draw the grid: a line at the left and at the bottom of every cell of the world, stronger every ten."""
    ground = np.repeat(np.repeat(terrain != Cell.EMPTY, scale, axis=0), scale, axis=1)
    seen = np.repeat(np.repeat(inside, scale, axis=0), scale, axis=1)
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
    bare = {
        "top": solid & ~padded[:-2, 1:-1],
        "bottom": solid & ~padded[2:, 1:-1],
        "left": solid & ~padded[1:-1, :-2],
        "right": solid & ~padded[1:-1, 2:],
    }
    for side, cells in bare.items():
        for r, c in np.argwhere(cells) * scale:
            rows = slice(r, r + width) if side == "top" else slice(r, r + scale)
            rows = slice(r + scale - width, r + scale) if side == "bottom" else rows
            cols = slice(c, c + width) if side == "left" else slice(c, c + scale)
            cols = slice(c + scale - width, c + scale) if side == "right" else cols
            pixels[rows, cols] = GROUND_EDGE


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
