"""What plays without a trained run: agents, recorded rollouts, the window."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from warpvox.algos.metrics import read_metrics
from warpvox.cli.commands.play import play_in_window
from warpvox.envs.vec_env import make_vec
from warpvox.view.rollout import Rollout, record

QUICK = "task=Walker-v0 design=mini num_envs=2 steps=6 threads=1 device=cpu window=off".split()


def only(pattern: str) -> Path:
    (found,) = Path("outputs").glob(pattern)
    return found


@pytest.mark.parametrize("agent", ["random", "sine", "zero"])
def test_an_agent_plays_any_task_and_design(warpvox: Callable, agent: str) -> None:
    outcome = warpvox("play", f"agent={agent}", "seed=4", *QUICK)
    folder = only("play/Walker-v0/*")
    played = Rollout.load(folder / "rollout.npz")
    env = make_vec("Walker-v0", ["mini"], 2, device="cpu", seed=4, threads=1)
    np.testing.assert_array_equal(played.positions, record(env, agent, 6).positions)
    assert f"agent {agent}" in outcome.out
    assert json.loads((folder / "summary.json").read_text())["source"] == f"agent {agent}"


def test_an_agent_plays_the_example_made_for_the_task(warpvox: Callable) -> None:
    warpvox("play", "agent=zero", "task=Jumper-v0", "design=auto", "steps=2", *QUICK[2:3], *QUICK[4:])
    (scene,) = Rollout.load(only("play/Jumper-v0/*/rollout.npz")).scenes
    assert scene.robots[0].grid.tolist() == [[1] * 5, [4] * 5, [4] * 5, [4] * 5, [3, 3, 0, 3, 3]]  # the hopper


@pytest.mark.parametrize("switch", ["", "none"])
def test_without_a_window_there_is_a_page(switch: str, warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    if switch:
        monkeypatch.setenv("WARPVOX_WINDOW", switch)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    outcome = warpvox("play", "agent=sine", *[word for word in QUICK if not word.startswith("window")])
    page = only("play/Walker-v0/*/rollout.html")
    assert page.resolve().as_uri() in outcome.out
    outcome = warpvox("play", "agent=sine", *QUICK, "export=[]", "name=bare", "record=false")
    assert {file.name for file in only("play/Walker-v0/*_bare").iterdir()} == {"config.yaml", "summary.json"}


def test_a_recorded_rollout_is_exported_as_it_is(warpvox: Callable) -> None:
    warpvox("play", "agent=sine", *QUICK, "export=[]")
    file = only("play/Walker-v0/*/rollout.npz")
    warpvox("export", f"rollout={file}", "export=[html,png,strip,gif]", "size=[400,200]")  # as well as format=
    folder = only("export/Walker-v0/*")
    names = {"config.yaml", "summary.json", "rollout.html", "rollout.png", "rollout_strip.png", "rollout.gif"}
    assert {file.name for file in folder.iterdir()} == names
    for name in ("rollout.png", "rollout_strip.png", "rollout.gif"):
        with Image.open(folder / name) as picture:
            assert picture.size == (400, 200)
    assert yaml.safe_load((folder / "config.yaml").read_text())["rollout"] == str(file)


def test_a_name_out_of_a_file_leads_nowhere_else(warpvox: Callable) -> None:
    warpvox("play", "agent=zero", *QUICK, "export=[]")
    rollout = Rollout.load(only("play/Walker-v0/*/rollout.npz"))
    rollout.metadata |= {"task": "../../../elsewhere", "names": ["[/a]", "b"]}
    rollout.save("foreign.npz")
    warpvox("export", "rollout=foreign.npz", "format=png")
    assert only("export/*/*/rollout.png").is_relative_to("outputs/export")
    assert "[/a]" in warpvox("play", "rollout=foreign.npz", "window=off", "export=[]").out


class Screen:
    """Stands in for a window: keeps what it is shown, and is closed by its owner after a while."""

    def __init__(self, size: tuple[int, int], title: str, patience: int) -> None:
        self.size, self.title, self.patience, self.pictures = size, title, patience, []

    @property
    def closed(self) -> bool:
        return len(self.pictures) >= self.patience

    def show(self, picture: np.ndarray) -> None:
        assert picture.shape == (self.size[1], self.size[0], 3)
        self.pictures.append(picture)


@pytest.mark.parametrize("speed", [0.5, 3.0])
def test_the_window_shows_real_time_and_begins_anew(speed: float) -> None:
    env = make_vec("Walker-v0", ["mini"], 1, device="cpu", threads=1)
    rollout = record(env, "sine", 10)
    now = iter(np.arange(10_000) * 0.02 * speed)  # a machine that draws a picture every `speed` frames
    screens = []

    def open_screen(size: tuple[int, int], title: str) -> Screen:
        screens.append(Screen(size, title, 200))
        return screens[-1]

    count = play_in_window(rollout, [0], (200, 120), clock=lambda: next(now), make_window=open_screen)
    assert "Walker-v0" in screens[0].title
    first, shown = screens[0].pictures[0], screens[0].pictures
    again = [k for k in range(1, 200) if (shown[k] == first).all() and (shown[k - 1] != first).any()]
    assert again  # it began anew
    assert 2 <= count <= 11 * (len(again) + 1)  # and no frame is drawn twice in a row


def test_training_writes_down_what_diverged_and_play_shows_it(warpvox: Callable, train: Callable) -> None:
    # soft cells far beyond the stability of the integrator
    stiff = ["design=[[3,2],[4,3]]", "physics.soft_main=1e12", "physics.soft_structural=1e12"]
    folder = train(*stiff, "nan_guard=dump", "max_iterations=3")
    rows = read_metrics(folder)
    assert sum(row["diverged"] for row in rows) > 0
    assert all(row["unstable"] >= row["diverged"] for row in rows)
    assert all(np.isfinite(row["value_loss"]) for row in rows)
    files = sorted((folder / "dumps").iterdir())
    assert 0 < len(files) <= 10
    outcome = warpvox("play", f"rollout={files[0]}", "window=off")
    assert "diverged" in outcome.out
    shown = only("play/Walker-v0/*")
    assert {file.name for file in shown.iterdir()} == {"config.yaml", "summary.json", "rollout.html"}
    assert json.loads((shown / "summary.json").read_text())["source"] == str(files[0])
    warpvox("play", f"rollout={files[0]}", "agent=sine", fails="agent cannot be given with it")
    warpvox("play", "rollout=nowhere.npz", "window=off", fails="no such file")


def test_every_reaches_every_format(warpvox: Callable, tmp_path: Path) -> None:
    warpvox(*"play agent=zero steps=40 num_envs=1 window=off export=[]".split())
    (rollout,) = tmp_path.glob("outputs/play/*/*/rollout.npz")
    words = ["export", f"rollout={rollout}", "format=[gif,html,usd]", "size=[64,36]"]
    warpvox(*words, "every=4")
    (folder,) = tmp_path.glob("outputs/export/*/*")
    with Image.open(folder / "rollout.gif") as image:
        assert image.n_frames == 5
    assert '"frames":11,' in (folder / "rollout.html").read_text()
    warpvox(*words, "every=0", fails="every must be at least 1, got 0")
