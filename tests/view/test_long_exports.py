"""Exports of long rollouts: in pieces, within limits, with an estimate of what is to come."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
import subprocess
import sys
import time
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from warpvox.cli.exports import Estimate
from warpvox.errors import RolloutError
from warpvox.view import gif, usd
from warpvox.view.player import page_of
from warpvox.view.render import write_gif, write_mp4
from warpvox.view.rollout import Rollout
from warpvox.view.scene import Scene, SceneObject
from warpvox.view.usd import write_usd

SIDE = 4


def long_rollout(steps: int, envs: int = 1) -> Rollout:
    """A body of cells that drifts and breathes, made without a simulation."""
    grid = np.full((SIDE, SIDE), 3, np.int8)
    across = SIDE + 1
    corners = [
        [row * across + column, row * across + column + 1, (row + 1) * across + column + 1, (row + 1) * across + column]
        for row in range(SIDE)
        for column in range(SIDE)
    ]
    body = SceneObject("robot", grid, 1, 1, 0, across**2, np.array(corners, np.int32))
    ground = SceneObject("ground", np.full((1, 30), 5, np.int8), 0, 0, 0, 0, np.zeros((0, 4), np.int32))
    place = np.stack(np.meshgrid(np.arange(across), np.arange(across, 0, -1)), -1).reshape(-1, 2) * 0.1
    phase = np.arange(steps + 1, dtype=np.float32)[:, None, None, None]
    positions = place * (1 + 0.05 * np.sin(phase / 7)) + np.array([0.002, 0]) * (phase % 400)
    rewards = np.sin(np.arange(steps, dtype=float))[:, None].repeat(envs, 1)
    over = np.zeros((steps, envs), bool)
    return Rollout(
        positions=np.broadcast_to(positions, (steps + 1, envs, across**2, 2)),
        design_index=np.zeros(envs, np.int32),
        scenes=(Scene(30, 10, (body, ground)),),
        actions=np.ones((steps, envs, SIDE * SIDE), np.float32),
        rewards=rewards,
        terminated=over,
        truncated=over,
        metadata={},
    )


# ----------------------------------------------------------------------------------------------------------- GIF


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


@pytest.mark.parametrize("part", [1, 2, 16, 1000])
def test_a_gif_in_parts_shows_every_picture_at_its_time(part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gif, "PART_BYTES", 64 * 40 * part)
    file = BytesIO()
    gif.write_pictures(file, pictures(100), 40)
    image = Image.open(BytesIO(file.getvalue()))
    assert image.info["loop"] == 0
    wanted, shown = [np.array(picture.convert("RGB")) for picture in pictures(100)], 0
    for number in range(image.n_frames):
        image.seek(number)
        for _ in range(round(image.info["duration"] / 40)):  # equal pictures are stored once, and shown longer
            assert np.array_equal(np.array(image.convert("RGB")), wanted[shown])
            shown += 1
    assert shown == 100
    assert file.getvalue().count(b"NETSCAPE2.0") == 1


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="peaks of memory are those of Linux")
def test_the_memory_of_a_gif_does_not_grow_with_its_length(tmp_path: Path) -> None:
    """In a process of its own: Pillow's pictures lie where Python's own counting does not see them."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "from pathlib import Path\nfrom test_long_exports import pictures\n"
        "from warpvox.view.gif import write_pictures\n"
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


def test_half_a_million_frames_are_refused_as_gif_with_what_to_do(tmp_path: Path) -> None:
    rollout = long_rollout(500_000)
    began = time.process_time()
    with pytest.raises(RolloutError, match=r"250,000 pictures .*\(10,000\).*every=25\), or write an MP4"):
        write_gif(rollout, tmp_path / "film.gif")
    assert time.process_time() - began < 5
    assert not list(tmp_path.iterdir())


def test_time_runs_as_fast_as_asked_for(tmp_path: Path) -> None:
    rollout, counts = long_rollout(199), []
    for every in (1, 5, 10**6):
        write_gif(
            rollout, tmp_path / "film.gif", size=(64, 36), every=every, on_frame=lambda *done: counts.append(done)
        )
        with Image.open(tmp_path / "film.gif") as image:
            assert image.n_frames == counts[-1][1]
    assert {total for _, total in counts} == {100, 20, 1}
    for write in (write_gif, write_mp4):
        with pytest.raises(RolloutError, match="every must be an integer"):
            write(rollout, tmp_path / "film.mp4", every=0)


