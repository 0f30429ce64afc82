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
from warpvox.cli.config import load
from warpvox.cli.run_groups import group_runs
from warpvox.design import example_design
from warpvox.runs import Run

FAST = ("threads=1", "device=cpu")


CONFIG = {
    "task": "Walker-v0",
    "design": [[3, 3], [4, 4]],
    "seed": 0,
    "ppo": {"gamma": 0.9, "lam": 0.9},
    "rules": "evogym",
    "physics": {"preset": "evogym", "gravity": 110.0},
    "device": "cpu",
}


def test_runs_that_differ_by_seeds_alone_are_a_group_and_labels_tell_groups_apart() -> None:
    how = {"threads": 4, "logger": "none", "memory_check": False, "preset": None, "name": "x"}
    other = {"gamma": 0.99, "lam": 0.9}
    configs = [
        *(
            CONFIG | {"seed": 1},
            CONFIG | how | {"seed": 2},
            CONFIG | {"ppo": other},
            CONFIG | {"ppo": other, "seed": 5},
        ),
        *(CONFIG | {"rules": "paper", "physics": {"preset": "paper", "gravity": 9.0}}, CONFIG | {"design": [[3]]}),
        {"task": "Walker-v0", "obs": "timed"},  # a robot of the zoo, which says no more
    ]
    groups = group_runs([Run(Path(str(number)), values) for number, values in enumerate(configs)])
    assert [len(group.runs) for group in groups] == [2, 2, 1, 1, 1]
    assert len({group.label for group in groups}) == 5
    assert "rules=paper" in groups[2].label
    several = [Run(Path(folder), CONFIG, Path(folder, name)) for folder in "ab" for name in ("1.pt", "2.pt")]
    found = [(group.label, len(group.runs)) for group in group_runs(several)]
    assert found == [("checkpoint=1.pt", 2), ("checkpoint=2.pt", 2)]


def test_a_label_names_sections_and_bodies_as_they_are_chosen() -> None:
    evogym, parallel = ({"ppo": vars(load("train", [f"ppo={name}"]).ppo)} for name in ("evogym", "parallel"))
    for one, other, labels in (
        (evogym, parallel, ["ppo=evogym", "ppo=parallel"]),
        (
            {"design": example_design("walker").tolist()},
            {"design": example_design("worm").tolist()},
            ["design=walker", "design=worm"],
        ),
        ({}, {"task": "Climber-v0"}, ["Walker-v0", "Climber-v0"]),
    ):
        runs = [Run(Path("a"), CONFIG | one), Run(Path("b"), CONFIG | other)]
        assert [group.label for group in group_runs(runs)] == labels


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


def test_evaluate_over_runs_and_episodes(train: Callable, warpvox: Callable) -> None:
    for gamma in (0.9, 0.99):
        for seed in (1, 2):
            train("max_iterations=1", f"ppo.gamma={gamma}", f"seed={seed}", f"name=g{gamma}_{seed}")
    warpvox("evaluate", "runs=outputs/train/*/*", "episodes=8", "stochastic=true", *FAST)
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
