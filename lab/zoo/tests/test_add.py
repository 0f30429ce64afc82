"""Tests of adding robots to the zoo: recorded facts, and replaced entries."""

import dataclasses
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

import warpvox as wv
from lab.zoo import add as script
from lab.zoo.add import add, command_of, is_better, measured
from warpvox.algos.robots import Robot, read_robot, save_robot

SMALL = {"device": "cpu", "threads": 1, "logger": "none", "progress": False}
PPO = {"steps": 4, "hidden": [8], "epochs": 1}


@pytest.fixture(autouse=True)
def few_episodes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(script, "CHOOSING_EPISODES", 2)
    monkeypatch.setattr(script, "RECORDED_EPISODES", 3)


def train(name: str, design: Any = "mini", **settings: Any) -> Path:
    run = wv.train("Walker-v0", design, folder=Path(name), num_envs=8, max_iterations=1, ppo=PPO, **SMALL, **settings)
    assert run.folder is not None
    return run.folder


def test_a_training_becomes_an_entry_which_only_a_better_one_replaces() -> None:
    run, home = train("run", seed=3), Path("mine")
    assert "wrote mine/Walker-v0.npz" in add(run, home, top=1)
    robot = read_robot("mine/Walker-v0.npz")
    (row,) = wv.evaluate("zoo:mine/Walker-v0.npz", protocol="noise", episodes=3)
    assert robot.about["noise"]["returns"] == [round(value, 9) for value in row.returns]
    assert robot.about["return"] == round(wv.evaluate("zoo:mine/Walker-v0.npz")[0].mean, 9)
    assert {"seed=3", "ppo.steps=4", "max_iterations=1"} < set(shlex.split(robot.about["command"]))
    assert (robot.about["control_steps"], robot.about["config"]["task"]) == (8 * 4, "Walker-v0")

    before = Path("mine/Walker-v0.npz").read_bytes()
    assert "kept" in add(run, home, top=1)
    assert Path("mine/Walker-v0.npz").read_bytes() == before
    save_robot("mine/Walker-v0.npz", dataclasses.replace(wv.zoo("Walker-v0"), about={}))
    assert "kept" in add(run / "model_best.pt", home, top=1)
    save_robot("mine/Walker-v0.npz", dataclasses.replace(robot, policy=None))
    assert "wrote" in add(run / "model_best.pt", home, top=1)


def test_an_entry_has_cost_what_its_pretrained_policy_has() -> None:
    first = train("first")
    second = train("second", seed=1, pretrained=str(first))
    found = script.facts(second)
    (before,) = found["start"]
    assert (found["control_steps"], before["control_steps"]) == (2 * 8 * 4, 8 * 4)
    assert before["command"] == script.facts(first)["command"]
    first.rename("elsewhere")
    found = script.facts(second)
    assert (found["control_steps"], "start" in found) == (None, False)


def test_an_entry_of_a_search_has_cost_what_it_started_from() -> None:
    about = {"command": "warpvox train", "control_steps": 1000, "wall_s": 5.0, "commit": "c0ffee"}
    save_robot("mini.npz", dataclasses.replace(script.robots_of(train("mini"))[0], about=about))
    train("run", design=[[3, 3, 3], [4, 4, 4], [4, 4, 4]])
    fitness = wv.Gaits(gaits=4, rounds=1, passes=0, finalists=1, final_rounds=1, final_passes=0)
    search = wv.RandomDesigns(max_designs=2, population=2)
    training = wv.DesignTraining(envs=8, iterations=1, eval_interval=1, ppo=PPO)
    options = {"device": "cpu", "threads": 1, "progress": False, "folder": Path("search")}
    parts = {"search": search, "fitness": fitness, "training": training, "start": ["zoo:mini.npz", "run"]}
    rows, columns = wv.load_design("mini").shape
    found = wv.codesign("Walker-v0", (rows, columns), **parts, **options)
    assert "wrote" in add(found.folder, Path("mine"), top=2)
    entry = read_robot("mine/Walker-v0.npz").about
    assert [one["control_steps"] for one in entry["start"]] == [8 * 4, 1000]
    assert entry["start"][1]["commit"] == "c0ffee"
    assert entry["control_steps"] == found.summary["steps"] + 1000 + 8 * 4
    assert script.facts(found.folder / "designs" / "0") == script.facts(found.folder)


def test_a_command_has_the_keys_that_are_no_defaults() -> None:
    physics = wv.Physics.preset("paper", gravity=50.0)
    settings = {"task": "Thrower-v0", "rules": "paper", "stop_return": 2.5, "design": "my robots/a, b.json"}
    config = dataclasses.asdict(wv.Training(physics=physics, **settings))
    words = [
        "rules=paper",
        "stop_return=2.5",
        "physics.gravity=50.0",
        'design="my robots/a, b.json"',
        "task=Thrower-v0",
    ]
    assert sorted(shlex.split(command_of(config))) == sorted(["warpvox", "train", *words])


def test_code_that_a_run_names_is_not_imported(tmp_path: Path) -> None:
    run = train("run")
    (tmp_path / "evil.py").write_text("open('marker', 'w')")
    config = yaml.safe_load((run / "config.yaml").read_text())
    (run / "config.yaml").write_text(yaml.safe_dump(config | {"task": "evil.py:T"}, explicit_end=True))
    with pytest.raises(wv.WarpvoxError, match="code"):
        add(run, Path("mine"), top=1)
    assert not Path("marker").exists()


def test_feedback_is_preferred_to_a_gait_that_is_hardly_better() -> None:
    gait, network = wv.zoo("Jumper-v0"), wv.zoo("Pusher-v0")
    assert is_better(network, [9.995], gait, [10.0])
    assert not is_better(gait, [10.0], network, [9.995])
    assert is_better(gait, [10.0], network, [9.98])
    assert not is_better(network, [9.98], gait, [10.0])
    assert not is_better(gait, [10.0], gait, [10.0])


def test_measurements_are_those_of_the_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    robot: Robot = wv.zoo("Balancer-v0")
    found = measured(robot)
    for name in ("return", "returns", "lengths", "seeds"):
        assert found[name] == robot.about[name]
    assert found["noise"]["returns"] == robot.about["noise"]["returns"][:3]
