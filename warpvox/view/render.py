"""Pictures, film strips and videos of rollouts, made on the CPU by Pillow, without a display or OpenGL."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from importlib.util import find_spec
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from PIL import Image, ImageDraw

from warpvox.checks import check_integer, is_integer
from warpvox.errors import RolloutError
from warpvox.io.text import escaped
from warpvox.io.writing import atomic_path, check_suffix
from warpvox.types import FRAME_SECONDS, VOXEL
from warpvox.view.painter import INK, PNG_SUFFIXES, Painter, check_size, font, save_png
from warpvox.view.rollout import Rollout

MARGIN = 2
"""Pixels between pictures of several environments."""


class Film:
    """Pictures of a rollout by frame: one environment, or several in a grid of tiles.

    Args:
        rollout: what was recorded.
        envs: an environment or several; None: all, but 16 at most.
        size: width and height in pixels.
        hud: whether to write task, time and return.
        voxels: voxels from the bottom to the top of an environment's picture; None fits the robot.

    Raises:
        RolloutError: no such environment, or a size that cannot be drawn.
    """

    def __init__(
        self,
        rollout: Rollout,
        envs: int | Sequence[int] | None = None,
        size: tuple[int, int] = (640, 360),
        hud: bool = True,
        voxels: float | None = None,
    ) -> None:
        self.rollout = rollout
        self.hud = hud
        self.size = check_size(size)
        self.envs = rollout.check_envs(envs)[: 16 if envs is None else None]
        if voxels is not None and not 1 <= voxels <= 1000:
            raise RolloutError(f"voxels must be a number from 1 to 1000, got {voxels!r}.")
        self._band = max(20, self.size[1] // 22) if len(self.envs) > 1 and hud else 0
        self._columns, self._tile = _layout(len(self.envs), (self.size[0], self.size[1] - self._band))
        self._painters = [Painter(rollout, env, self._tile, voxels) for env in self.envs]

    def image(self, frame: int) -> Image.Image:
        """Paint a frame; negative numbers count from the end.

        Raises:
            RolloutError: no such frame.
        """
        frame = self.rollout.check_frame(frame)
        if len(self.envs) == 1:
            picture = self._painters[0].frame(frame)
            if self.hud:
                self._write_hud(picture, frame)
            return picture
        picture = Image.new("RGB", self.size, "white")
        for number, painter in enumerate(self._painters):
            row, column = divmod(number, self._columns)
            tile = painter.frame(frame)
            if self.hud:
                self._write_label(tile, painter.env, frame)
            place = (column * (self._tile[0] + MARGIN), self._band + row * (self._tile[1] + MARGIN))
            picture.paste(tile, place)
        if self.hud:
            self._write_band(picture, frame)
        return picture

    def frames(
        self, numbers: Sequence[int], on_frame: Callable[[int, int], None] | None = None
    ) -> Iterator[Image.Image]:
        """Yield pictures of the given frames.

        Args:
            on_frame: called with the number of pictures that were taken and of all there are.
        """
        for done, number in enumerate(numbers, 1):
            yield self.image(number)
            if on_frame:
                on_frame(done, len(numbers))

    def array(self, frame: int) -> np.ndarray:
        """Paint a frame as an array, uint8 ``[height, width, 3]``."""
        return np.array(self.image(frame))

    def _write_hud(self, picture: Image.Image, frame: int) -> None:
        """Draw task, time and return on a light panel in the upper left corner."""
        unit = max(8, round(min(self.size[1] / 22, self.size[0] / 34)))
        large = font(unit)
        small = font(round(unit * 0.86))
        draw = ImageDraw.Draw(picture, "RGBA")

        # The panel, as wide as the title or the numbers
        title = escaped(self.rollout.title)
        width = max(draw.textlength(title, font=large), unit * 9.2) + unit * 1.6
        gap = unit // 2
        draw.rounded_rectangle((gap, gap, gap + width, gap + unit * 3.3), radius=gap, fill=(255, 255, 255, 216))

        # Right-aligned numbers stand still while they count.
        x = gap + unit * 0.8
        y = gap + unit * 0.95
        draw.text((x, y), title, fill=INK, font=large, anchor="lm")
        y += unit * 1.4
        gained = self.rollout.returns[frame, self.envs[0]]
        draw.text((x + unit * 3.2, y), f"{frame * FRAME_SECONDS:.2f} s", INK, small, "rm")
        draw.text((x + unit * 4.2, y), "return", (112, 118, 130), small, "lm")
        draw.text((x + unit * 9.6, y), f"{gained:.2f}", INK, small, "rm")

    def _write_label(self, tile: Image.Image, env: int, frame: int) -> None:
        """Draw the environment's name and return on its tile."""
        unit = max(8, round(self._tile[1] / 14))
        letters = font(unit)
        draw = ImageDraw.Draw(tile, "RGBA")
        text = f"{escaped(self.rollout.names[env])}:  {self.rollout.returns[frame, env]:.2f}"
        if "names" in self.rollout.metadata:  # compared with each other: their returns stand there from the beginning
            text += f" of {self.rollout.returns[-1, env]:.2f}"
        wide = draw.textlength(text, font=letters)
        draw.rounded_rectangle((3, 3, wide + unit + 3, unit * 1.5 + 3), radius=unit // 3, fill=(255, 255, 255, 216))
        draw.text((3 + unit / 2, 3 + unit * 0.76), text, INK, letters, "lm")

    def _write_band(self, picture: Image.Image, frame: int) -> None:
        """Draw task, time and mean return above the tiles."""
        unit = round(self._band * 0.62)
        letters = font(unit)
        middle = self._band / 2
        mean = self.rollout.returns[frame, self.envs].mean()
        draw = ImageDraw.Draw(picture)
        draw.text((unit / 2, middle), escaped(self.rollout.title), INK, letters, "lm")
        right = f"{frame * FRAME_SECONDS:.2f} s    mean return {mean:.2f}"
        draw.text((self.size[0] - unit / 2, middle), right, INK, letters, "rm")


def draw_frame(
    rollout: Rollout,
    frame: int,
    env: int | Sequence[int] | None = 0,
    size: tuple[int, int] = (640, 360),
    hud: bool = True,
    voxels: float | None = None,
) -> np.ndarray:
    """Paint one frame of a rollout as uint8 ``[height, width, 3]``; arguments as in :class:`Film`."""
    return Film(rollout, env, size, hud, voxels).array(frame)


def write_png(
    rollout: Rollout,
    path: str | os.PathLike[str],
    frame: int = -1,
    envs: int | Sequence[int] | None = 0,
    size: tuple[int, int] = (640, 360),
    hud: bool = True,
    voxels: float | None = None,
) -> Path:
    """Write one frame of a rollout as PNG; return the path. Arguments as in :class:`Film`.

    Raises:
        RolloutError: another suffix than .png, or as for :class:`Film`.
    """
    check_suffix("The file of a picture", path, PNG_SUFFIXES, RolloutError)
    return save_png(Film(rollout, envs, size, hud, voxels).image(frame), path)


def write_filmstrip(
    rollout: Rollout,
    path: str | os.PathLike[str],
    frames: int | Sequence[int] = 6,
    env: int = 0,
    size: tuple[int, int] = (1440, 200),
    voxels: float | None = None,
) -> Path:
    """Write frames of an episode side by side, with their times, as one PNG; return the path.

    Args:
        rollout, env: what to show.
        path: where to; written whole or not at all.
        frames: 1 to 64 frame numbers, or how many, spread evenly from the reset to the end of the episode.
        size: of the whole strip in pixels.
        voxels: voxels from bottom to top; None fits the robot.

    Raises:
        RolloutError: another suffix than .png, no such frame or environment, or a size that cannot be drawn.
    """
    check_suffix("The file of a strip", path, PNG_SUFFIXES, RolloutError)
    width, height = check_size(size)
    rollout.check_envs([env])

    # Frames
    count = frames if is_integer(frames) else len(frames)
    if not 1 <= count <= 64:
        raise RolloutError(f"A strip shows 1 to 64 frames, got {count}.")
    if is_integer(frames):
        last = int(rollout.lengths[env])
        frames = [int(frame) for frame in np.unique(np.rint(np.linspace(0, last, frames)))]
    chosen = [rollout.check_frame(frame) for frame in frames]

    each = (width + MARGIN) // len(chosen) - MARGIN
    if each < 1:
        raise RolloutError(f"A strip {width} pixels wide has no room for {len(chosen)} frames.")

    # The robot fills a good part of a picture, and what it stands on shows.
    tall = float(np.ptp(rollout.positions[0, env, rollout.scene(env).robot_points, 1])) / VOXEL
    film = Film(rollout, env, (max(each, 16), height), hud=False, voxels=voxels or max(6.5, 2.1 * tall))

    strip = Image.new("RGB", (width, height), "white")
    letters = font(max(9, height // 14))
    for number, tile in enumerate(film.frames(chosen)):
        at = (each - height // 24, height // 24)
        ImageDraw.Draw(tile).text(at, f"{chosen[number] * FRAME_SECONDS:.1f} s", INK, letters, "rt")
        strip.paste(tile, (number * (each + MARGIN), 0))
    return save_png(strip, path)


def write_gif(
    rollout: Rollout,
    path: str | os.PathLike[str],
    envs: int | Sequence[int] | None = 0,
    size: tuple[int, int] = (640, 360),
    fps: float = 25,
    start: int = 0,
    stop: int | None = None,
    hud: bool = True,
    voxels: float | None = None,
    on_frame: Callable[[int, int], None] | None = None,
    every: int = 1,
) -> Path:
    """Write a rollout as an animated GIF that loops.

    Args:
        rollout, envs, size, hud, voxels: as for :class:`Film`.
        path: where to; written whole or not at all.
        fps: pictures per second, 1 to 50, to whole hundredths of a second a picture; time runs as in the simulation,
            whatever it is.
        start, stop: frames of the rollout, as in a slice; None: until the last episode ends.
        on_frame: called with the number of pictures drawn and of all there are.
        every: time runs so many times as fast.

    Raises:
        RolloutError: another suffix than .gif, no such environment, a size, rate or range that cannot be drawn, or
            more pictures than viewers of GIFs can hold.
    """
    check_suffix("The file of a GIF", path, (".gif",), RolloutError)
    _check_rate(fps, 50)
    pause = round(100 / fps) * 10  # a GIF counts in hundredths of a second
    frames = _frames(rollout, 1000 / pause, start, stop, every)
    most = 10_000  # viewers keep all pictures in memory
    if len(frames) > most:
        least = math.ceil(len(frames) * every / most)
        raise RolloutError(
            f"A GIF of {len(frames):,} pictures is more than viewers can hold ({most:,}); show time"
            f" {least} times as fast (every={least}), or write an MP4, which has no such limit."
        )

    # One palette for all, from up to six pictures of the film
    film = Film(rollout, envs, size, hud, voxels)
    places = np.linspace(0, len(frames) - 1, min(6, len(frames))).astype(int)
    colours, table = _gif_palette([film.image(frames[place]) for place in places])

    def pictures() -> Iterator[Image.Image]:
        for picture in film.frames(frames, on_frame):
            red, green, blue = np.moveaxis(np.asarray(picture) >> 3, -1, 0).astype(np.uint16)
            reduced = Image.fromarray(table[red << 10 | green << 5 | blue])
            reduced.putpalette(colours)
            yield reduced

    with atomic_path(path, follow=True) as temporary, open(temporary, "wb") as file:
        write_pictures(file, pictures(), pause)
    return Path(path)


def write_pictures(file: BinaryIO, pictures: Iterable[Image.Image], pause: int, part_bytes: int = 1 << 24) -> None:
    """Write a sequence of pictures as an animated GIF that loops, one picture in memory at a time.

    Pillow keeps all pictures of an animation until the last is there. Here it encodes some at a time; a GIF is a header
    with one palette and a row of blocks, so that the blocks of each part follow those of the part before.

    Args:
        pictures: one or more of mode P, of one size and with one palette.
        pause: milliseconds from one to the next.
        part_bytes: bytes of the pictures that are encoded together.
    """
    pictures = iter(pictures)
    loops = True
    for first in pictures:
        # Pillow makes one of equal pictures that follow each other, which can stay for 655 seconds.
        count = max(1, min(part_bytes // (first.width * first.height), 655_350 // pause))
        part = [first, *islice(pictures, count - 1)]

        # The pictures as a GIF of their own
        buffer = BytesIO()
        options = {"loop": 0} if loops else {}
        options |= dict(save_all=True, append_images=part[1:], duration=pause, optimize=False, disposal=1)
        first.save(buffer, "GIF", **options)
        data = buffer.getvalue()

        # Its header is 13 bytes, then the palette if there is one; only the first part keeps it.
        end = 13
        packed = data[10]
        if packed & 0x80:
            end += 3 << ((packed & 7) + 1)
        # The last byte would end the file.
        file.write(data[:-1] if loops else data[end:-1])
        loops = False
    file.write(b";")


def write_mp4(
    rollout: Rollout,
    path: str | os.PathLike[str],
    envs: int | Sequence[int] | None = 0,
    size: tuple[int, int] = (1280, 720),
    fps: float = 50,
    start: int = 0,
    stop: int | None = None,
    hud: bool = True,
    voxels: float | None = None,
    on_frame: Callable[[int, int], None] | None = None,
    every: int = 1,
) -> Path:
    """Write a rollout as H.264 video; arguments as in :func:`write_gif`. Needs the extra ``view`` (imageio-ffmpeg).

    Raises:
        RolloutError: another suffix than .mp4, or as for write_gif and :func:`check_mp4`.
    """
    check_suffix("The file of an MP4", path, (".mp4",), RolloutError)
    check_mp4(size)
    import imageio_ffmpeg

    _check_rate(fps, 240)
    frames = _frames(rollout, fps, start, stop, every)
    film = Film(rollout, envs, size, hud, voxels)
    options: dict[str, Any] = dict(fps=float(fps), quality=None, output_params=["-crf", "15"], macro_block_size=2)
    with atomic_path(path, follow=True) as temporary:  # absolute, or ffmpeg might take it for an option or a URL
        encoder = imageio_ffmpeg.write_frames(
            temporary, film.size, codec="libx264", ffmpeg_log_level="quiet", **options
        )
        try:
            with closing(encoder):
                encoder.send(None)
                for picture in film.frames(frames, on_frame):
                    encoder.send(np.array(picture))
            written, _ = imageio_ffmpeg.count_frames_and_secs(temporary)  # it does not report a failure
        except (OSError, RuntimeError):
            written = None
        if written != len(frames):
            raise RolloutError(f"{path} cannot be written; is its disk full?")
    return Path(path)


def check_mp4(size: tuple[int, int]) -> None:
    """Raise RolloutError unless imageio-ffmpeg is installed and the size is even, as H.264 needs."""
    if find_spec("imageio_ffmpeg") is None:
        raise RolloutError(
            "MP4 needs imageio-ffmpeg, which is not installed: pip install 'warpvox[view]', or write a GIF."
        )
    width, height = check_size(size)
    if width % 2 or height % 2:
        raise RolloutError(f"The width and the height of an MP4 must be even, got {width} x {height}.")


def _check_rate(fps: float, most: int) -> None:
    if not 1 <= fps <= most:
        raise RolloutError(f"fps must lie in 1 to {most}, got {fps!r}.")


def _frames(rollout: Rollout, fps: float, start: int, stop: int | None, every: int) -> list[int]:
    """Choose frames so that playback runs in simulated time, or ``every`` times as fast."""
    check_integer("every", every, 1, error=RolloutError)
    if stop is None:
        stop = int(rollout.lengths.max()) + 1
    begin, end, _ = slice(start, stop).indices(rollout.num_frames)
    if begin >= end:
        raise RolloutError(f"There are no frames from {start} to {stop}; the rollout has {rollout.num_frames}.")
    count = max(1, round((end - begin) * FRAME_SECONDS * fps / every))
    return [min(end - 1, begin + round(k * every / (fps * FRAME_SECONDS))) for k in range(count)]


def _gif_palette(sample: Sequence[Image.Image]) -> tuple[bytes, np.ndarray]:
    """Compute one palette for all frames, and its entry for each 15-bit colour, uint8 [32768].

    One palette means that a pixel that does not change keeps its number, which is what makes the file small;
    a table is many times faster than asking for the nearest entry pixel by pixel.
    """
    # One of a GIF's 256 colours is left for "as before", which makes its frames small.
    most = 255
    sheet = Image.fromarray(np.concatenate([np.asarray(image) for image in sample]))
    reduced = sheet.quantize(most, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    colours = np.array(reduced.getpalette("RGB"), np.uint8).reshape(-1, 3)[:most]

    # The nearest entry, in parts, as all distances at once would take much memory
    cells = np.indices((32, 32, 32)).reshape(3, -1).T[:, None] * 8 + 4
    near = []
    for part in np.array_split(cells, 16):
        distance = ((part.astype(np.float32) - colours) ** 2).sum(-1)
        near.append(distance.argmin(-1))
    table = np.concatenate(near).astype(np.uint8)

    # Of the colours that share a cell the most frequent one owns it, so that large areas keep their exact
    # colour.
    for entry in np.argsort(reduced.histogram()[: len(colours)], kind="stable"):
        red, green, blue = (colours[entry] >> 3).tolist()
        table[red << 10 | green << 5 | blue] = entry
    return colours.tobytes(), table


def _layout(count: int, size: tuple[int, int]) -> tuple[int, tuple[int, int]]:
    """Choose columns and tile size so that the whole picture is close to 16:9."""

    def tile(columns: int) -> tuple[int, int]:
        rows = math.ceil(count / columns)
        width = (size[0] - MARGIN * (columns - 1)) // columns
        height = (size[1] - MARGIN * (rows - 1)) // rows
        return max(1, width), max(1, height)

    best = max(range(1, count + 1), key=lambda columns: min(tile(columns)[0] / 16, tile(columns)[1] / 9))
    return best, tile(best)
