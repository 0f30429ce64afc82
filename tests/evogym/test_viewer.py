"""The drop-in's viewer: what pictures show, how the camera follows, what is refused."""

import sys

import gymnasium
import numpy as np
import pytest
from refusals import refused

import warpvox.evogym.envs  # noqa: F401  registers the tasks
from warpvox.errors import DisplayError
from warpvox.evogym import EvoSim, EvoViewer, EvoWorld
from warpvox.evogym.simulator_cpp import Camera, Viewer
from warpvox.palette import cell_colour
from warpvox.types import Cell

SIZE = (300, 150)


@pytest.fixture
def sim() -> EvoSim:
    world = EvoWorld()
    world.add_from_array("ground", np.full((1, 30), 5), 0, 0)
    world.add_from_array("robot", np.array([[3, 4], [1, 2]]), 4, 1)
    world.add_from_array("box", np.full((1, 1), 1), 20, 3)
    return EvoSim(world)


def make(sim: EvoSim, **options: object) -> EvoViewer:
    """A viewer that sees 30 x 15 voxels, 10 pixels each, from (0, -2) on."""
    defaults = {"target_rps": None, "pos": (15, 5.5), "view_size": (30, 15), "resolution": SIZE}
    return EvoViewer(sim, **(defaults | options))


def at(picture: np.ndarray, x: float, y: float) -> tuple[int, ...]:
    return tuple(picture[int(150 - (y + 2) * 10), int(x * 10)].tolist())


@pytest.mark.parametrize("mode", ["img", "rgb_array"])
def test_pictures_show_what_is_where(sim: EvoSim, mode: str) -> None:
    picture = make(sim).render(mode)
    assert picture.shape == (150, 300, 3)
    assert picture.dtype == np.uint8
    places = {
        (4.5, 2.5): cell_colour(Cell.H_ACT),
        (5.5, 2.5): cell_colour(Cell.V_ACT),
        (4.5, 1.5): cell_colour(Cell.RIGID),
        (5.5, 1.5): cell_colour(Cell.SOFT),
        (20.5, 3.5): cell_colour(Cell.RIGID),
        (12.5, 0.5): cell_colour(Cell.FIXED),
    }
    assert {place: at(picture, *place) for place in places} == places
    picture[:] = 0  # it is the caller's
    assert make(sim).render(mode).max() > 0


def test_views_are_stretched_to_the_picture(sim: EvoSim) -> None:
    viewer = make(sim, pos=(5, 2), view_size=(4, 8))
    picture = viewer.render("img")
    colours = [tuple(colour) for colour in picture[75, :].tolist()]  # along y = 2, the middle of the robot
    dark = cell_colour(Cell.SOFT)
    row = [tuple(colour) for colour in picture[80, :].tolist()]  # just below it
    assert row.count(dark) == pytest.approx(75, abs=6)  # one voxel is a quarter of 300 pixels
    assert len(set(colours)) > 1


