"""What warpvox does without torch, run in a clean environment: ``python -I without_torch.py EMPTY_FOLDER``."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np

import warpvox as wv
from warpvox.compile import compile_world
from warpvox.errors import RolloutError
from warpvox.view.rollout import Rollout
from warpvox.view.scene import Scene, SceneObject

folder = Path(sys.argv[1])


def designs_and_worlds() -> wv.World:
    body = wv.sample_design((5, 5), seed=0)
    path = wv.save_design(folder / "body.json", body)
    np.testing.assert_array_equal(wv.load_design(path), body)
    assert len(wv.example_designs()) > 3
    world = wv.World(20, 6)
    world.add_from_array("robot", body, 1, 1)
    assert wv.World.from_json(world.to_json()).to_json() == world.to_json()
    return world


def a_rollout(world: wv.World) -> None:
    (robot,) = compile_world(world, wv.Physics()).robots
    grid = np.array(robot.source.grid)
    points = len(robot.points)
    cells = np.array([robot.corners[tuple(map(int, cell))] for cell in np.argwhere(grid)], np.int32)
    scene = Scene(20, 6, (SceneObject("robot", grid, 1, 1, 0, points, cells),))
    steps = np.zeros((2, 1))
    positions = np.random.default_rng(0).random((3, 1, points, 2), np.float32)
    rollout = Rollout(positions, np.zeros(1), (scene,), steps[..., None], steps, steps > 0, steps > 0, {"task": "none"})
    path = rollout.save(folder / "rollout.npz")
    np.testing.assert_array_equal(Rollout.load(path).positions, positions)
    path.write_bytes(path.read_bytes()[:-100])
    try:
        Rollout.load(path)
    except RolloutError:
        return
    raise AssertionError("a truncated rollout was loaded")


def messages() -> None:
    text = ""
    try:
        wv.load_design("walkr")
    except wv.DesignError as error:
        text = str(error)
    assert "walker" in text, "a design that does not exist was loaded, or the message names none that do"
    run = subprocess.run([sys.executable, "-m", "warpvox", "trian"], cwd=folder, capture_output=True, text=True)
    assert run.returncode == 2, run.stderr
    assert "train" in run.stderr
    assert "Traceback" not in run.stderr


assert importlib.util.find_spec("torch") is None, "this environment has torch"
assert "site-packages" in wv.__file__, f"not the installed copy: {wv.__file__}"
a_rollout(designs_and_worlds())
messages()
import warp  # noqa: E402  (its wheel has to load on this Python)

print("fine:", sys.version.split()[0], "numpy", np.__version__, "warp", warp.__version__)
