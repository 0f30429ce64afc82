"""Policies are evaluated with intervals that mean what they say; play says where episodes are one and the same."""

import csv
import json
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from tiny import tiny

from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.checkpoints.policy import policy_of
from warpvox.algos.find import find_runs
from warpvox.algos.statistics import difference, mean_interval
from warpvox.algos.training.playing import SampledPolicy
from warpvox.cli.run_groups import group_runs
from warpvox.runs import Run

FAST = ("threads=1", "device=cpu")


def config(**changes: object) -> dict:
    base = {
        "task": "Walker-v0",
        "design": [[3, 3], [4, 4]],
        "seed": 0,
        "ppo": {"gamma": 0.9, "lam": 0.9},
        "rules": "evogym",
    }
    return {**base, "physics": {"preset": "evogym", "gravity": 110.0}, "device": "cpu", **changes}


def runs(*configs: dict) -> list[Run]:
    return [Run(Path(str(number)), values) for number, values in enumerate(configs)]


def test_groups_differ_by_all_but_the_seed() -> None:
    other = {"gamma": 0.99, "lam": 0.9}
    how = {"threads": 4, "logger": "none", "memory_check": False, "preset": None}
    same = (config(seed=1), config(seed=2, name="x", **how))
    groups = group_runs(runs(*same, config(ppo=other), config(seed=5, ppo=other), config(rules="paper")))
    assert [len(group.runs) for group in groups] == [2, 2, 1]
    assert [group.label for group in groups] == [
        "ppo.gamma=0.9, rules=evogym",
        "ppo.gamma=0.99, rules=evogym",
        "ppo.gamma=0.9, rules=paper",
    ]
    (same,) = group_runs(runs(config(device="cuda:0"), config(device="cuda:1", seed=3)))
    assert (same.label, len(same.runs)) == ("Walker-v0", 2)
    several = [Run(Path(folder), config(), Path(folder, name)) for folder in "ab" for name in ("1.pt", "2.pt")]
    found = [(group.label, len(group.runs)) for group in group_runs(several)]
    assert found == [("checkpoint=1.pt", 2), ("checkpoint=2.pt", 2)]


def test_labels_name_presets_designs_and_tasks() -> None:
    from warpvox.cli.config import load
    from warpvox.design import example_design

    evogym, parallel = ({"ppo": vars(load("train", [f"ppo={name}"]).ppo)} for name in ("evogym", "parallel"))
    assert [group.label for group in group_runs(runs(config(**evogym), config(**parallel)))] == [
        "ppo=evogym", "ppo=parallel"
    ]  # fmt: skip
    groups = group_runs(runs(config(design=example_design("walker").tolist()), config()))
    assert groups[0].label == "design=walker"
    assert groups[1].label.startswith("design=2x2 ")
    paper = config(rules="paper", physics={"preset": "paper", "gravity": 9.0})
    assert [group.label for group in group_runs(runs(config(), paper))] == ["rules=evogym", "rules=paper"]
    assert [group.label for group in group_runs(runs(config(), config(task="Climber-v0")))] == [
        "Walker-v0",
        "Climber-v0",
    ]


def test_a_label_leaves_out_what_a_robot_of_the_zoo_does_not_say() -> None:
    known = {"task": "Walker-v0", "obs": "timed"}
    labels = [group.label for group in group_runs(runs(config(obs="task", seed=1), known))]
    assert all("null" not in label for label in labels)
    assert "obs=timed" in labels[1]


def test_a_label_begins_with_what_tells_the_most_runs_apart() -> None:
    one = config(policy="net.py:Own", network="a", obs="timed", ppo={"gamma": 0.7, "lam": 0.9})
    others = [config(policy="mlp", network=None, obs="task", ppo={"gamma": gamma, "lam": 0.9}) for gamma in (0.8, 0.9)]
    labels = [group.label for group in group_runs(runs(*others, one, others[0] | {"num_envs": 8}))]
    assert [label.split(", ")[0] for label in labels] == [
        "ppo.gamma=0.8",
        "ppo.gamma=0.9",
        "ppo.gamma=0.7",
        "ppo.gamma=0.8",
    ]
    assert len(set(labels)) == 4
    assert "#" not in "".join(labels)


