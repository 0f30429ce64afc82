"""What a notebook shows: everything says what it is in a line, and has a picture of itself."""

import base64
import html
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import warpvox as wv
from warpvox.design import example_design, sample_design
from warpvox.envs.registry import get_task
from warpvox.envs.worlds import task_world
from warpvox.palette import body_svg, cell_colour
from warpvox.view.body_picture import draw_bodies


@pytest.fixture(scope="module")
def run() -> wv.TrainedRun:
    ppo = {"steps": 8, "epochs": 1, "hidden": [8]}
    options = {"device": "cpu", "threads": 1, "eval_interval": 1, "max_iterations": 3}
    return wv.train("Walker-v0", "mini", num_envs=4, ppo=ppo, folder=None, progress=False, **options)


def test_a_rollout_is_its_player_and_everything_says_in_a_line_what_it_is(run: wv.TrainedRun) -> None:
    env = wv.make_vec("Walker-v0", "mini", 20, device="cpu", threads=1)
    rollout = wv.record(env, run.policy, 3)
    for thing in (env, rollout, run, wv.zoo("Walker-v0")):
        assert "\n" not in repr(thing)
        assert len(repr(thing)) < 150
    (page,) = re.fullmatch(r'<iframe srcdoc="([^"]*)"[^>]*></iframe>', rollout._repr_html_()).groups()
    assert html.unescape(page).startswith("<!doctype html>")


def test_a_run_is_its_curve(run: wv.TrainedRun) -> None:
    (data,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', run._repr_html_())
    assert b'<path class="curve' in base64.b64decode(data)
    table = wv.evaluate(run, "Walker-v0", "mini", episodes=1)
    assert f"<td>{table[0].mean:.3f}</td>" in table._repr_html_()


def test_bodies_and_worlds_are_drawings() -> None:
    body = wv.example_design("walker")
    world = task_world(get_task("Climber-v0"), body)
    robot = wv.zoo("Walker-v0")
    for thing, cells in (world, world.grid()), (robot, robot.body):
        assert thing._repr_html_().count("h1v1h-1z") == np.count_nonzero(cells)
    assert wv.draw_bodies([body, body]).size[0] > wv.draw_bodies([body]).size[0]
    with pytest.raises(wv.DesignError):
        wv.draw_bodies(body)  # one body, not a list of one
    for bodies, captions in (([], ()), ([body], [["a"], ["b"]])):
        with pytest.raises(wv.DesignError):
            wv.draw_bodies(bodies, captions)
    with pytest.raises(wv.ConfigError):
        wv.draw_bodies([body], columns=0)


@pytest.mark.parametrize("seed", range(5))
def test_svg_paints_every_cell_once_in_its_colour(seed: int) -> None:
    body = sample_design((4, 6), seed)
    painted = np.zeros_like(body)
    root = ET.fromstring(body_svg(body))
    assert root.get("stroke") == "#1c1e24"  # or equal cells beside each other would be one bar
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
