"""What a notebook shows: everything says what it is in a line, and has a picture of itself."""

import base64
import html
import re

import numpy as np
import pytest

import warpvox as wv
from warpvox.envs.registry import get_task
from warpvox.envs.worlds import task_world


@pytest.fixture(scope="module")
def run() -> wv.TrainedRun:
    ppo = {"steps": 8, "epochs": 1, "hidden": [8]}
    options = {"device": "cpu", "threads": 1, "eval_interval": 1, "max_iterations": 3}
    return wv.train("Walker-v0", "mini", num_envs=4, ppo=ppo, folder=None, progress=False, **options)


def line(thing: object) -> str:
    text = repr(thing)
    assert "\n" not in text
    assert len(text) < 150
    return text


def test_a_rollout_is_its_player(run: wv.TrainedRun) -> None:
    env = wv.make_vec("Walker-v0", "mini", 20, device="cpu", threads=1)
    assert "num_envs=20, num_designs=1" in line(env)
    rollout = wv.record(env, run.policy, 3)
    assert "Rollout(Walker-v0, 20 environments, 3 steps, returns " in line(rollout)
    (page,) = re.fullmatch(r'<iframe srcdoc="([^"]*)"[^>]*></iframe>', rollout._repr_html_()).groups()
    assert html.unescape(page).startswith("<!doctype html>")


def test_a_run_is_its_curve(run: wv.TrainedRun) -> None:
    assert f"best return {run.best_return:.3f}" in line(run)
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
    assert "Robot(Walker-v0, 5 x 5 cells, " in line(robot)
    assert wv.draw_bodies([body, body]).size[0] > wv.draw_bodies([body]).size[0]
