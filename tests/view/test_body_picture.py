"""Bodies drawn cell by cell."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from warpvox.design import example_design, sample_design
from warpvox.view.body_picture import draw_bodies
from warpvox.view.palette import body_svg, cell_colour


@pytest.mark.parametrize("seed", range(5))
def test_svg_paints_every_cell_once_in_its_colour(seed: int) -> None:
    body = sample_design((4, 6), seed)
    painted = np.zeros_like(body)
    root = ET.fromstring(body_svg(body, title="a"))
    for path in root.findall("path"):
        kind = int(path.get("class")[1:])
        assert path.get("fill") == "#{:02x}{:02x}{:02x}".format(*cell_colour(kind))
        for x, y in re.findall(r"M(\d+) (\d+)h1v1h-1z", path.get("d")):
            assert painted[int(y), int(x)] == 0
            painted[int(y), int(x)] = kind
    assert np.array_equal(painted, body)


def test_a_sheet_shows_every_body_with_its_colours() -> None:
    bodies = [example_design("walker")] + [sample_design((5, 7), seed) for seed in range(6)]
    cell, gap, title = 20, 20, 22 + 10
    image = np.asarray(draw_bodies(bodies, [["1.0", "second line"]] * 7, "Walker-v0", cell))
    for number, body in enumerate(bodies):
        left = gap + number % 5 * (7 * cell + gap)
        top = gap + title + number // 5 * (5 * cell + 2 * 22 + gap)
        for (row, column), kind in np.ndenumerate(body):
            pixel = image[top + row * cell + cell // 2, left + column * cell + cell // 2]
            assert tuple(pixel) == (cell_colour(int(kind)) if kind else (255, 255, 255))