def test_sampled_actions_have_the_deviation_of_training(train: Callable) -> None:
    folder = train("max_iterations=1", "ppo.init_std=0.2")
    file = folder / "model_1.pt"
    content = load_checkpoint(file)
    policy = policy_of(content, file).double()
    actor = content["actor_state_dict"]
    obs = torch.zeros(4000, policy.num_obs)
    actions = SampledPolicy(policy, actor, seed=1)(obs)
    assert torch.equal(actions, SampledPolicy(policy, actor, seed=1)(obs))
    assert not torch.equal(actions, SampledPolicy(policy, actor, seed=2)(obs))
    mean, spread = policy(obs)[0], policy.spec.action_scale * actor["distribution.log_std_param"].exp()
    inside = (mean - 1.1).abs() < 0.5 - 3 * spread  # of the others the bounds of actions cut something off
    assert inside.any()
    assert torch.allclose(actions.std(0)[inside], spread[inside], rtol=0.1)
    assert torch.allclose(actions.mean(0)[inside], mean[inside], atol=0.01)


def test_evaluate_over_runs_and_episodes(train: Callable, warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    for gamma in (0.9, 0.99):
        for seed in (1, 2):
            train("max_iterations=1", f"ppo.gamma={gamma}", f"seed={seed}", f"name=g{gamma}_{seed}")
    outcome = warpvox("evaluate", "runs=outputs/train/*/*", "episodes=8", "stochastic=true", *FAST)
    (folder,) = Path("outputs/evaluate/Walker-v0").iterdir()
    summary = json.loads((folder / "summary.json").read_text())
    means = {}
    for run in summary["runs"]:
        assert len(set(run["returns"])) > 1
        interval = mean_interval(run["returns"])
        assert (run["mean"], run["low"], run["high"], run["n"]) == pytest.approx(
            (interval.mean, interval.low, interval.high, 8)
        )
        means.setdefault(run["settings"], []).append(run["mean"])
    assert set(means) == {"ppo.gamma=0.9", "ppo.gamma=0.99"}
    for group in summary["groups"]:
        assert (group["over"], group["n"]) == ("runs", 2)
        assert group["low"] == pytest.approx(mean_interval(means[group["settings"]]).low)
    (pair,) = summary["comparisons"]
    expected = difference(means[pair["first"]], means[pair["second"]])
    assert (pair["difference"], pair["low"]) == pytest.approx((expected.mean, expected.low))
    assert "Welch's 95 % interval" in outcome.out
    assert "nominal" in outcome.out
    monkeypatch.setenv("COLUMNS", "70")  # what all rows share is left out
    narrow = warpvox("evaluate", "runs=outputs/train/*/*", "episodes=8", "stochastic=true", *FAST).out
    assert "nominal" not in narrow
    assert f"{interval.mean:.3f}" in narrow
    with (folder / "runs.csv").open(encoding="utf-8", newline="") as text:
        assert [float(row["mean"]) for row in csv.DictReader(text)] == pytest.approx(
            [r["mean"] for r in summary["runs"]]
        )


def test_a_deterministic_policy_in_a_task_without_chance_has_one_episode(train: Callable, warpvox: Callable) -> None:
    folder = train("max_iterations=2")
    outcome = warpvox("evaluate", f"runs={folder}", "episodes=8", *FAST)
    assert "The 8 episodes of all runs are one" in outcome.out
    (result,) = Path("outputs/evaluate/Walker-v0").iterdir()
    (run,) = json.loads((result / "summary.json").read_text())["runs"]
    assert (run["n"], run["low"]) == (1, None)
    assert len(run["returns"]) == 8
    assert math.isfinite(run["mean"])
    young = Path(shutil.copytree(folder, "outputs/train/Walker-v0/young"))
    for checkpoint in young.glob("model_*.pt"):
        checkpoint.unlink()
    both = warpvox("evaluate", "runs=outputs/train/Walker-v0/*", "episodes=1", *FAST)
    assert "left out: outputs/train/Walker-v0/young: The run" in both.out
    assert f"{run['mean']:.3f}" in both.out
    warpvox("evaluate", "runs=outputs/train/Walker-v0/young", *FAST, fails="no checkpoint yet")
    played = warpvox("play", f"run={folder}", "num_envs=8", "steps=3", "export=[]", "window=off", *FAST)
    assert "the task draws nothing at random" in played.out
    assert "deterministic" in played.out
    for words, title in (
        (["num_envs=1"], "deterministic"),
        (["num_envs=8", "stochastic=true"], "sampled actions"),
        (["num_envs=8", "protocol=noise"], "protocol noise"),
    ):
        played = warpvox("play", f"run={folder}", *words, "steps=3", "export=[]", "window=off", *FAST)
        assert "draws nothing" not in played.out
        assert f"Walker-v0, {title}" in played.out
    played = warpvox("play", f"run={folder}", "num_envs=1", "protocol=robust", "steps=3", "export=[]", *FAST)
    rows = [line.split()[1] for line in played.out.splitlines() if line.startswith("│")]
    assert rows == ["nominal", "noise", "sticky", "start", "sensors", "mean"]


def test_patterns_match_checkpoints_of_runs(tmp_path: Path) -> None:
    for name, text in {"a": "task: Walker-v0", "b": "task: Jumper-v0", "no_run": "other: 1"}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.yaml").write_text(f"{text}\ndesign: walker\nppo: {{}}\n...\n")
        for file in ("model_2.pt", "model_best.pt", "state.pt", "metrics.csv"):
            (tmp_path / name / file).touch()
    found = find_runs([f"{tmp_path}/*/model_best.pt", f"{tmp_path}/b/*"], "")
    names = [(run.config["task"], run.checkpoint and run.checkpoint.name) for run in found]
    assert names == [("Walker-v0", "model_best.pt"), ("Jumper-v0", "model_best.pt"), ("Jumper-v0", "model_2.pt")]


def test_all_bodies_of_a_run_have_as_many_episodes(train: Callable, warpvox: Callable) -> None:
    folder = train("max_iterations=1", "design=[walker,worm]")
    fails = "2 bodies need a multiple of that of episodes; got 3"
    warpvox("evaluate", f"runs={folder}", "episodes=3", *FAST, fails=fails)


def test_what_evaluate_refuses(warpvox: Callable, tmp_path: Path) -> None:
    for words, phrase in {
        (): "no run",
        ("runs=[]",): "runs=[] names none",
        ("runs='nothing*'",): "matches nothing",
        ("runs=latest", "zoo=Walker-v0"): "no run",
        ("task=Walker-v0",): "a run knows its task",
        ("level=1",): "at most 0.9999",
        ("episodes=0",): "at least 1",
    }.items():
        warpvox("evaluate", *words, fails=phrase)
    assert list(tmp_path.iterdir()) == []


def test_robots_of_different_tasks_are_not_compared(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warpvox.cli.commands.evaluate.zoo_tasks", lambda: ["AreaMaximizer-v0", "AreaMinimizer-v0"])
    outcome = warpvox("evaluate", "zoo=all", "device=cpu", "threads=1", "episodes=1")
    assert outcome.code == 0, outcome.err
    assert "mean return" in outcome.out
    assert "differences of mean returns" not in outcome.out


def test_design_searches_that_match_a_pattern_are_told_apart(warpvox: Callable) -> None:
    for seed in range(2):
        warpvox(*tiny("codesign", f"seed={seed}", f"name=s{seed}"))
    outcome = warpvox("evaluate", "runs=[outputs/codesign/*/*]", "episodes=1", *FAST)
    assert all(re.search(rf"_s{seed}/\d+ ", outcome.out) for seed in range(2)), outcome.out
    warpvox("evaluate", "runs=[outputs/none*]", *FAST, fails="matches outputs/none")
