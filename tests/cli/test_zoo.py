"""``warpvox zoo`` and what takes its robots."""

import dataclasses
import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest
from omegaconf import OmegaConf

from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.codesign.archive import Archive, Finished
from warpvox.algos.codesign.robots import trained
from warpvox.algos.training.loading import load_policy
from warpvox.algos.training.settings import Training
from warpvox.cli.config import load
from warpvox.cli.robot_entries import command_of, find_sources
from warpvox.design import full_connections, load_design
from warpvox.errors import RunError
from warpvox.io.writing import claimed
from warpvox.robots.entry import Robot, read_robot, save_robot, zoo, zoo_tasks
from warpvox.robots.gait import Gait
from warpvox.robots.returns import recorded
from warpvox.runs import read_summary
from warpvox.types import Physics
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


def test_a_run_becomes_an_entry_and_only_a_better_one_replaces_it(warpvox: Callable, train: Callable) -> None:
    run = train("task=Walker-v0", "max_iterations=2", "seed=3")
    first = warpvox("zoo", f"add={run}", "folder=mine")
    assert "no entry before; written to mine/Walker-v0.npz" in first.out
    robot = read_robot("mine/Walker-v0.npz")
    assert robot.about["command"].startswith("warpvox train ")
    assert "ppo.steps=4" in robot.about["command"]
    before = Path("mine/Walker-v0.npz").read_bytes()
    again = warpvox("zoo", f"add={run}", "folder=mine")
    known, figures = robot.choosing_return, f"{robot.robust_return:.6f} under noise, {robot.mean_return:.6f} nominal"
    assert f"{figures}; {known:.6f} in the episodes that choose, the entry has {known:.6f} in them; kept" in again.out
    assert not {*robot.about["noise"]["returns"]} & {*robot.about["chosen_by"]}
    assert Path("mine/Walker-v0.npz").read_bytes() == before
    save_robot("mine/Walker-v0.npz", type(robot)(**{**vars(robot), "about": {**robot.about, "chosen_by": [-100.0]}}))
    assert (
        "the entry has -100.000000 in them; written" in warpvox("zoo", f"add=[{run}/model_best.pt]", "folder=mine").out
    )
    elsewhere = dataclasses.replace(zoo("Walker-v0"), about={"return": 10.6})  # without the episodes that choose
    save_robot("mine/Walker-v0.npz", elsewhere)
    assert "; kept as it is" in warpvox("zoo", f"add={run}", "folder=mine").out
    assert read_robot("mine/Walker-v0.npz").sha256 == zoo("Walker-v0").sha256
    Path("mine/Jumper-v0.npz").write_bytes(b"cut")
    listed = warpvox("zoo", "folder=mine").out
    assert "left out: mine/Jumper-v0.npz" in " ".join(listed.split())
    assert "Walker-v0" in listed
    save_robot("mine/Jumper-v0.npz", dataclasses.replace(robot, task="Kick-v0"))
    warpvox("evaluate", "zoo=[mine/Jumper-v0.npz]", fails="The robot is for Kick-v0, a task of your own: name its code")
    Path("empty").mkdir()
    warpvox("zoo", f"add=[empty,{run}]", "folder=other", fails="1 of 2 could not be added")
    assert Path("other/Walker-v0.npz").is_file()
    warpvox("zoo", "add=nowhere", "folder=other", fails="There is no design search")
    warpvox("zoo", f"add={run}", "task=Climber-v0", "folder=other", fails="is of Walker-v0, got task=Climber-v0")
    warpvox("zoo", f"add={run}", "folder=mine/Walker-v0.npz", fails="Walker-v0.npz is a file, not a folder.")
    config = OmegaConf.load(run / "config.yaml")
    config.design = {"robot": config.design, "mate": config.design}
    (run / "config.yaml").write_text(OmegaConf.to_yaml(config) + "...\n")
    warpvox("zoo", f"add={run}", "folder=other", fails="the zoo has single robots")
    save_robot("mine/Walker-v0.npz", robot)
    assert zoo("mine/Walker-v0.npz").sha256 == robot.sha256
    warpvox("evaluate", "zoo=[mine/Walker-v0.npz]")
    assert summary("evaluate/*/*/summary.json")["mean_return"] == pytest.approx(robot.mean_return, abs=1e-9)


def test_an_entry_waits_until_another_process_has_written_its_own(
    warpvox: Callable, train: Callable, monkeypatch
) -> None:
    run, waits = train("task=Walker-v0", "max_iterations=1"), Event()
    warpvox("zoo", f"add={run}", "folder=mine")
    robot = read_robot("mine/Walker-v0.npz")
    better = dataclasses.replace(robot, about={**robot.about, "chosen_by": [100.0]})

    def evaluated(*_: object) -> object:
        waits.set()
        return robot

    def another() -> None:
        with claimed(Path("mine")):
            begun.set()
            waits.wait()
            time.sleep(0.2)
            save_robot("mine/Walker-v0.npz", better)

    begun, other = Event(), Thread(target=another)
    monkeypatch.setattr("warpvox.cli.robot_entries.recorded", evaluated)
    other.start()
    begun.wait()
    assert "the entry has 100.000000 in them; kept" in warpvox("zoo", f"add={run}", "folder=mine").out
    other.join()
    assert read_robot("mine/Walker-v0.npz").choosing_return == 100


def test_a_source_with_a_number_that_json_lacks_is_not_evaluated(warpvox: Callable, train: Callable) -> None:
    folder = train()
    config = folder / "config.yaml"
    config.write_text(re.sub("(?m)^seed: .*$", "seed: .inf", config.read_text()))
    outcome = warpvox("zoo", f"add=[{folder}]", "folder=mine", code=2)
    assert "JSON lacks" in outcome.err
    assert not list(Path("mine").glob("*.npz"))


