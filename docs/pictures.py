"""Redraws the pictures of the documentation; ``make pictures`` runs it. Not part of the library.

Trains a walker from three seeds and searches for one, then draws with the commands that users have. The screenshots
need Playwright and a Chromium of the system.
"""

import io
import json
import shutil
import sys
import threading
from pathlib import Path

from warpvox.cli import main

IMAGES = Path(__file__).parent / "images"
WORK = Path("outputs") / "pictures"
TRAINING = "task=Walker-v0 design=walker num_envs=512 eval_interval=5 stop_return=10.5 seed=0,1,2 -m".split()
SEARCH = (
    "search=ga task=Walker-v0 search.population=8 search.max_designs=48"
    " training.iterations=40 training.eval_interval=10"
).split()


def command(*words: str) -> None:
    """Run a command; stop if it fails."""
    print("warpvox", *words)
    if code := main(words):
        sys.exit(code)


def newest(pattern: str) -> Path:
    """The newest folder that an earlier command has left."""
    return max(WORK.glob(pattern), key=lambda path: path.name)


def draw() -> None:
    """All pictures."""
    if not list(WORK.glob("train/Walker-v0/*/summary.json")):
        command("train", *TRAINING, f"output_dir={WORK}")
    runs = sorted(WORK.glob("train/Walker-v0/*"))
    command("curves", f"runs=[{','.join(map(str, runs))}]", f"file={IMAGES / 'curves.png'}")
    best = max(runs, key=lambda folder: json.loads((folder / "summary.json").read_text())["best_return"])
    keys = (f"run={best}", "num_envs=1", "window=off", f"output_dir={WORK}")
    command("play", *keys, "export=[html,strip]")
    played = newest("play/Walker-v0/*")
    shutil.copy(played / "rollout_strip.png", IMAGES / "walker_strip.png")
    command("tasks", f"gallery={IMAGES / 'gallery.png'}")
    agents = ("agent=sine", "task=UpStepper-v0", "design=[walker,stepper,hopper,worm,carrier,mini]", "num_envs=6")
    command("play", *agents, "steps=300", "window=off", f"output_dir={WORK}")
    if not list(WORK.glob("codesign/Walker-v0/*/report.html")):
        command("codesign", *SEARCH, f"output_dir={WORK}")
    photograph(newest("play/UpStepper-v0/*") / "rollout.html", newest("codesign/Walker-v0/*") / "report.html")


def photograph(page_file: Path, report: Path) -> None:
    """Screenshots of the page, of a search's report and of the editor."""
    from playwright.sync_api import sync_playwright

    from warpvox.editor.server import EditorServer

    found = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as driver, EditorServer(WORK / "designs") as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        browser = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 720}, color_scheme="light")
        page.goto(f"{page_file.resolve().as_uri()}#paused&frame=170&theme=light")
        page.locator("#clock", has_text="frame 170").wait_for()
        save(page.screenshot(), "page.png")
        page.goto(report.resolve().as_uri())
        page.wait_for_load_state()
        save(page.screenshot(clip={"x": 0, "y": 0, "width": 1200, "height": 1000}, full_page=True), "report.png")
        page.goto(server.url)
        page.locator("#verdict.good").wait_for()
        page.click("#world")
        page.fill("#seconds", "3")
        page.locator("#verdict.good", has_text="world").wait_for()
        page.click("#run")
        page.locator("#outcome", has_text="return").wait_for()
        page.frame_locator("#player").locator("#clock", has_text="frame 5").wait_for()
        page.frame_locator("#player").locator("#play").click()
        save(page.screenshot(), "editor.png")
        browser.close()
        server.shutdown()


def save(screenshot: bytes, name: str) -> None:
    """Write a screenshot with few colours, which makes it small."""
    from PIL import Image

    picture = Image.open(io.BytesIO(screenshot)).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    picture.save(IMAGES / name, "PNG", optimize=True)


if __name__ == "__main__":
    draw()
