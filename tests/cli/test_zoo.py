"""``warpvox zoo`` and what takes its robots."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from warpvox.algos.robots.entry import Robot, save_robot, zoo, zoo_tasks
from warpvox.algos.robots.episodes import judge
from warpvox.algos.robots.policies import gait_policy
from warpvox.algos.training.loading import load_policy
from warpvox.design import full_connections, load_design
from warpvox.view.rollout import Rollout

TASK = min(zoo_tasks(), key=lambda task: sum(zoo(task).about["lengths"]))


def summary(pattern: str) -> dict:
    (file,) = Path("outputs").glob(pattern)
    return json.loads(file.read_text())


def test_the_list_names_every_robot(warpvox: Callable) -> None:
    outcome = warpvox("zoo")
    for task in zoo_tasks():
        assert f"{zoo(task).mean_return:.3f}" in outcome.out
        assert task in outcome.out


def test_one_is_shown_with_its_command(warpvox: Callable) -> None:
    outcome = warpvox("zoo", f"task={TASK}")
    words = "".join(outcome.out.split())
    for told in (zoo(TASK).about["command"], zoo(TASK).sha256, str(zoo(TASK).mean_return)):
        assert "".join(told.split()) in words
    warpvox("zoo", f"task={TASK.lower()}x", fails="Did you mean")
    warpvox("zoo", "folder=typo", fails="typo has no robots, which are files TASK.npz.")


def test_a_zoo_of_ones_own_lists_what_can_be_read(warpvox: Callable) -> None:
    robot = dataclasses.replace(zoo(TASK), task="Kick-v0")
    save_robot("mine/Kick-v0.npz", robot)
    Path("mine/Jumper-v0.npz").write_bytes(b"cut")
    listed = warpvox("zoo", "folder=mine").out
    assert "left out: mine/Jumper-v0.npz" in " ".join(listed.split())
    assert "Kick-v0" in listed
    assert robot.sha256 in warpvox("zoo", "folder=mine", "Kick-v0").out
    warpvox("evaluate", "zoo=[mine/Kick-v0.npz]", fails="a task of your own: name its code")


def test_it_is_played_with_the_recorded_return(warpvox: Callable) -> None:
    warpvox("play", f"zoo={TASK}", "window=off", "export=[]")
    found = summary(f"play/{TASK}/*/summary.json")
    assert round(found["mean_return"], 9) == zoo(TASK).mean_return
    (file,) = Path("outputs").glob(f"play/{TASK}/*/rollout.npz")
    assert Rollout.load(file).metadata["arithmetic"] == "exact"


def test_keys_that_do_not_go_with_a_robot_are_refused(warpvox: Callable) -> None:
    warpvox("play", f"zoo={TASK}", "agent=sine", fails="design=zoo:TASK")
    warpvox("play", f"zoo={TASK}", "stochastic=true", "window=off", fails="stochastic")
    warpvox("export", f"zoo={TASK}", "rollout=x.npz", fails="zoo cannot be given")
    assert not Path("outputs").exists()


def test_a_gait_is_listed_shown_played_and_loaded(warpvox: Callable) -> None:
    body, wave = load_design("mini"), np.linspace(0, 2 * np.pi, 16).reshape(2, 8)
    gait = gait_policy(body, [0, 10], [20, 12], np.full((2, 8), 0.9), wave, np.zeros((2, 8)))
    robot = Robot("Balancer-v0", body, full_connections(body).T, gait)
    save_robot("mine/Balancer-v0.npz", robot)
    assert "○" in warpvox("zoo", "folder=mine").out.split("return: ")[0]
    shown = warpvox("zoo", "folder=mine", "task=Balancer-v0")
    assert "gait, open loop: 51 parameters, 2 stages" in shown.out, shown.err
    warpvox("play", "zoo=mine/Balancer-v0.npz", "window=off", "export=[]")
    assert round(summary("play/Balancer-v0/*/summary.json")["mean_return"], 9) == judge(robot).mean_return
    policy = load_policy("zoo:mine/Balancer-v0.npz")
    assert (policy.metadata["obs"], policy.num_actions) == ("timed", 8)