def test_what_is_hidden_is_not_there(sim: EvoSim) -> None:
    viewer = make(sim)
    full = viewer.render("img")
    bare = viewer.render("img", hide_background=True, hide_grid=True, hide_edges=True, hide_voxels=True)
    assert (bare == 255).all()
    assert (viewer.render("img", hide_grid=True, hide_edges=True, hide_voxels=True) == full[5, 5]).all()
    changed = {
        name: (viewer.render("img", **{name: True}) != full).any(axis=2)
        for name in ("hide_background", "hide_grid", "hide_edges", "hide_voxels")
    }
    assert at(changed["hide_background"][..., None], 10.5, 8.5) == (True,)
    assert at(changed["hide_voxels"][..., None], 4.5, 1.5) == (True,)
    assert at(changed["hide_voxels"][..., None], 10.5, 8.5) == (False,)
    assert changed["hide_edges"].any()
    rows, columns = np.nonzero(changed["hide_grid"])
    assert changed["hide_grid"].any()
    assert set(columns[rows == 3] % 10) <= {0, 9}  # on borders of cells only
    assert {(column + 1) // 10 for column in columns[rows == 3]} >= set(range(30))  # on all of them


def test_actuators_change_colour_with_their_length(sim: EvoSim) -> None:
    rest = at(make(sim).render("img", hide_edges=True), 4.5, 2.5)
    sim.set_action("robot", np.array([1.6, 1.0]))
    for _ in range(8):
        sim.step()
    x, y = sim.object_pos_at_time(8, "robot")[:, [0, 3]].mean(axis=1)  # two opposite corners of the actuator
    assert sum(at(make(sim).render("img", hide_edges=True), x, y)) > sum(rest) + 20


def test_the_camera_follows(sim: EvoSim) -> None:
    viewer = make(sim)
    viewer.track_objects("robot", "box")
    for _ in range(30):
        sim.set_action("robot", np.random.default_rng(1).uniform(0.6, 1.6, 2))
        sim.step()
        viewer.render("img")
    both = np.concatenate([sim.object_pos_at_time(30, name) for name in ("robot", "box")], axis=1)
    middle, half = np.array(viewer.pos), np.array(viewer.view_size) / 2
    assert (np.abs(both - middle[:, None]) < half[:, None]).all()
    assert viewer.view_size[0] / viewer.view_size[1] == pytest.approx(2)
    far = viewer.pos
    viewer.track_objects("robot")
    for _ in range(150):
        sim.step()
        viewer._catch_up()
    assert viewer.pos[0] < far[0] - 3


def test_locks_fix_the_view(sim: EvoSim) -> None:
    viewer = make(sim)
    viewer.track_objects("robot")
    viewer.set_tracking_settings(padding=(2, 2), scale=(0.1, 0.1), lock_y=3, lock_width=24.0)
    for _ in range(20):
        sim.step()
        viewer.render("img")
    assert viewer.pos[1] == 3
    assert viewer.view_size == (24, 12)
    viewer.set_tracking_settings(lock_y=False)
    assert "lock_y" not in viewer._locks


def test_the_lower_layer_renders(sim: EvoSim) -> None:
    viewer, camera = Viewer(sim), Camera(True)
    camera.set_pos(1.5, 0.55)
    camera.set_size(3.0, 1.5)
    camera.set_resolution(*SIZE)
    viewer.render(camera)
    picture = np.array(camera.get_image())
    picture.resize(camera.get_resolution_height(), camera.get_resolution_width(), 3)
    assert np.array_equal(picture, make(sim).render("img"))
    assert viewer.get_debug_window_pos() == [0, 0]
    with pytest.raises(ValueError):
        viewer.render(camera, dont_clear=True)


@pytest.mark.parametrize(
    ("ask", "kind", "words"),
    [
        (
            lambda viewer: viewer.render("image"),
            ValueError,
            "one of screen, human, img, rgb_array, got 'image'",
        ),
        (lambda viewer: viewer.set_pos([1, 2]), TypeError, "tuple of two numbers"),
        (lambda viewer: viewer.set_pos(("left", 2)), ValueError, "pos must hold two finite numbers, got"),
        (lambda viewer: viewer.set_view_size((0, 0)), ValueError, "view_size must hold two finite numbers >= 0.001"),
        (lambda viewer: viewer.set_resolution((600, -1)), ValueError, "resolution must hold two finite numbers >= 1"),
        (lambda viewer: viewer.set_target_rps(1), AssertionError, "lowest target rps is 2"),
        (lambda viewer: viewer.set_tracking_settings(paddin=1), ValueError, "Did you mean 'padding'"),
        (lambda viewer: viewer.set_tracking_settings(padding=3), TypeError, "padding must be a tuple"),
    ],
)
def test_mistakes_are_explained(sim: EvoSim, ask, kind: type[Exception], words: str) -> None:
    with refused(kind, words):
        ask(make(sim))


def test_a_window_needs_a_display(sim: EvoSim, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WARPVOX_WINDOW", raising=False)
    for mode in ("screen", "human"):
        with refused(DisplayError, "WARPVOX_WINDOW=none"):
            make(sim).render(mode)
        with pytest.raises(DisplayError):
            gymnasium.make("Walker-v0", body=np.array([[3, 4]]), render_mode=mode)


def test_scripts_with_windows_run_without_one(sim: EvoSim, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WARPVOX_WINDOW", "none")
    viewer = make(sim)
    assert viewer.render("screen") is None
    viewer.hide_debug_window()
    viewer.show_debug_window()
    viewer.close()
    viewer.close()
    env = gymnasium.make("Walker-v0", body=np.array([[3, 4]]), render_mode="human")
    env.reset()
    env.step(env.action_space.sample())
    env.close()