def test_an_entry_has_cost_what_its_pretrained_policy_has(warpvox: Callable, train: Callable) -> None:
    first = train("task=Walker-v0", "max_iterations=2")
    second = train("task=Walker-v0", "max_iterations=1", f"pretrained={first}")
    warpvox("zoo", f"add={second}", "folder=mine")
    about = read_robot("mine/Walker-v0.npz").about
    steps = [read_summary(run)["steps"] for run in (first, second)]
    assert about["control_steps"] == sum(steps)
    (before,) = about["start"]
    assert (before["control_steps"], "max_iterations=2" in before["command"]) == (steps[0], True)
    assert about["command"].endswith(f"pretrained=Walker-v0/{first.name}/model_best.pt")
    first.rename("elsewhere")
    warpvox("zoo", f"add={second}", "folder=other")
    about = read_robot("other/Walker-v0.npz").about
    assert (about["control_steps"], "start" in about) == (None, False)


def test_a_gait_is_listed_shown_played_and_loaded(warpvox: Callable) -> None:
    body, wave = load_design("mini"), np.linspace(0, 2 * np.pi, 16).reshape(2, 8)
    gait = Gait([0, 10], [20, 12], np.full((2, 8), 0.9), wave, np.zeros((2, 8)))
    robot = Robot("Balancer-v0", body, full_connections(body).T, gait)
    robot = recorded(robot, {"command": "none", "control_steps": 1})
    save_robot("mine/Balancer-v0.npz", robot)
    assert "○" in warpvox("zoo", "folder=mine").out.split("return: ")[0]
    shown = warpvox("zoo", "folder=mine", "task=Balancer-v0")
    assert "gait, open loop: 51 parameters, 2 stages" in shown.out, shown.err
    warpvox("play", "zoo=mine/Balancer-v0.npz", "window=off", "export=[]")
    assert round(summary("play/Balancer-v0/*/summary.json")["mean_return"], 9) == robot.mean_return
    policy = load_policy("zoo:mine/Balancer-v0.npz")
    assert (policy.metadata["obs"], policy.num_actions) == ("timed", 8)


@pytest.mark.parametrize(
    "line",
    [
        "warpvox codesign search=bo task=Hurdler-v0 seed=1 training.rungs=[0.2,0.5] training.keep=0.4",
        "warpvox codesign evaluation=gaits fitness=robust evaluation.episodes=16",
        "warpvox train ppo=evogym task=Thrower-v0 design=[[3,3],[4,4]] stop_return=2.5",
        "warpvox train rules=paper physics.gravity=50 ppo.rnn={rnn_type:gru,rnn_num_layers:2} memory_check=false",
        "warpvox codesign evaluation=shared evaluation.network={width:8,heads:null} start=[zoo:Thrower-v0,walker]",
    ],
)
def test_the_command_of_a_configuration_is_the_shortest(line: str) -> None:
    command, *words = line.split()[1:]
    told = command_of(command, dataclasses.asdict(load(command, words)))
    assert sorted(told.split()) == sorted(line.split())


def test_of_all_constants_of_a_run_its_command_has_those_that_differ() -> None:
    for preset, words in (("evogym", []), ("paper", ["physics.preset=paper"])):
        config = dataclasses.asdict(Training(physics=Physics.preset(preset, gravity=50.0)))
        assert command_of("train", config).split()[2:] == [*words, "physics.gravity=50"]
    robot = command_of("train", dataclasses.asdict(Training(design="my robots/a, b.json"))).removeprefix(
        "warpvox train "
    )
    assert load("train", [robot]).design == "my robots/a, b.json"


def test_a_source_is_a_name_a_pattern_or_the_runs_of_a_sweep(tmp_path: Path) -> None:
    runs, sweep = [tmp_path / "train" / "Walker-v0" / name for name in "ab"], tmp_path / "train" / "sweep_1"
    for folder in (*runs, sweep):
        folder.mkdir(parents=True)
    for number, run in enumerate(runs):
        (sweep / f"run_{number}.json").write_text(json.dumps({"folder": str(run)}))
    assert find_sources([str(run) for run in runs]) == runs
    assert find_sources([str(runs[0].parent / "*"), str(runs[0])]) == runs
    assert find_sources([str(sweep)]) == find_sources([f"{sweep}.csv"])
    assert {path.resolve() for path in find_sources([str(sweep)])} == {run.resolve() for run in runs}
    with pytest.raises(RunError, match="no design search, run or checkpoint at"):
        find_sources([str(tmp_path / "c*")])


def test_designs_that_were_only_compared_give_no_entry(tmp_path: Path) -> None:
    rows = [("mutation", 9.0, None), ("finalist", 1.0, "a.pt"), ("finalist", 2.0, "b.pt"), ("random", 8.0, "c.pt")]
    bodies = [np.array([[3, kind]], np.int8) for kind in range(4)]
    with Archive.create(tmp_path / "archive.sqlite", {}) as archive:
        archive.propose([Candidate(k, bodies[k], (), rows[k][0]) for k in range(4)], seed=0)
        archive.finish([Finished(k, Outcome(rows[k][1]), rows[k][2]) for k in (0, 3)])
        assert [record.policy for record in trained(archive)] == ["c.pt"]
        archive.finish([Finished(k, Outcome(rows[k][1]), rows[k][2]) for k in (1, 2)])
        assert [record.policy for record in trained(archive)] == ["b.pt", "a.pt"]
