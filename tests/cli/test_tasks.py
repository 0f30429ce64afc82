"""``warpvox tasks``: the table, a task in detail, and the pictures of its world."""

import io
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from warpvox.design import example_design
from warpvox.envs.about import UNITS, about_of
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.vec_env import make_vec
from warpvox.envs.worlds import task_world
from warpvox.palette import cell_colour
from warpvox.types import MATERIALS
from warpvox.view.body_picture import AIR, draw_world, scene_of_world
from warpvox.view.cell_text import LOWER, UPPER, print_world
from warpvox.view.painter import BELOW
from warpvox.world import World

ROW = re.compile(r"│\s+(\d+):(\d+) │ (.+?) +│ (\w+) +│ (.+?) +│")
SOME = [task if k % 3 == 0 else pytest.param(task, marks=pytest.mark.slow) for k, task in enumerate(task_ids())]
ALL = pytest.mark.parametrize("task", SOME)


def test_the_table_has_every_task(warpvox: Callable) -> None:
    table = warpvox("tasks").out
    for name in task_ids():
        task = get_task(name)
        row = next(line for line in table.splitlines() if f" {name} " in line)
        for word in (task.difficulty, str(task.max_episode_steps), task.section, "2 n"):
            assert f" {word} " in row
    assert "14 + 2 n" in table


@ALL
@pytest.mark.parametrize("rules", ["evogym", "paper"])
def test_a_task_in_detail_says_where_everything_lies(warpvox: Callable, task: str, rules: str) -> None:
    outcome = warpvox("tasks", task, f"rules={rules}", "design=hopper")
    env = make_vec(task, ["hopper"], device="cpu", rules=rules, threads=1)
    for word in (env.spec.section, env.spec.summary, f"{env.max_episode_steps} control steps at most"):
        assert word in outcome.out
    rows = ROW.findall(outcome.out)
    places = [(int(start), int(stop)) for start, stop, *_ in rows]
    assert places == [(place.start, place.stop) for place in env.obs_columns[0].values()]
    assert [row[2] for row in rows] == [term.formula for term in env.spec.observations]
    assert {row[3] for row in rows} <= set(UNITS)
    for term in (*env.spec.rewards, *env.spec.terminations):
        assert about_of(term.function), f"{term.function.__name__} does not say what it is"
        assert term.formula in outcome.out
    assert "{" not in outcome.out


def test_a_task_names_the_examples_that_fit_it(warpvox: Callable) -> None:
    assert "examples that fit: lifter (made for it), walker" in warpvox("tasks", "Lifter-v0").out
    line = next(line for line in warpvox("tasks", "Climber-v0").out.splitlines() if line.startswith("designs"))
    assert "climber (made for it)" in line
    assert "lifter" not in line  # wider than the shaft


def test_tasks_of_ones_own_are_shown(warpvox: Callable, tmp_path: Path) -> None:
    text = (
        "from dataclasses import replace\nfrom warpvox.envs.registry import get_task\nfrom warpvox.envs.spec import *\n"
        "def speed(before, after, name): return after.velocity(name)[:, 0]\n"
        "MINE = replace(get_task('Walker-v0'), id='Mine-v0', rewards=(rewards(speed, weight=0.5),))\n"
    )
    Path("mine.py").write_text(text)
    detail = warpvox("tasks", "mine.py:MINE").out
    assert detail.startswith("Mine-v0")
    assert "reward   0.5 speed(name=robot)" in detail  # a term that says nothing about itself


def test_each_robot_of_a_task_is_shown_with_its_own_body(warpvox: Callable) -> None:
    Path("mine.py").write_text(
        "from dataclasses import replace\nfrom warpvox.envs.registry import get_task\n"
        "from warpvox.envs.worlds import block\nground = (block('ground', 30, 1),)\n"
        "TWO = replace(get_task('Walker-v0'), id='Two-v0', objects=ground, partners={'mate': (20, 1)})\n"
    )
    shown = warpvox("tasks", "mine.py:TWO", "design={robot:[[3,3]],mate:[[4],[1]]}").out
    assert "a robot folds into itself: -3" in shown
    assert "6 points of robot: [[3, 3]], 6 points of mate: [[4], [1]]" in " ".join(shown.split())
    top, bottom = shown.splitlines()[-3:-1]
    assert (top[20], bottom[1:3], bottom[20]) == ("V", "HH", "R")


