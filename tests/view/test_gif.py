"""GIFs that are written in parts: every picture at its time, in a memory that does not grow with their number."""

import subprocess
import sys
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from warpvox.view import gif


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
        "from pathlib import Path\nfrom test_gif import pictures\n"
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
