"""The page of the browser player: what it carries, and that it plays in a real browser."""

import base64
import io
import json
import re
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from PIL import Image

from warpvox.errors import RolloutError
from warpvox.view.painter import Canvas
from warpvox.view.player import page_of, write_html
from warpvox.view.rollout import Rollout

SAME = 16  # mean difference of two painters' pictures of one robot, of 255: their edges differ, nothing else


def element(page: str, name: str) -> str:
    return re.search(rf'<script type="[^"]+" id="{name}">(.*?)</script>', page, re.DOTALL)[1]


def decode(path: Path) -> tuple[dict, list[np.ndarray], np.ndarray]:
    """What a page carries, read by the format's description: meta, positions per environment, rewards."""
    page = path.read_text(encoding="utf-8")
    meta = json.loads(element(page, "meta"))
    data = zlib.decompress(base64.b64decode(element(page, "data")), -zlib.MAX_WBITS)
    widths = [2 * meta["scenes"][env["scene"]]["points"] for env in meta["envs"]]
    rows, steps, envs = sum(widths), meta["frames"] - 1, len(widths)
    start = np.frombuffer(data, "<i4", rows)
    rewards = np.frombuffer(data, "<f4", envs * steps, 4 * rows).reshape(envs, steps)
    low, high = np.frombuffer(data, np.uint8, 2 * rows * steps, 4 * (rows + envs * steps)).reshape(2, rows, steps)
    moves = (low.astype(np.uint16) | high.astype(np.uint16) << 8).astype(np.int16)
    whole = np.concatenate([start[:, None], moves], axis=1).astype(np.int64).cumsum(axis=1)
    assert len(data) == 4 * (rows + envs * steps) + 2 * rows * steps
    tracks = np.split(whole / meta["scale"], np.cumsum(widths)[:-1])
    return meta, [track.T.reshape(meta["frames"], -1, 2) for track in tracks], rewards


@given(frames=st.integers(2, 12), envs=st.integers(1, 4), designs=st.integers(1, 3), seed=st.integers(0, 99))
def test_page_holds_the_positions(rollouts, tmp_path_factory, frames, envs, designs, seed) -> None:
    rollout = rollouts(frames, envs, designs, seed)
    path = write_html(rollout, tmp_path_factory.mktemp("page") / "page.html")
    meta, tracks, rewards = decode(path)
    for env, track in enumerate(tracks):
        exact = rollout.positions[:, env, : rollout.scene(env).num_points]
        assert track.shape == exact.shape
        assert np.abs(track - exact).max() <= 0.5 / meta["scale"] + 1e-7
    np.testing.assert_allclose(rewards, rollout.rewards.T, rtol=1e-6)
    assert meta["scale"] == 4096


@pytest.mark.parametrize("every", [1, 3, 10])
def test_a_page_shows_every_nth_frame(rollouts: Callable[..., Rollout], tmp_path: Path, every: int) -> None:
    rollout, steps = rollouts(101, 2), 100 // every
    meta, tracks, rewards = decode(write_html(rollout, tmp_path / "page.html", every=every))
    assert (meta["frames"], meta["dt"]) == (steps + 1, pytest.approx(0.02 * every))
    np.testing.assert_allclose(tracks[1], rollout.positions[::every, 1, : rollout.scene(1).num_points], atol=2e-4)
    wanted = rollout.rewards[: steps * every].reshape(steps, every, 2).sum(1).T
    np.testing.assert_allclose(rewards, wanted, atol=1e-6)


def test_a_page_takes_little_more_memory_than_it_holds(rollouts: Callable[..., Rollout]) -> None:
    rollout = rollouts(2000, 8)
    tracemalloc.start()
    page_of(rollout)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.5 * rollout.positions.nbytes


def test_a_page_that_no_browser_can_hold_is_refused(rollouts, monkeypatch: pytest.MonkeyPatch) -> None:
    rollout = rollouts(1000, 1)
    monkeypatch.setattr("warpvox.view.player.MOST_NUMBERS", 2 * rollout.scene(0).num_points * 200)
    with pytest.raises(RolloutError):
        page_of(rollout)
    page_of(rollout, every=5)


