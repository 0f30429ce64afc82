"""The editor in a real browser: painting, validity, files, a rollout."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from warpvox.design import example_designs, load_design
from warpvox.editor.server import EditorServer
from warpvox.world import World

LEAVING = "!dispatchEvent(new Event('beforeunload', {cancelable: true}))"
"""True where the page asks before it is left."""
CHECKED = "document.getElementById('verdict').textContent !== ''"


@pytest.fixture
def page(open_page: Callable, server: EditorServer) -> Any:
    return open_page(server.url, CHECKED, (1400, 800))


def cells(page: Any) -> np.ndarray:
    return np.array(page.evaluate("editor.drawing.rows(editor.drawing.types)"))


def place(page: Any, column: float, row: float) -> tuple[float, float]:
    """Where the middle of a cell lies on the screen."""
    box, size = page.locator("#board").bounding_box(), page.evaluate("editor.board.size")
    return box["x"] + (column + 0.5) * size, box["y"] + (row + 0.5) * size


def verdict(page: Any, wait_for: Callable, words: str) -> None:
    wait_for(page, f"document.getElementById('verdict').textContent.includes({json.dumps(words)})")


def test_painting_and_validity(page: Any, wait_for: Callable) -> None:
    assert cells(page).tolist() == example_designs()["walker"].tolist()
    verdict(page, wait_for, "A valid robot: 5 x 5, 23 cells")
    page.keyboard.press("2")
    page.mouse.click(*place(page, 2, 4))
    assert cells(page)[4, 2] == 2
    verdict(page, wait_for, "24 cells")
    # a stroke from corner to corner leaves no gap
    page.keyboard.press("1")
    page.mouse.move(*place(page, 0, 0))
    page.mouse.down()
    page.mouse.move(*place(page, 4, 4))
    page.mouse.up()
    assert (np.diag(cells(page)) == 1).all()
    # the right button erases, Shift fills a rectangle
    page.mouse.click(*place(page, 1, 1), button="right")
    assert cells(page)[1, 1] == 0
    page.keyboard.press("4")
    page.keyboard.down("Shift")
    page.mouse.move(*place(page, 4, 2))
    page.mouse.down()
    page.mouse.move(*place(page, 2, 1))
    page.mouse.up()
    page.keyboard.up("Shift")
    assert (cells(page)[1:3, 2:5] == 4).all()
    for _ in range(4):
        page.keyboard.press("Control+z")
    assert cells(page).tolist() == example_designs()["walker"].tolist()
    page.keyboard.press("Control+y")
    assert cells(page)[4, 2] == 2
    page.click("#clear")
    verdict(page, wait_for, "is empty")
    assert page.is_disabled("#save")
    assert page.is_disabled("#run")
    page.keyboard.press("Control+z")
    verdict(page, wait_for, "A valid robot")
    assert page.problems == []


def test_painting_by_keyboard(page: Any, wait_for: Callable) -> None:
    page.click("#clear")
    page.focus("#board")
    for key in ("3", "Enter", "ArrowRight", "4", "Enter", "ArrowDown", "Enter", "ArrowLeft", "1", "Enter", "Delete"):
        page.keyboard.press(key)
    assert cells(page)[:2, :2].tolist() == [[3, 4], [0, 4]]
    verdict(page, wait_for, "A valid robot: 2 x 2, 3 cells")
    assert page.problems == []


def test_sizes_examples_and_chance(page: Any, wait_for: Callable) -> None:
    page.fill("#columns", "7")
    page.locator("#columns").dispatch_event("change")
    page.fill("#rows", "6")
    page.locator("#rows").dispatch_event("change")
    assert cells(page).shape == (6, 7)
    assert cells(page)[1:, :5].tolist() == example_designs()["walker"].tolist()  # it stays on the floor
    page.select_option("#example", "worm")
    assert cells(page).tolist() == example_designs()["worm"].tolist()
    page.click("#random")
    wait_for(page, "editor.history.past.length === 4")
    assert cells(page).shape == (2, 7)
    verdict(page, wait_for, "A valid robot")
    page.fill("#columns", "1000")
    page.locator("#columns").dispatch_event("change")
    assert cells(page).shape == (2, 32)
    assert page.problems == []


def test_save_open_and_replace(page: Any, wait_for: Callable, server: EditorServer) -> None:
    page.fill("#name", "mine")
    page.click("#save")
    wait_for(page, "document.getElementById('outcome').textContent.startsWith('Saved')")
    assert load_design(server.folder / "mine.json").tolist() == example_designs()["walker"].tolist()
    assert not page.evaluate(LEAVING)
    page.select_option("#example", "mini")
    verdict(page, wait_for, "3 x 3")
    assert page.evaluate(LEAVING)
    page.keyboard.press("Control+s")
    page.wait_for_selector("#ask[open]")
    page.click("#ask button[value=no]")
    assert load_design(server.folder / "mine.json").shape == (5, 5)
    page.evaluate("document.getElementById('outcome').textContent = ''")  # what the first time has left there
    page.keyboard.press("Control+s")
    page.click("#ask button[value=yes]")
    wait_for(page, "document.getElementById('outcome').textContent.startsWith('Saved')")
    assert load_design(server.folder / "mine.json").shape == (3, 3)
    page.click("#clear")
    wait_for(page, "document.getElementById('open').options.length === 2")
    page.select_option("#open", "mine.json")
    wait_for(page, "document.getElementById('outcome').textContent === 'Opened mine.json.'")
    assert cells(page).tolist() == example_designs()["mini"].tolist()
    assert not page.evaluate(LEAVING)
    assert page.problems == []


def test_a_world_of_several_objects(page: Any, wait_for: Callable, server: EditorServer) -> None:
    page.click("#world")
    verdict(page, wait_for, "robot (robot, 23 cells)")
    page.click("#add")
    page.locator("#names input[type=text]").nth(2).fill("box")
    page.locator("#names input[type=text]").nth(2).dispatch_event("change")
    page.keyboard.press("Escape")
    page.click("#material-1")
    height = len(cells(page))
    page.mouse.click(*place(page, 10, height - 2))  # beside the ground, which it touches without being part of it
    verdict(page, wait_for, "box (object, 1 cell)")
    page.fill("#name", "my_world")
    page.click("#save")
    wait_for(page, "document.getElementById('outcome').textContent.startsWith('Saved')")
    world = World.from_json(server.folder / "my_world.json")
    assert set(world.objects) == {"ground", "robot", "box"}
    assert (world.objects["box"].x, world.objects["box"].y) == (10, 1)
    page.click("#body")
    assert cells(page).tolist() == example_designs()["walker"].tolist()
    page.click("#world")
    assert page.evaluate("editor.drawing.names") == ["ground", "robot", "box"]  # nothing was lost meanwhile
    page.locator("#names button").nth(2).click()
    assert page.evaluate("editor.drawing.names") == ["ground", "robot"]
    page.click("#body")
    wait_for(page, "document.getElementById('open').options.length === 2")
    page.select_option("#open", "my_world.json")  # in place of the world; the body waits
    wait_for(page, "document.getElementById('outcome').textContent === 'Opened my_world.json.'")
    assert page.evaluate("editor.drawing.names") == ["robot", "ground", "box"]  # in the order of the file
    page.click("#undo")  # the world that was there
    assert page.evaluate("editor.drawing.names") == ["ground", "robot"]
    page.click("#body")
    assert cells(page).tolist() == example_designs()["walker"].tolist()
    assert page.problems == []


@pytest.mark.parametrize("kind", ["body", "world"])
def test_a_rollout_plays_beside_the_drawing(page: Any, wait_for: Callable, kind: str) -> None:
    page.click(f"#{kind}")
    verdict(page, wait_for, "A valid")
    page.fill("#seconds", "0.4")
    page.click("#run")
    wait_for(page, "document.getElementById('outcome').textContent.includes('in 20 steps')")
    wait_for(page, "document.getElementById('player').src.includes('rollout/1')")
    inner = page.frame_locator("#player")
    inner.locator("#clock").wait_for()
    inner.locator("h1").wait_for()
    assert inner.locator("h1").text_content() == ("Walker-v0" if kind == "body" else "world")
    assert page.problems == []


def test_a_server_that_was_stopped_is_noticed(page: Any, wait_for: Callable) -> None:
    page.route("**/check", lambda route: route.abort())
    page.evaluate("editor.check()")
    verdict(page, wait_for, "does not answer")
    page.unroute("**/check")
    page.evaluate("editor.check()")
    verdict(page, wait_for, "A valid robot")