# ----------------------------------------------------------------------------------------------------------- page


def contents(page: str) -> tuple[dict, bytes]:
    """What a page carries: its numbers and its unpacked arrays."""
    meta = json.loads(re.search(r'<script[^>]*id="meta"[^>]*>(.*?)</script>', page, re.DOTALL)[1])
    data = re.search(r'<script[^>]*id="data"[^>]*>(.*?)</script>', page, re.DOTALL)[1]
    return meta, zlib.decompress(base64.b64decode(data), -zlib.MAX_WBITS)


@pytest.mark.parametrize("every", [1, 3, 10])
def test_a_page_shows_every_nth_frame(every: int) -> None:
    rollout = long_rollout(100, envs=2)
    meta, data = contents(page_of(rollout, every=every))
    steps = 100 // every
    assert (meta["frames"], meta["dt"]) == (100 // every + 1, pytest.approx(0.02 * every))
    points = 2 * (SIDE + 1) ** 2
    rewards = np.frombuffer(data, "<f4", 2 * steps, offset=8 * points).reshape(2, steps)
    wanted = rollout.rewards[: steps * every].reshape(steps, every, 2).sum(1).T
    assert np.allclose(rewards, wanted, atol=1e-6)
    start = np.frombuffer(data, "<i4", 2 * points).reshape(points, 2)
    low, high = np.frombuffer(data, np.uint8, offset=8 * points + 8 * steps).reshape(2, points, 2, steps)
    moves = (low.astype(np.int32) | high.astype(np.int32) << 8).astype(np.int16).astype(np.int64)
    ends = (start + moves.sum(-1)) / meta["scale"]
    assert np.allclose(ends, rollout.positions[steps * every].reshape(-1, 2), atol=0.6 / meta["scale"])


def test_a_page_takes_little_more_than_it_holds() -> None:
    rollout = long_rollout(4000, envs=8)
    tracemalloc.start()
    page_of(rollout)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.5 * rollout.positions.nbytes


def test_a_page_that_no_browser_can_hold_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warpvox.view.player.MOST_NUMBERS", 10_000)
    rollout = long_rollout(999)
    with pytest.raises(RolloutError, match=r"1,000 frames is more than a browser can hold; .*every=5"):
        page_of(rollout)
    page_of(rollout, every=5)


# ------------------------------------------------------------------------------------------------------------ USD


def test_a_stage_that_does_not_fit_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rollout = long_rollout(2000)
    monkeypatch.setattr(usd, "free_memory", lambda device: 1_000_000)
    with pytest.raises(RolloutError, match=r"2,001 frames needs about .* GiB are free; .*\(every=2\)"):
        write_usd(rollout, tmp_path / "long.usd")
    assert not list(tmp_path.iterdir())
    write_usd(rollout, tmp_path / "long.usd", stride=2)


# -------------------------------------------------------------------------------------------------------- estimate


def test_a_long_film_is_announced(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 1.0, 2.5, 2.6])
    monkeypatch.setattr("warpvox.cli.exports.time.monotonic", lambda: next(clock))
    shown = StringIO()
    tell = Estimate("rollout.mp4", Console(file=shown, width=200))
    for number in (100, 250, 260):
        tell(number, 250_000)
    assert shown.getvalue() == "rollout.mp4: 250,000 pictures, about 42 minutes more; every=N makes fewer\n"


def test_a_short_film_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([0.0, 3.0])
    monkeypatch.setattr("warpvox.cli.exports.time.monotonic", lambda: next(clock))
    shown = StringIO()
    Estimate("rollout.gif", Console(file=shown, width=200))(100, 200)
    assert shown.getvalue() == ""


def test_the_key_reaches_every_format(warpvox: Callable, tmp_path: Path) -> None:
    rollout = dataclasses.replace(long_rollout(40), metadata={"task": "long"})
    rollout.save(tmp_path / "long.npz")
    words = ["export", "rollout=long.npz", "format=[gif,html,usd]", "size=[64,36]"]
    assert warpvox(*words, "every=4").code == 0
    (folder,) = tmp_path.glob("outputs/export/*/*")
    with Image.open(folder / "rollout.gif") as image:
        assert image.n_frames == 5
    assert contents((folder / "rollout.html").read_text())[0]["frames"] == 11
    assert warpvox(*words, "every=0").code == 2