def screen(world: World, width: int = 200, colour: bool = True) -> Console:
    """A console that remembers what it shows."""
    console = Console(
        file=io.StringIO(),
        force_terminal=colour,
        color_system="truecolor" if colour else None,
        width=width,
        record=True,
    )
    print_world(world, console)
    return console


@ALL
def test_the_world_in_letters(task: str) -> None:
    world = task_world(get_task(task), example_design("walker"))
    lines = screen(world, colour=False).export_text().splitlines()[2:]
    kinds = {".": 0, "R": 1, "S": 2, "H": 3, "V": 4, "F": 5}
    shown: list[list[int]] = []
    for line in lines:
        again = re.fullmatch(r"  \((\d+) more rows like these\)", line)
        shown += [shown[-1]] * int(again[1]) if again else [[kinds[glyph] for glyph in line]]
    assert np.array_equal(shown, world.grid())


@ALL
def test_the_world_in_half_blocks(task: str) -> None:
    world = task_world(get_task(task), example_design("walker"))
    console = screen(world)
    kinds = {cell_colour(cell): int(cell) for cell in MATERIALS}
    rows: list[list[list[int]]] = [[]]
    skipped = 0
    for segment in console._record_buffer:
        text, style = segment.text, segment.style
        again = re.fullmatch(r"  \((\d+) more rows like these\)", text)
        if again:
            skipped = int(again[1])
            continue
        for glyph in text:
            if glyph == "\n":
                rows.append([])
                if skipped:
                    rows[-1:] = [rows[-2 - (not rows[-2])] for _ in range(skipped)] + [[]]
                    skipped = 0
                continue
            front, back = (
                kinds[tuple(c.triplet)] if c else 0 for c in ((style.color, style.bgcolor) if style else (0, 0))
            )
            rows[-1].append({UPPER: [front, back], LOWER: [0, front], " ": [0, 0]}.get(glyph, [0, 0]))
    cells = [row for row in rows if len(row) == world.width][-((world.height + 1) // 2) :]
    shown = np.array(cells).transpose(0, 2, 1).reshape(-1, world.width)
    assert np.array_equal(shown[len(shown) - world.height :], world.grid())


def test_wide_worlds_are_folded() -> None:
    world = task_world(get_task("Walker-v0"), example_design("walker"))
    assert max(len(line) for line in screen(world, width=41).export_text().splitlines()) <= 60  # the legend is longer
    lines = [line for line in screen(world, 41, colour=False).export_text().splitlines() if set(line) == {"F"}]
    assert [len(line) for line in lines] == [40, 40, 20]


@ALL
def test_the_picture_shows_every_cell(task: str, warpvox: Callable) -> None:
    world = task_world(get_task(task), example_design("walker"))
    assert f"picture: {task}.png" in warpvox("tasks", task, f"picture={task}.png").out
    pixels = np.asarray(Image.open(f"{task}.png").convert("RGB")).astype(int)
    assert np.array_equal(pixels, np.asarray(draw_world(world)))
    scale = round(pixels.shape[1] / (world.width + 2 * BELOW))
    cells = world.grid()[::-1]
    for (row, column), kind in np.ndenumerate(cells):
        x, y = round((BELOW + column + 0.5) * scale), pixels.shape[0] - round((BELOW + row + 0.5) * scale)
        colour = pixels[y, x]
        if kind:
            assert np.abs(colour - cell_colour(kind)).max() <= 12, (task, row, column, kind)
        else:
            assert colour.min() > 200, (task, row, column)
    assert pixels.shape[0] == round((world.height + BELOW + AIR) * scale)


def test_scenes_of_worlds_are_those_of_the_simulator() -> None:
    env = make_vec("Traverser-v0", ["walker"], device="cpu", dtype="float64", threads=1)
    scene, points = scene_of_world(env.sim.worlds[0])
    assert [obj.name for obj in scene.objects] == env.sim.object_names
    for obj in scene.moving:
        own = points[obj.first_point : obj.first_point + obj.num_points]
        assert np.array_equal(own, env.sim.object_positions(obj.name)[0].numpy())
        assert np.array_equal(obj.corners - obj.first_point, env.sim.voxel_corners(obj.name))
