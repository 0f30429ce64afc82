"""Training and policies from Python: what the command does, in a process of one's own."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import warpvox as wv
from warpvox.algos.checkpoints.files import load_checkpoint, load_controller
from warpvox.algos.codesign.stored_policies import policy_sha256

KEYS = {"design": "mini", "num_envs": 8, "threads": 1, "device": "cpu", "max_iterations": 2, "eval_interval": 1}
PPO = {"steps": 4, "hidden": [8], "epochs": 1}


def weights(folder: Path) -> str:
    return policy_sha256(load_checkpoint(folder / "model_2.pt")["actor_state_dict"])


def test_it_trains_as_the_command_does(train: Callable[..., Path], capfd: pytest.CaptureFixture) -> None:
    commanded = train("max_iterations=2", "eval_interval=1", "seed=5")
    threads, state = torch.get_num_threads(), torch.get_rng_state()
    capfd.readouterr()
    ppo = {"steps": 4, "hidden": (8,), "epochs": np.int64(1)}
    run = wv.train("Walker-v0", **KEYS, seed=5, ppo=ppo, progress=False)
    assert capfd.readouterr().out == ""
    assert (torch.get_num_threads(), run.summary["status"]) == (threads, "done")
    assert torch.equal(torch.get_rng_state(), state)
    assert run.folder.parent == Path("outputs/train/Walker-v0")
    assert weights(run.folder) == weights(commanded)
    metrics = run.metrics
    assert metrics["iteration"].tolist() == [1, 2]
    assert run.best_return == pytest.approx(metrics["eval_return"].max(), rel=1e-6)  # the table has nine digits
    env = wv.make_vec("Walker-v0", body="mini", num_envs=2, device="cpu", threads=1)
    env.step(run.policy(env.reset()[0]))
    resumed = wv.train(resume=run.folder, max_iterations=3, progress=False)
    assert (resumed.folder, resumed.summary["iterations"]) == (run.folder, 3)


def test_values_of_python_arrive_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    body = wv.example_design("mini")
    place = tmp_path / "with 'quotes', = and [brackets]"
    run = wv.train(
        **(KEYS | {"design": body, "max_iterations": 1}), output_dir=place, name=None, stop_return=-1.5, ppo=PPO,
        physics={"friction": 0.25}, nan_guard="on", cuda_graph=False, progress=False,
    )  # fmt: skip
    assert run.folder.is_relative_to(place)
    policy = wv.load_policy(output_dir=place)
    assert policy.metadata["design"] == body.tolist()
    assert "friction: 0.25" in (run.folder / "config.yaml").read_text()


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"tsk": "Walker-v0"}, "Unknown key 'tsk'. Did you mean 'task'"),
        ({"ppo": {"step": 4}}, r"Unknown key 'ppo.step'\. Did you mean 'ppo.steps'"),
        ({"ppo": "evogim"}, "Did you mean 'evogym'"),
        ({"num_envs": "many"}, "num_envs='many': Value 'many'"),
        ({"design": object()}, "design cannot be a object"),
        ({"task": "Waker-v0"}, "Did you mean 'Walker-v0'"),
    ],
)
def test_mistakes_are_named_and_nothing_is_written(
    keys: dict, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(wv.WarpvoxError, match=words):
        wv.train(**keys, progress=False)
    with pytest.raises(wv.TaskError, match="Did you mean 'Walker-v0'"):
        wv.train("Waker-v0", progress=False)
    assert list(tmp_path.iterdir()) == []


def test_it_works_outside_the_main_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    runs: list[wv.TrainedRun] = []
    thread = threading.Thread(target=lambda: runs.append(wv.train(**KEYS, ppo=PPO, progress=False)))
    thread.start()
    thread.join()
    assert runs[0].summary["status"] == "done"


def test_policies_are_loaded_by_whatever_names_them(train: Callable[..., Path], warpvox: Callable) -> None:
    folder = train("max_iterations=2", "eval_interval=1")
    env = wv.make_vec("Walker-v0", body="mini", num_envs=3, device="cpu", threads=1)
    obs = env.reset()[0]
    for source, file in (
        ("latest", "model_best.pt"),
        (folder, "model_best.pt"),
        (str(folder / "model_2.pt"), "model_2.pt"),
    ):
        policy = wv.load_policy(source)
        torch.testing.assert_close(policy(obs), load_controller(folder / file)(obs), rtol=0, atol=1e-6)
        assert policy.metadata["task"] == "Walker-v0"
    last = wv.load_policy(folder / "model_2.pt")(obs)
    assert torch.equal(wv.load_policy(folder, checkpoint="last")(obs), last)
    shutil.copy(folder / "model_2.pt", "alone.pt")
    assert torch.equal(wv.load_policy("alone.pt")(obs), last)

    outcome = warpvox("export", f"run={folder}", "format=[onnx,jit]", "name=both", "checkpoint=2")
    assert outcome.code == 0, outcome.err
    (out,) = Path("outputs").glob("export/Walker-v0/*_both")
    assert {file.name for file in out.iterdir()} == {"config.yaml", "summary.json", "policy.onnx", "policy.pt"}
    assert outcome.out.count("of the policy") == 2
    for name in ("policy.onnx", "policy.pt"):
        assert torch.equal(wv.load_policy(out / name)(obs), last)

    for source, words in (("nowhere", "no run at nowhere"), ("text.pt", "not a readable checkpoint")):
        Path("text.pt").write_text("nothing")
        with pytest.raises(wv.RunError, match=words):
            wv.load_policy(source)


def test_pictures_and_the_policy_go_into_one_folder(train: Callable[..., Path], warpvox: Callable) -> None:
    train("max_iterations=1")
    outcome = warpvox("export", "format=[jit,html]", "steps=3", "device=cpu", "threads=1")
    assert outcome.code == 0, outcome.err
    (out,) = Path("outputs").glob("export/Walker-v0/*")
    assert {"policy.pt", "rollout.html", "rollout.npz"} <= {file.name for file in out.iterdir()}
    outcome = warpvox("export", f"rollout={out / 'rollout.npz'}", "format=jit")
    assert outcome.code == 2
    assert "a rollout holds none" in outcome.err
    outcome = warpvox("export", "format=onx")
    assert "Did you mean 'onnx'" in outcome.err


def test_a_stored_task_is_not_imported(train: Callable[..., Path], warpvox: Callable) -> None:
    folder = train("max_iterations=1")
    Path("evil.py").write_text("open('ran', 'w').close()\nTASK = None\n")
    config = folder / "config.yaml"
    config.write_text(config.read_text().replace("task: Walker-v0", "task: evil.py:TASK"))
    assert wv.load_policy(folder).metadata["task"] == "evil.py:TASK"
    outcome = warpvox("export", f"run={folder}", "format=jit", "name=odd")
    assert outcome.code == 0, outcome.err
    assert len(list(Path("outputs").glob("export/*/*_odd/policy.pt"))) == 1
    assert not Path("ran").exists()
