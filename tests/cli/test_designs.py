"""Many bodies for one policy on the command line: what can be named, and a run from training to evaluation."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from refusals import refused

import warpvox as wv
from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.training.bodies import Bodies, load_bodies, read_bodies, training_bodies
from warpvox.cli.commands import evaluate, play
from warpvox.cli.config import load
from warpvox.design import full_connections, load_design, save_design
from warpvox.errors import ConfigError, DesignError
from warpvox.io.console import Console
from warpvox.view.rollout import Rollout

SMALL = {"steps": 4, "minibatches": 1, "epochs": 1}


def config(*words: str):
    return load("train", [f"{word}" for word in words])


def judged(settings):
    return training_bodies(settings).judged


def test_bodies_are_named_in_many_ways(tmp_path: Path) -> None:
    drawn = read_bodies("random:5:3x4", 0, "designs")
    assert [body.shape for body in drawn] == [(3, 4)] * 5
    assert len({body.tobytes() for body in drawn}) == 5
    assert np.array_equal(read_bodies("random:5:3x4", 0, "designs")[4], drawn[4])
    assert read_bodies("random:2", 0, "designs")[0].shape == (5, 5)
    for number, body in enumerate(drawn):
        save_design(tmp_path / f"{number}.json", body)
    assert all(np.array_equal(a, b) for a, b in zip(read_bodies(str(tmp_path), 0, "designs"), drawn, strict=True))
    assert len(read_bodies(["walker", "worm"], 0, "designs")) == 2
    assert all(np.array_equal(a, b) for a, b in zip(load_bodies(drawn, 0), drawn, strict=True))


def test_folders_of_other_tools_hold_many_bodies(tmp_path: Path) -> None:
    drawn = read_bodies("random:3:3x4", 0, "designs")
    for number, body in enumerate(drawn):
        apart, generation = tmp_path / "robots" / str(number), tmp_path / "generation_0" / "structure"
        apart.mkdir(parents=True)
        generation.mkdir(parents=True, exist_ok=True)
        np.save(apart / "body.npy", body)
        np.save(apart / "connections.npy", full_connections(body).T)
        np.savez(generation / f"{number}.npz", body, full_connections(body).T)
    for folder in ("robots", "generation_0", "generation_0/structure"):
        read = read_bodies(str(tmp_path / folder), 0, "designs")
        assert [body.tolist() for body in read] == [body.tolist() for body in drawn]


@pytest.mark.parametrize(
    ("spec", "error", "says"),
    [
        ("random:0", ConfigError, "1 to 1,000,000 random bodies, got 0"),
        ("random:4:5", ConfigError, "random:64 or random:64:5x7"),
        ("walkr", DesignError, "Did you mean 'walker'"),
        ([{"a": "walker", "b": "walker"}], ConfigError, "bodies of one robot"),
        (".", DesignError, "neither a design search nor a folder of designs"),
    ],
)
def test_mistakes_are_explained(spec: object, error: type, says: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with refused(error, says):
        read_bodies(spec, 0, "designs")


def test_held_out_bodies_are_those_of_one_seed_that_the_docs_name() -> None:
    held_out = judged(config("designs=random:4:4x5", "designs.held_out=random:6:4x5", "seed=7"))
    assert all(np.array_equal(*pair) for pair in zip(held_out, read_bodies("random:6:4x5", 1000003, "x"), strict=True))


def test_training_never_meets_what_is_held_out() -> None:
    given = config("designs=random:40:2x2", "designs.held_out=random:20:2x2")
    assert given.designs.bodies == "random:40:2x2"
    held_out = {body.tobytes() for body in judged(given)}
    assert len(held_out) == 20
    assert not held_out & {body.tobytes() for body in training_bodies(given).trained}
    # the same whatever the seed of the training
    assert held_out == {body.tobytes() for body in judged(config("designs=random:40:2x2", "seed=7",
        "designs.held_out=random:20:2x2"))}  # fmt: skip


def test_bodies_that_one_names_are_what_the_policy_is_judged_on(train: Callable[..., Path], warpvox: Callable) -> None:
    run = train("designs=[mini,worm]", "max_iterations=2", "eval_interval=1", "episodes=1")
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    cells = [load_design(name).tolist() for name in ("mini", "worm")]
    assert summary["designs"] == {"bodies": cells, "refresh": "none"}
    assert summary["evaluated_on"] == "the 2 bodies trained on"
    assert "design" not in summary
    rows = list(csv.DictReader((run / "bodies.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["cells"] for row in rows] == ["/".join("".join(map(str, row)) for row in body) for body in cells]
    warpvox("play", f"run={run}", "designs=worm", "num_envs=1", "window=off", "device=cpu", "threads=1")
    for words, count in ((["designs.refresh=new"], 32), (["designs.held_out=[mini]"], 1)):
        assert len(judged(config("designs=[mini,worm]", *words))) == count


def test_more_bodies_than_environments_have_to_be_exchanged() -> None:
    given = config("designs=random:40:3x3", "num_envs=8")
    with pytest.raises(ConfigError):
        Bodies.of(training_bodies(given), given, 0)


def test_a_run_over_many_bodies_is_trained_evaluated_and_played(tmp_path: Path) -> None:
    designs = {"bodies": "random:6:3x3", "refresh": "random", "held_out": "random:3:3x3"}
    options = {"num_envs": 8, "max_iterations": 2, "eval_interval": 1, "device": "cpu", "lanes": 8, "threads": 1}
    run = wv.train(**options, designs=designs, ppo=SMALL, policy="grid", output_dir=tmp_path, progress=False)
    rows = list(csv.DictReader((run.folder / "held_out.csv").read_text(encoding="utf-8").splitlines()))
    assert [len(row["cells"].replace("/", "")) for row in rows] == [9, 9, 9]
    last = [float(row["last_return"]) for row in rows]
    assert run.metrics["eval_return"][-1] == pytest.approx(sum(last) / 3, rel=1e-4)
    assert run.metrics["eval_q50"][-1] == pytest.approx(sorted(last)[1], rel=1e-4)
    about = load_checkpoint(run.folder / "model_best.pt")["trained_on"]
    assert about["designs"] == designs
    words = [f"output_dir={tmp_path}", "device=cpu", "threads=1"]
    console = Console(quiet=True)
    folder = evaluate.run(load("evaluate", [*words, f"runs={run.folder}", "checkpoint=last"]), [], console)
    found = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert found["mean_return"] == pytest.approx(sum(last) / 3, rel=1e-4)
    for protocol in "nominal", "noise":  # episodes with a body say less about the policy than other bodies do
        given = [*words, f"runs={run.folder}", "designs=random:5:3x3", f"protocol={protocol}"]
        folder = evaluate.run(load("evaluate", given), [], console)
        (found,) = json.loads((folder / "summary.json").read_text(encoding="utf-8"))["runs"]
        assert (len(found["returns"]), found["n"]) == (30, 5)
    assert Image.open(run.folder / "held_out.png").size[0] > 3 * 60
    played = play.run(
        load("play", [*words, f"run={run.folder}", "num_envs=3", "steps=3", "export=[png,html]"]), [], console
    )
    shown = json.loads((played / "summary.json").read_text(encoding="utf-8"))
    assert shown["returns"] == sorted(shown["returns"], reverse=True)
    assert sorted(shown["environments"]) == ["body 0", "body 1", "body 2"]
    rollout = Rollout.load(played / "rollout.npz")
    assert rollout.names == shown["environments"]
    for env, name in enumerate(rollout.names):  # every body under its number in held_out.csv
        robot = next(obj for obj in rollout.scene(env).objects if obj.name == "robot")
        assert "/".join("".join(map(str, row)) for row in robot.grid.tolist()) == rows[int(name[5:])]["cells"]
    assert '"name":"body 2"' in (played / "rollout.html").read_text(encoding="utf-8")
    with_body = [*words, f"run={run.folder}", "design=[[3,3],[4,0]]", "num_envs=1", "steps=3", "export=[]"]
    assert (play.run(load("play", with_body), [], console) / "rollout.npz").is_file()
    policy, options = wv.load_policy(run.folder), {"design": [[3, 3], [4, 0]], "episodes": 1, "threads": 1}
    alone, of_run = wv.evaluate(policy, "Walker-v0", **options), wv.evaluate(run, **options)
    assert alone[0].mean == of_run[0].mean  # of a body that is smaller than the grid
    table = run.folder / "held_out.csv"
    table.write_text(table.read_text().replace(f"1,{rows[1]['last_return']},{rows[1]['best_return']}", "1,0,99"))
    wv.train(resume=run.folder / "model_2.pt", max_iterations=3, progress=False)
    resumed = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    assert resumed[1]["best_return"] == "99"
    assert resumed[0]["best_return"] == max(resumed[0]["last_return"], rows[0]["best_return"], key=float)
