"""The page of the browser player: what it carries, and that it plays in a real browser."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from warpvox.errors import RolloutError
from warpvox.player import write_html
from warpvox.rollout import Rollout

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))),
    None,
)
needs_chromium = pytest.mark.skipif(CHROMIUM is None or os.name != "posix", reason="no Chromium is installed")
FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    " --disable-component-update --disable-sync --window-size=1000,700 --remote-debugging-pipe"
).split()
SLACK = 2.0  # a shared machine may have half its speed
PATIENCE = 30.0  # seconds for anything in the browser; a shared machine may stall


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


def test_precision_gives_way_to_leaps(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    rollout = rollouts(4, 1)
    rollout.positions[2] += 50
    meta, tracks, _ = decode(write_html(rollout, tmp_path / "page.html"))
    assert meta["scale"] < 4096
    count = rollout.scene(0).num_points
    assert np.abs(tracks[0] - rollout.positions[:, 0, :count]).max() <= 0.5 / meta["scale"] + 1e-5
    rollout.positions[2] += 1e7
    with pytest.raises(RolloutError, match="leap"):
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


def test_wrong_environments(rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    with pytest.raises(RolloutError, match="No environment 7"):
        write_html(rollouts(3, 1), tmp_path / "page.html", envs=[7])
    with pytest.raises(RolloutError):
        write_html(rollouts(3, 1), tmp_path / "page.html", envs=[])
    assert not list(tmp_path.iterdir())


# ------------------------------------------------------------------------------------------- in a real browser

# Chromium talks over file descriptors 3 and 4; only a process of its own can be sure that they are free.
LAUNCH = """
import os, sys
os.dup2(int(sys.argv[1]), 3)
os.dup2(int(sys.argv[2]), 4)
os.execv(sys.argv[3], sys.argv[3:])
"""


class Browser:
    """Headless Chromium, steered over a pipe by the DevTools protocol."""

    def __init__(self, profile: Path) -> None:
        its_end, self.out = os.pipe()
        self.back, its_voice = os.pipe()
        # Numbers above 4, so that the launcher can put them at 3 and 4 in any order.
        spare = [os.open(os.devnull, os.O_RDONLY) for _ in range(4)]
        ends = [os.dup(its_end), os.dup(its_voice)]
        command = [
            sys.executable,
            "-c",
            LAUNCH,
            *map(str, ends),
            CHROMIUM,
            *FLAGS,
            f"--user-data-dir={profile}",
        ]
        self.process = subprocess.Popen(command, pass_fds=ends, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        for number in (its_end, its_voice, *ends, *spare):
            os.close(number)
        self.count, self.buffer, self.session, self.problems = 0, b"", None, []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: object) -> dict:
        self.count += 1
        message = {"id": self.count, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self.count:
                assert "error" not in answer, answer
                return answer["result"]

    def _read(self) -> dict:
        while b"\0" not in self.buffer:
            part = os.read(self.back, 1 << 16)
            assert part, "Chromium has gone"
            self.buffer += part
        message, _, self.buffer = self.buffer.partition(b"\0")
        event = json.loads(message)
        kind = event.get("method")
        if kind == "Runtime.exceptionThrown" or (
            kind == "Log.entryAdded" and event["params"]["entry"]["level"] in ("error", "warning")
        ):
            self.problems.append(event["params"])
        return event

    def run(self, script: str) -> object:
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, condition: str) -> None:
        end = time.monotonic() + PATIENCE
        while not self.run(condition):
            assert time.monotonic() < end, f"never true: {condition}"
            time.sleep(0.02)

    def open(self, path: Path, options: str = "") -> None:
        self.problems.clear()
        self.call("Page.navigate", url="about:blank")
        self.call("Page.navigate", url=f"{path.as_uri()}#{options}")
        self.wait("Boolean(globalThis.player) && document.readyState === 'complete'")

    def key(self, key: str, shift: bool = False) -> None:
        text = {"text": key} if len(key) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, modifiers=8 * shift, **text)

    def mouse(self, kind: str, x: float, y: float) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def screenshot(self) -> np.ndarray:
        from io import BytesIO

        from PIL import Image

        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(BytesIO(data)).convert("RGB"))

    def close(self) -> None:
        os.close(self.out)
        os.close(self.back)
        self.process.terminate()
        self.process.wait(PATIENCE)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    started = Browser(tmp_path_factory.mktemp("profile"))
    yield started
    started.close()


@pytest.fixture(scope="module")
def page(rollouts: Callable[..., Rollout], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_html(rollouts(200, 4, designs=2, ends=(60,)), tmp_path_factory.mktemp("page") / "page.html")


@needs_chromium
def test_browser_decodes_the_same(browser: Browser, rollouts: Callable[..., Rollout], page: Path) -> None:
    browser.open(page, "paused")
    rollout = rollouts(200, 4, designs=2, ends=(60,))
    for env in (0, 3):
        count = rollout.scene(env).num_points
        shown = np.array(browser.run(f"[...player.envs[{env}].xy]")).reshape(200, count, 2) / 10
        np.testing.assert_allclose(shown, rollout.positions[:, env, :count], atol=2e-4)
        assert browser.run(f"player.envs[{env}].returns[199]") == pytest.approx(rollout.returns[-1, env], rel=1e-4)
    assert browser.problems == []


@needs_chromium
def test_it_plays_and_obeys_keys(browser: Browser, page: Path) -> None:
    browser.open(page)
    browser.wait("player.time > 3")
    browser.key(" ")
    assert not browser.run("player.playing")
    browser.run("player.seek(50)")
    browser.key("ArrowRight")
    browser.key("ArrowRight", shift=True)
    browser.key("ArrowLeft")
    assert browser.run("player.frame") == 60
    browser.key("End")
    assert browser.run("player.frame") == 199
    browser.key("Home")
    assert browser.run("player.frame") == 0
    browser.key("ArrowUp")
    assert browser.run("[player.speed, document.getElementById('speed').value]") == [2, "2"]
    browser.key("n")
    browser.key("g")
    assert browser.run("[player.chosen, player.many]") == [1, False]
    browser.key("f")
    assert browser.run("document.getElementById('follow').checked") is False
    before = browser.run("document.documentElement.dataset.theme")
    browser.key("t")
    assert browser.run("document.documentElement.dataset.theme") != before
    assert browser.problems == []


@needs_chromium
def test_scrubbing_and_pointing(browser: Browser, page: Path) -> None:
    browser.open(page, "paused&view=one")
    rect = "(({x, y, width, height}) => [x, y, width, height])(document.getElementById('{}').getBoundingClientRect())"
    x, y, width, height = browser.run(rect.replace("{}", "timeline"))
    browser.mouse("mousePressed", x + width / 2, y + height / 2)
    browser.mouse("mouseMoved", x + width * 0.75, y + height / 2)
    browser.mouse("mouseReleased", x + width * 0.75, y + height / 2)
    assert browser.run("player.frame") == pytest.approx(0.75 * 199, abs=1)
    # Point at the middle of the first voxel, which is a horizontal actuator.
    browser.run("player.seek(0)")
    browser.wait("!player.dirty && player.boxes.length === 1")
    left, top, _, _ = browser.run(rect.replace("{}", "stage"))
    at = browser.run(
        "(() => { const { env, x, y, h, look } = player.boxes[0], quad = env.scene.objects[0].corners[0];"
        "const mean = (axis) => quad.reduce((sum, p) => sum + env.xy[2 * p + axis] / 4, 0);"
        "return [x + (mean(0) - look.left) * look.scale, y + h - (mean(1) - look.bottom) * look.scale]; })()"
    )
    browser.mouse("mouseMoved", left + at[0], top + at[1])
    browser.wait("!document.getElementById('tip').hidden")
    assert "horizontal actuator" in browser.run("document.getElementById('tip').textContent")
    assert "stretch 1.0" in browser.run("document.getElementById('tip').textContent")
    assert browser.problems == []


@needs_chromium
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_robots_are_seen_in_their_colours(browser: Browser, page: Path, theme: str) -> None:
    browser.open(page, f"paused&theme={theme}&frame=0")
    browser.wait("!player.dirty")
    picture = browser.screenshot().astype(int)
    for colour in ((247, 148, 60), (96, 164, 222)):  # horizontal and vertical actuators at rest
        assert (np.abs(picture - colour).max(axis=-1) < 6).sum() > 500
    assert picture[0, 0].mean() > 128 if theme == "light" else picture[0, 0].mean() < 128


@needs_chromium
@pytest.mark.slow
def test_sixty_pictures_a_second(browser: Browser, rollouts: Callable[..., Rollout], tmp_path: Path) -> None:
    browser.open(write_html(rollouts(500, 64), tmp_path / "page.html"), "paused")
    spent = browser.run(
        "(() => { const before = performance.now();"
        "const g = document.getElementById('stage').getContext('2d');"
        # reading a pixel waits until everything has been painted
        "for (let k = 0; k < 60; k++) { player.time = 8 * k; player.draw(); g.getImageData(0, 0, 1, 1); }"
        "return performance.now() - before; })()"
    )
    assert spent < 1000 * SLACK
