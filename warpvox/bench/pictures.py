"""``warpvox bench suite=pictures``: films, USD and the page of an episode of up to 64 environments."""

from __future__ import annotations

import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.bench.bodies import one_body
from warpvox.bench.report import Report, number
from warpvox.errors import SimulationError

__all__ = ["run"]

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
MOST = 64  # environments in a stage and on the page
READY = "Boolean(globalThis.player) && document.readyState === 'complete'"
DRAWN = 120  # pictures of a timed repetition
# Reading a pixel waits until everything has been painted.
DRAW = """(count) => {
    const pen = document.getElementById('stage').getContext('2d'), before = performance.now();
    for (let k = 0; k < count; k++) {
        player.time = Math.min(player.last, 4 * k);
        player.draw();
        pen.getImageData(0, 0, 1, 1);
    }
    return performance.now() - before;
}"""


def run(config: Any, report: Report) -> dict[str, Any]:
    """Pictures per second, size and time of a stage, pictures per second of the page in a browser."""
    from warpvox.envs.vec_env import make_vec
    from warpvox.view.rollout import record

    with report.status("recording an episode"):
        env = make_vec(
            config.task,
            [one_body(config)],
            min(config.num_envs, MOST),
            device=config.device,
            dtype=config.dtype,
            arithmetic=config.arithmetic,
            seed=config.seed,
        )
        rollout = record(env, "sine", config.frames)
    with tempfile.TemporaryDirectory() as folder, report.status("drawing and writing"):
        figures = _film(rollout, config.repeats) | _stage(rollout, Path(folder), config.repeats)
        figures |= _page(rollout, Path(folder), config.repeats)
    rows = [
        ["pictures of 640 x 360 per second of CPU time", number(figures["film_per_second"])],
        ["USD: MB", number(figures["usd_mb"])],
        ["USD: seconds of CPU time", number(figures["usd_seconds"])],
        ["page: MB", number(figures["page_mb"])],
        ["page in Chromium: pictures of all environments per second", number(figures["page_per_second"])],
    ]
    report.table(f"{config.task}, {rollout.num_envs} environments, {rollout.num_steps} steps", ["", ""], rows)
    report.note("Checked: the stage's points are the rollout's, the page has nothing to complain about.")
    if figures["page_per_second"] is None:
        report.note("No browser was found, or Playwright is missing: the page was not drawn.")
    return {"task": config.task, "environments": rollout.num_envs, "frames": rollout.num_frames} | figures


def _seconds(repeats: int, act: Callable[[], object]) -> float:
    """CPU time, the median of some repetitions."""
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        act()
        spent.append(time.process_time() - start)
    return statistics.median(spent)


def _film(rollout: Any, repeats: int) -> dict[str, float]:
    from warpvox.view.render import Film

    film = Film(rollout, 0)
    frames = np.linspace(0, rollout.num_frames - 1, DRAWN).astype(int).tolist()
    spent = _seconds(repeats, lambda: [film.array(frame) for frame in frames])
    return {"film_per_second": len(frames) / spent}


def _stage(rollout: Any, folder: Path, repeats: int) -> dict[str, float]:
    from pxr import Usd, UsdGeom

    from warpvox.view.usd import write_usd

    path = folder / "rollout.usdc"
    spent = _seconds(repeats, lambda: write_usd(rollout, path))
    stage, last = Usd.Stage.Open(str(path)), rollout.num_frames - 1
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/World/env_000/voxels"))
    points = np.asarray(mesh.GetPointsAttr().Get(last))
    ours = rollout.positions[last, 0, : rollout.scene(0).num_points].astype(np.float32)
    samples = len(mesh.GetPointsAttr().GetTimeSamples())
    if samples != rollout.num_frames or not np.array_equal(points[:, :2], ours):
        raise SimulationError("The stage does not hold the rollout: no time is printed.")
    return {"usd_mb": os.path.getsize(path) / 1e6, "usd_seconds": spent}


def _page(rollout: Any, folder: Path, repeats: int) -> dict[str, float | None]:
    from warpvox.view.player import write_html

    path = write_html(rollout, folder / "rollout.html")
    figures: dict[str, float | None] = {"page_mb": os.path.getsize(path) / 1e6, "page_per_second": None}
    browser_path = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        return figures
    if browser_path is None:
        return figures
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1000, "height": 700})
        problems: list[str] = []
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.goto(f"{path.as_uri()}#paused")
        while not page.evaluate(READY):
            time.sleep(0.02)
        spent = statistics.median(page.evaluate(DRAW, DRAWN) / 1000 for _ in range(repeats))
        browser.close()
    if problems:
        raise SimulationError(f"The page complains: {problems[0]}")
    return figures | {"page_per_second": DRAWN / spent}