def test_precision_gives_way_to_leaps(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(4, 1)
    rollout.positions[2] += 50
    meta, tracks, _ = decode(write_html(rollout, tmp_path / "page.html"))
    assert meta["scale"] < 4096
    count = rollout.scene(0).num_points
    assert np.abs(tracks[0] - rollout.positions[:, 0, :count]).max() <= 0.5 / meta["scale"] + 1e-5
    rollout.positions[2] += 1e7
    with pytest.raises(RolloutError):
        write_html(rollout, tmp_path / "far.html")
    assert not (tmp_path / "far.html").exists()


def test_some_environments_of_several_designs(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(5, 6, designs=3)
    meta, tracks, _ = decode(write_html(rollout, tmp_path / "page.html", envs=[4, 1]))
    assert [env["env"] for env in meta["envs"]] == [4, 1]
    assert len(meta["scenes"]) == 1
    for env, track in zip((4, 1), tracks, strict=True):
        np.testing.assert_allclose(track, rollout.positions[:, env, : rollout.scene(env).num_points], atol=1e-3)


def test_page_needs_no_network_and_is_safe(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(3, 1)
    rollout.metadata |= {"task": "</script><b>&", "agent": "</script>{{data}}"}
    page = write_html(rollout, tmp_path / "page.html").read_text(encoding="utf-8")
    assert not re.search(r"https?://|@import|src=", page)
    assert page.count("</script>") == 3
    assert "<title>&lt;/script&gt;&lt;b&gt;&amp;</title>" in page
    assert json.loads(element(page, "meta"))["about"]["agent"] == "</script>{{data}}"


def test_half_of_a_pair_in_a_title_is_written_as_html_can_say_it(rollouts, tmp_path: Path) -> None:
    page = write_html(rollouts(3, 1), tmp_path / "page.html", title="a\udcff").read_text(encoding="utf-8")
    assert r"<title>a\udcff</title>" in page


PLAYING = "Boolean(globalThis.player) && document.readyState === 'complete'"
FRAMES, ENDS = 200, (60,)


@pytest.fixture(scope="module")
def page_file(rollouts: Callable[..., Rollout], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_html(rollouts(FRAMES, 4, designs=2, ends=ENDS), tmp_path_factory.mktemp("page") / "page.html")


@pytest.fixture
def show(open_page: Callable, page_file: Path) -> Callable:
    """Open the page with options, such as ``paused&view=one``; returns it when it plays."""
    return lambda options="", file=page_file: open_page(f"{file.as_uri()}#{options}", PLAYING)


def screenshot(page) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))


def test_browser_decodes_the_same(show: Callable, rollouts: Callable[..., Rollout]) -> None:
    page = show("paused")
    rollout = rollouts(FRAMES, 4, designs=2, ends=ENDS)
    for env in (0, 3):
        count = rollout.scene(env).num_points
        shown = np.array(page.evaluate(f"[...player.envs[{env}].xy]")).reshape(FRAMES, count, 2) / 10
        np.testing.assert_allclose(shown, rollout.positions[:, env, :count], atol=2e-4)
        assert page.evaluate(f"player.envs[{env}].returns[199]") == pytest.approx(rollout.returns[-1, env], rel=1e-4)


def test_it_plays_and_obeys_keys(show: Callable, wait_for: Callable) -> None:
    page = show()
    wait_for(page, "player.time > 3")
    page.keyboard.press(" ")
    assert not page.evaluate("player.playing")
    page.evaluate("player.seek(50)")
    for key in ("ArrowRight", "Shift+ArrowRight", "ArrowLeft"):
        page.keyboard.press(key)
    assert page.evaluate("player.frame") == 60
    for key, frame in (("ArrowRight", 61), ("ArrowLeft", 59)):
        page.evaluate("player.seek(60.7)")  # between frames, as a pause leaves it; the clock says 60
        page.keyboard.press(key)
        assert page.evaluate("player.time") == frame
    page.keyboard.press("End")
    assert page.evaluate("player.frame") == 199
    page.keyboard.press("Home")
    assert page.evaluate("player.frame") == 0
    page.keyboard.press("ArrowUp")
    assert page.evaluate("player.speed") == 2
    assert page.input_value("#speed") == "2"
    page.keyboard.press("n")
    page.keyboard.press("g")
    assert page.evaluate("[player.chosen, player.many]") == [1, False]
    page.keyboard.press("f")
    assert not page.is_checked("#follow")
    before = page.evaluate("document.documentElement.dataset.theme")
    page.keyboard.press("t")
    assert page.evaluate("document.documentElement.dataset.theme") != before
    page.keyboard.press("?")
    assert page.is_visible("#keys")
    assert page.problems == []


def test_buttons_do_what_keys_do(show: Callable, wait_for: Callable) -> None:
    page = show("paused")
    page.click("#play")
    wait_for(page, "player.time > 1")
    page.click("#play")
    page.click("#first")
    page.click("#on")
    page.click("#on")
    page.click("#back")
    assert page.evaluate("[player.playing, player.frame]") == [False, 1]
    page.select_option("#speed", "4")
    page.select_option("#robot", "2")
    page.click("#layout")
    page.uncheck("#follow")
    assert page.evaluate("[player.speed, player.chosen, player.many, Boolean(player.pan)]") == [4, 2, False, True]
    assert page.text_content("#clock").startswith("0.02 / 3.98 s")
    assert page.problems == []


def test_faster_is_faster_and_the_end_is_followed_by_the_start(show: Callable, wait_for: Callable) -> None:
    page = show("paused")
    moved = page.evaluate(
        "[1, 4].map((speed) => { player.setSpeed(speed); player.seek(0); player.playing = true;"
        "player.before = 0; player.tick(50); player.playing = false; return player.time; })"
    )
    assert moved == pytest.approx([2.5, 10.0])
    page.evaluate("player.seek(199), player.toggle()")
    wait_for(page, "player.frame < 150")
    assert page.problems == []


def test_scrubbing_and_pointing(show: Callable, wait_for: Callable) -> None:
    page = show("paused&view=one")
    line = page.locator("#timeline").bounding_box()
    middle = line["y"] + line["height"] / 2
    page.mouse.move(line["x"] + line["width"] / 2, middle)
    page.mouse.down()
    page.mouse.move(line["x"] + line["width"] * 0.75, middle)
    page.mouse.up()
    assert page.evaluate("player.frame") == pytest.approx(0.75 * 199, abs=1)
    # Point at the middle of the first voxel, which is a horizontal actuator.
    page.evaluate("player.seek(0)")
    wait_for(page, "!player.dirty && player.boxes.length === 1")
    at = page.evaluate(
        "(() => { const { env, x, y, h, look } = player.boxes[0], quad = env.scene.objects[0].corners[0];"
        "const mean = (axis) => quad.reduce((sum, p) => sum + env.xy[2 * p + axis] / 4, 0);"
        "return [x + (mean(0) - look.left) * look.scale, y + h - (mean(1) - look.bottom) * look.scale]; })()"
    )
    stage = page.locator("#stage").bounding_box()
    page.mouse.move(stage["x"] + at[0], stage["y"] + at[1])
    page.wait_for_selector("#tip:not([hidden])")
    assert "horizontal actuator" in page.text_content("#tip")
    assert "stretch 1.0" in page.text_content("#tip")
    assert page.problems == []


def test_a_click_among_many_shows_that_robot(show: Callable, wait_for: Callable) -> None:
    page = show("paused")
    wait_for(page, "!player.dirty && player.boxes.length === 4")
    box = page.evaluate("(({ x, y, w, h }) => [x + w / 2, y + h / 2])(player.boxes[2])")
    stage = page.locator("#stage").bounding_box()
    page.mouse.click(stage["x"] + box[0], stage["y"] + box[1])
    assert page.evaluate("[player.chosen, player.many]") == [2, False]


@pytest.mark.parametrize("frame", [0, 120])
def test_the_page_shows_what_the_pictures_show(show, wait_for, rollouts: Callable[..., Rollout], frame: int) -> None:
    page = show(f"paused&view=one&robot=1&theme=light&frame={frame}")
    wait_for(page, "!player.dirty && player.boxes.length === 1")
    rollout = rollouts(FRAMES, 4, designs=2, ends=ENDS)
    points = rollout.positions[frame, 1, rollout.scene(1).robot_points] * 10
    low, high = points.min(axis=0), points.max(axis=0)
    look = page.evaluate(
        "(({ x, y, h, look: { left, bottom, scale } }) => [x, y + h, left, bottom, scale])(player.boxes[0])"
    )
    stage = page.locator("#stage").bounding_box()
    x, floor, left, bottom, scale = look
    box = [
        stage["x"] + x + (low[0] - left) * scale, stage["y"] + floor - (high[1] - bottom) * scale,
        stage["x"] + x + (high[0] - left) * scale, stage["y"] + floor - (low[1] - bottom) * scale,
    ]  # fmt: skip
    ours = Image.fromarray(screenshot(page)).resize((96, 96), Image.Resampling.BOX, box)
    corner = np.rint(low * 30).astype(int) - 100
    picture = Canvas(rollout.scene(1), (600, 500), 30).picture(rollout.positions[frame, 1], tuple(corner.tolist()))
    box = [
        low[0] * 30 - corner[0], 500 + corner[1] - high[1] * 30,
        high[0] * 30 - corner[0], 500 + corner[1] - low[1] * 30,
    ]  # fmt: skip
    theirs = picture.resize((96, 96), Image.Resampling.BOX, box)
    difference = np.abs(np.asarray(ours, float) - np.asarray(theirs, float))
    assert difference.mean() < SAME
    wrong = np.abs(np.asarray(ours, float) - np.asarray(theirs, float)[:, ::-1]).mean()
    assert wrong > 2 * difference.mean()  # the measure would notice a mirrored robot
