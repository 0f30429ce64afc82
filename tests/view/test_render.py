"""Pictures: right size, the robot in view in its colours, files whole or not at all."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image, ImageSequence

from warpvox.errors import RolloutError
from warpvox.palette import LEVELS, colour_index, palette
from warpvox.types import MATERIALS, Cell
from warpvox.view import render
from warpvox.view.painter import camera_path
from warpvox.view.rollout import Rollout


def count_near(picture: np.ndarray, colours: np.ndarray, within: int = 8) -> int:
    """Pixels that have nearly one of the colours."""
    distance = np.abs(picture.reshape(-1, 1, 3).astype(int) - colours.reshape(1, -1, 3)).max(axis=-1)
    return int((distance.min(axis=1) < within).sum())


def actuator_colours() -> np.ndarray:
    return np.concatenate([palette()[LEVELS * (cell - 1) : LEVELS * cell] for cell in (Cell.H_ACT, Cell.V_ACT)]).astype(
        int
    )


@given(width=st.integers(64, 400), height=st.integers(64, 300), frame=st.integers(-12, 11))
@pytest.mark.slow
def test_any_size_and_frame(rollouts, width: int, height: int, frame: int) -> None:
    picture = render.draw_frame(rollouts(12, 1, ends=(9,)), frame, size=(width, height), hud=False)
    assert picture.shape == (height, width, 3)
    assert picture.dtype == np.uint8
    assert count_near(picture, actuator_colours()) > 0.001 * width * height


def test_robot_stays_in_view(rollouts: Callable[..., Rollout]) -> None:
    rollout = rollouts(60, 1)
    rollout.positions[30:] += np.float32([1.5, 0.9])  # a leap that no smoothing follows
    view = (16.0, 9.0)
    corner = camera_path(rollout.scene(0), rollout.positions[:, 0], view)
    points = rollout.positions[:, 0, rollout.scene(0).robot_points] * 10
    assert (points.min(axis=1) >= corner).all()
    assert (points.max(axis=1) <= corner + view).all()


def test_camera_moves_smoothly(rollouts: Callable[..., Rollout]) -> None:
    rollout = rollouts(200, 1, noise=0.03)
    path = camera_path(rollout.scene(0), rollout.positions[:, 0], (16.0, 9.0))
    assert np.abs(np.diff(path, 2, axis=0)).max() < 0.05


def test_colours_mean_what_they_mean() -> None:
    table = palette()
    cells = np.array([int(cell) for cell in MATERIALS])
    for stretch, stop in ((0.6, 0), (1.0, 1), (1.6, 2), (0.1, 0), (9.0, 2)):
        shown = table[colour_index(cells, np.full(len(cells), stretch))]
        for cell, colour in zip(cells, shown, strict=True):
            expected = MATERIALS[cell].colours[stop if cell in (Cell.H_ACT, Cell.V_ACT) else 1]
            assert tuple(colour) == expected


def test_pictures_are_the_same_every_time(rollouts: Callable[..., Rollout]) -> None:
    rollout = rollouts(10, 2)
    film = render.Film(rollout, 1)
    for frame in (7, 3, 7):
        np.testing.assert_array_equal(render.draw_frame(rollout, frame, 1), film.array(frame))


def test_nothing_moving_in_view_is_no_error(rollouts: Callable[..., Rollout]) -> None:
    rollout = rollouts(5, 1)
    first, second = rollout.scene(0).moving
    rollout.positions[:, 0, second.first_point :] += 300
    assert count_near(render.draw_frame(rollout, 2), actuator_colours()) > 500
    rollout.positions[:, 0, : first.num_points] -= 500
    rollout.metadata["task"] = "two\nlines"
    render.draw_frame(rollout, 2, size=(320, 180))


@pytest.mark.parametrize("count", [1, 2, 3, 7, 16])
def test_tiles_show_every_environment(rollouts: Callable[..., Rollout], count: int) -> None:
    film = render.Film(rollouts(4, 16, designs=3), range(count), size=(800, 450))
    picture = film.array(2)
    assert picture.shape == (450, 800, 3)
    columns, (wide, high) = film._columns, film._tile
    band = film._band
    for number in range(count):
        row, column = divmod(number, columns)
        x, y = column * (wide + render.MARGIN), band + row * (high + render.MARGIN)
        assert count_near(picture[y : y + high, x : x + wide], actuator_colours()) > 20


def test_gif(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    calls = []
    path = render.write_gif(
        rollouts(41, 2, ends=(20, 30)),
        tmp_path / "film.gif",
        envs=[0, 1],
        size=(320, 180),
        on_frame=lambda done, total: calls.append((done, total)),
    )
    with Image.open(path) as film:
        assert film.size == (320, 180)
        assert film.info["loop"] == 0
        pictures = []
        for number in range(film.n_frames):
            film.seek(number)
            assert film.info["duration"] == 40
            pictures.append(np.asarray(film.convert("RGB")))
    assert len(pictures) == 16  # 31 frames at 50 a second, shown at 25
    assert calls == [(k + 1, 16) for k in range(16)]
    assert all(count_near(picture, actuator_colours(), 14) > 300 for picture in pictures)
    assert any((a != b).any() for a, b in pairwise(pictures))


def test_more_pictures_than_viewers_hold_are_refused_with_what_to_do(rollouts, tmp_path: Path) -> None:
    with pytest.raises(RolloutError):
        render.write_gif(rollouts(20_020, 1), tmp_path / "film.gif")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("every", "fps", "played"),
    [(1, 25, 4.0), (5, 25, 0.8), (10**6, 25, 0.04), (1, 30, 3.99), (1, 8, 3.96), (2, 45, 2.0)],
)
def test_time_runs_as_fast_as_asked_for(rollouts, tmp_path: Path, every: int, fps: float, played: float) -> None:
    path = render.write_gif(rollouts(200, 1), tmp_path / "film.gif", size=(64, 36), fps=fps, every=every)
    with Image.open(path) as film:
        assert sum(frame.info["duration"] for frame in ImageSequence.Iterator(film)) == round(1000 * played)


def test_png_and_filmstrip(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(30, 2, ends=(20,))
    with Image.open(render.write_png(rollout, tmp_path / "one.png", frame=5, size=(200, 120))) as picture:
        assert picture.size == (200, 120)
    strip = np.asarray(Image.open(render.write_filmstrip(rollout, tmp_path / "strip.png", 5, size=(1000, 160))))
    assert strip.shape == (160, 1000, 3)
    each = (1000 - 4 * render.MARGIN) // 5
    for number in range(5):
        x = number * (each + render.MARGIN)
        assert count_near(strip[:, x : x + each], actuator_colours()) > 200
    path = render.write_filmstrip(rollout, tmp_path / "strip.png", frames=[0, -1], size=(600, 160))
    with Image.open(path) as picture:
        assert picture.size == (600, 160)
    with Image.open(render.write_filmstrip(rollout, tmp_path / "strip.png", size=(16, 16))) as picture:
        assert picture.size == (16, 16)  # the smallest that may be asked for has room for all six


def test_mp4(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    from imageio_ffmpeg import count_frames_and_secs

    path = render.write_mp4(rollouts(21, 1), tmp_path / "film.mp4", size=(320, 180))
    frames, seconds = count_frames_and_secs(str(path))
    assert frames == 21
    assert seconds == pytest.approx(0.42, abs=0.05)
    with pytest.raises(RolloutError):
        render.write_mp4(rollouts(5, 1), tmp_path / "odd.mp4", size=(321, 180))


@pytest.mark.parametrize("name", ["a:b.mp4", "-films/a.mp4"])
def test_a_path_is_neither_protocol_nor_option_of_ffmpeg(rollouts, tmp_path: Path, monkeypatch, name: str) -> None:
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.chdir(tmp_path)
    assert render.write_mp4(rollouts(2, 1), name, size=(32, 32)).stat().st_size


@pytest.mark.parametrize(
    "call",
    [
        lambda r, p: render.draw_frame(r, 5),
        lambda r, p: render.draw_frame(r, 0, 2),
        lambda r, p: render.draw_frame(r, 0, size=(5, 5)),
        lambda r, p: render.draw_frame(r, 0, size=(float("inf"), 20)),
        lambda r, p: render.draw_frame(r, 0, voxels=0),
        lambda r, p: render.write_gif(r, p, every=0),
        lambda r, p: render.write_gif(r, p, fps=0),
        lambda r, p: render.write_gif(r, p, start=4, stop=4),
        lambda r, p: render.write_filmstrip(r, p.with_suffix(".png"), 0),
        lambda r, p: render.write_filmstrip(r, p.with_suffix(".png"), [0] * 9, size=(20, 20)),
    ],
)
def test_wrong_requests_get_one_clear_line(rollouts, tmp_path: Path, call) -> None:
    with pytest.raises(RolloutError):
        call(rollouts(5, 2), tmp_path / "film.gif")
    assert not list(tmp_path.iterdir())


def pictures(count: int, size: tuple[int, int] = (64, 40)) -> Iterator[Image.Image]:
    """Pictures that differ by a pixel, some not at all."""
    palette = np.random.default_rng(0).integers(0, 256, 255 * 3).astype(np.uint8).tobytes()
    for number in range(count):
        values = np.zeros((size[1], size[0]), np.uint8)
        values[: number % 40, (3 * number) % 64] = number % 255
        if number % 50 in (20, 21, 22):
            values[:] = 7
        picture = Image.fromarray(values)
        picture.putpalette(palette)
        yield picture


@pytest.mark.parametrize(("part", "pause"), [(1, 40), (2, 40), (16, 40), (1000, 40), (1000, 300_000)])
def test_a_gif_in_parts_shows_every_picture_at_its_time(part: int, pause: int) -> None:
    file = BytesIO()
    render.write_pictures(file, pictures(100), pause, 64 * 40 * part)
    image = Image.open(BytesIO(file.getvalue()))
    assert image.info["loop"] == 0
    wanted, shown = [np.array(picture.convert("RGB")) for picture in pictures(100)], 0
    for number in range(image.n_frames):
        image.seek(number)
        for _ in range(round(image.info["duration"] / pause)):  # equal pictures are stored once, and shown longer
            assert np.array_equal(np.array(image.convert("RGB")), wanted[shown])
            shown += 1
    assert shown == 100
    assert file.getvalue().count(b"NETSCAPE2.0") == 1


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="peaks of memory are those of Linux")
def test_the_memory_of_a_gif_does_not_grow_with_its_length(tmp_path: Path) -> None:
    """In a process of its own: Pillow's pictures lie where Python's own counting does not see them."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from pathlib import Path\nfrom test_render import pictures\n"
        "from warpvox.view.render import write_pictures\n"
        "def status(name): return next(int(line.split()[1]) for line in open('/proc/self/status')"
        " if line.startswith(name))\n"
        "def write(count):\n"
        "    with open(sys.argv[2], 'wb') as file: write_pictures(file, pictures(count, (640, 360)), 40)\n"
        "write(80)\nPath('/proc/self/clear_refs').write_text('5')\nbefore = status('VmRSS')\nwrite(1200)\n"
        "print((status('VmHWM') - before) / 1024)\n"
    )
    line = [sys.executable, "-c", code, str(Path(__file__).parent), str(tmp_path / "film.gif")]
    done = subprocess.run(line, capture_output=True, text=True, check=True)
    whole = 1200 * 640 * 360 / 2**20
    assert float(done.stdout) < whole / 4
