"""Training and policies from Python: what the command does, in a process of one's own."""

import dataclasses
import inspect
import shutil
import sys
import threading
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from refusals import refused

import warpvox as wv
from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.checkpoints.policy import read_policy
from warpvox.algos.codesign.stored_policies import policy_sha256
from warpvox.cli.config import load
from warpvox.configs.composition import settings_named
from warpvox.devices.startup import own_torch
from warpvox.envs.registry import get_task

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


def test_listeners_hear_of_every_iteration_and_may_end_the_training() -> None:
    rows: list = []
    run = wv.train(**KEYS, ppo=PPO, folder=None, progress=False, listeners=[rows.append, lambda row: None])
    assert rows == list(run.rows)

    def stop(row: dict) -> None:
        raise LookupError("enough")

    rows.clear()
    with pytest.raises(LookupError):
        wv.train(**KEYS, ppo=PPO, folder=None, progress=False, listeners=[rows.append, stop])
    assert [row["iteration"] for row in rows] == [1]


@pytest.mark.parametrize("in_use", [False, True])
def test_random_numbers_of_gpus_are_as_before(in_use: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    states = []  # what GPUs are set to, the seed for that of one not in use
    for name, fake in {
        "is_initialized": lambda: in_use,
        "device_count": lambda: 2,
        "get_rng_state": lambda device: f"state of {device}",
        "set_rng_state": lambda state, _: states.append(state),
        "manual_seed_all": states.append,
    }.items():
        monkeypatch.setattr(torch.cuda, name, fake)
    with own_torch(1):
        torch.manual_seed(123456789)
    assert states[0] == 123456789
    assert set(states[1:]) == ({"state of 0", "state of 1"} if in_use else {torch.initial_seed()})
    assert torch.initial_seed() != 123456789


def test_values_of_python_arrive_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    body = wv.example_design("mini")
    place = tmp_path / "with 'quotes', = and [brackets]"
    run = wv.train(
        **(KEYS | {"design": body, "max_iterations": 1}), output_dir=place, name=None, stop_return=-1.5, ppo=PPO,
        physics={"friction": 0.25}, nan_guard="on", progress=False,
        sim=wv.SimOptions(threads=2, lanes=8),
    )  # fmt: skip
    assert run.folder.is_relative_to(place)
    policy = wv.load_policy(output_dir=place)
    assert policy.metadata["design"] == body.tolist()
    text = (run.folder / "config.yaml").read_text()
    assert "friction: 0.25" in text
    for line in ("device: cpu", "threads: 1", "lanes: 8"):  # what is given by name goes before sim, as for make_vec
        assert f"\n{line}\n" in text


def test_without_a_folder_nothing_is_written_and_the_same_is_learned(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    own = replace(get_task("Walker-v0"), id="Mine-v0", max_episode_steps=30)
    sim = wv.SimOptions(device="cpu", threads=1, lanes=8)
    settings = wv.Training(own, "mini", num_envs=8, max_iterations=2, eval_interval=1, ppo=wv.Ppo(**PPO))
    state = torch.get_rng_state()
    runs = [
        wv.train(settings, sim=sim, folder=None, progress=False),
        wv.train(own, wv.example_design("mini"), sim=sim, ppo=PPO, num_envs=8, max_iterations=2, eval_interval=1,
                 folder=tmp_path / "mine", progress=False),
    ]  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert torch.equal(torch.get_rng_state(), state)
    one, other = (run.policy.metadata for run in runs)
    assert one == {key: value for key, value in other.items() if key != "source"} | {"seed": 0}
    assert one["physics"]["gravity"] == 110.0
    one, other = (run.policy.state_dict() for run in runs)
    assert all(torch.equal(value, other[name]) for name, value in one.items())
    assert runs[0].best_return == runs[1].best_return
    assert list(runs[0].metrics) == list(runs[1].metrics)
    assert np.allclose(*(run.metrics["eval_return"] for run in runs), rtol=1e-8)
    assert wv.train(own, resume=tmp_path / "mine", max_iterations=3, progress=False).summary["iterations"] == 3
    with pytest.raises(wv.RunError):
        wv.train(own, folder=tmp_path / "mine")
    with pytest.raises(wv.ConfigError):
        wv.train(own, folder=None, nan_guard="dump")


def test_the_defaults_and_named_sets_of_ppo_are_those_of_the_command() -> None:
    for name in ("parallel", "evogym"):
        commanded = load("train", [f"ppo={name}"])
        known = settings_named("train", ppo=name)
        assert wv.Training(**known) == wv.Training.of(dataclasses.asdict(commanded))
    assert wv.Training() == wv.Training.of(dataclasses.asdict(load("train", [])))
    assert inspect.signature(wv.evaluate).parameters["episodes"].default == load("evaluate", []).episodes


def asked(monkeypatch: pytest.MonkeyPatch, *given: Any, **settings: Any) -> wv.Training:
    """The settings of a training, which is not made."""

    def stop(job: Any, *_: Any, **__: Any) -> None:
        made.append(job.settings)
        raise InterruptedError

    made: list[wv.Training] = []
    monkeypatch.setattr("warpvox.algos.training.job.Job.train", stop)
    with pytest.raises(InterruptedError):
        wv.train(*given, **settings)
    return made[0]


def test_a_part_that_is_changed_keeps_its_other_values(train: Callable[..., Path], monkeypatch: Any) -> None:
    folder = train("seed=3")
    parts = {"ppo": {"gamma": 0.5}, "designs": {"refresh": "new", "grid": [5, 5]}, "physics": {"friction": 0.25}}
    other = {"ppo": {"steps": 4}, "designs": {"bodies": "random:2"}, "physics": {"gravity": 80.0}}
    both = {key: parts[key] | other[key] for key in parts}
    for designs in (other["designs"], "random:2"):
        changed = asked(monkeypatch, wv.Training(num_envs=7, **parts), **other | {"designs": designs})
        assert changed == wv.Training(num_envs=7, **both)
    base = wv.Training(seed=3, num_envs=7)
    rnn = {"rnn_type": "gru", "rnn_hidden_dim": np.int64(8)}
    assert type(asked(monkeypatch, base, ppo={"rnn": rnn}).ppo.rnn["rnn_hidden_dim"]) is int
    evogym = settings_named("train", ppo="evogym")["ppo"]
    assert asked(monkeypatch, base, ppo="evogym") == wv.Training(seed=3, num_envs=7, ppo=evogym)
    assert asked(monkeypatch, resume=folder, ppo={"epochs": 1}, max_iterations=2).ppo == wv.Ppo(**PPO)


def test_policies_are_evaluated_side_by_side(train: Callable[..., Path]) -> None:
    folder = train("max_iterations=1", "eval_interval=1", "physics.gravity=80")
    policies = [folder, wv.load_policy(folder), "zoo:Walker-v0"]
    table = wv.evaluate(policies, episodes=8, device="cpu", threads=1)
    assert [row.name for row in table] == [str(folder), "policy 1", "zoo:Walker-v0"]
    assert table[0].returns == table[1].returns
    assert wv.evaluate(policies[1], episodes=1, device="cpu", threads=1)[0].mean == table[1].mean
    few, many = (wv.record(wv.make_vec("Walker-v0", "mini", n, device="cpu"), policies[1]) for n in (1, 8))
    assert np.array_equal(few.positions[:, 0], many.positions[:, 0])
    assert "mean return" in repr(table)
    own = replace(get_task("Catcher-v0"), max_episode_steps=20)
    (row,) = wv.evaluate(lambda obs: torch.ones(len(obs), 8), own, "mini", episodes=8, device="cpu", threads=1)
    assert row.interval.n == 8
    assert row.mean == pytest.approx(sum(row.returns) / 8)
    few = {"episodes": 2, "device": "cpu", "threads": 1}
    (row,) = wv.evaluate(lambda obs: torch.rand(len(obs), 8), "Walker-v0", "mini", stochastic=True, **few)
    assert row.interval.n == 2


def test_a_notebook_has_an_element_that_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shown: list[str] = []
    handle = SimpleNamespace(update=shown.append)
    display = ModuleType("IPython.display")
    display.HTML, display.display = str, lambda *_, **__: handle
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # rich's, of widgets that are not installed
        wv.train(**KEYS, ppo=PPO, folder=None)
    assert "<progress value=0 max=2>" in shown[0]
    assert "<progress value=2 max=2>" in shown[2]
    assert "done after 64 control steps" in shown[-1]


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
        torch.testing.assert_close(policy(obs), read_policy(folder / file).in_float64()(obs), rtol=0, atol=1e-6)
        assert policy.metadata["task"] == "Walker-v0"
    last = wv.load_policy(folder / "model_2.pt")(obs)
    assert torch.equal(wv.load_policy(folder, checkpoint="last")(obs), last)
    with pytest.raises(wv.RunError):
        wv.load_policy(folder / "model_2.pt", checkpoint="last")
    shutil.copy(folder / "model_2.pt", "alone.pt")
    assert torch.equal(wv.load_policy("alone.pt")(obs), last)

    outcome = warpvox("export", "format=[onnx,jit]", "name=both", "checkpoint=2")
    (out,) = Path("outputs").glob("export/Walker-v0/*_both")
    assert (out / "config.yaml").read_text().startswith(f"run: {folder}\n")
    assert {file.name for file in out.iterdir()} == {"config.yaml", "summary.json", "policy.onnx", "policy.pt"}
    assert outcome.out.count("of the policy") == 2
    for name in ("policy.onnx", "policy.pt"):
        assert torch.equal(wv.load_policy(out / name)(obs), last)

    with pytest.raises(wv.ConfigError):
        wv.train(pretrained=wv.zoo("Walker-v0"), folder=None)
    (folder / "model_best.pt").write_bytes(b"nothing")
    Path("text.pt").write_text("nothing")
    for source, advice in ("text.pt", "text.pt"), (folder, "checkpoint=last takes the newest"):
        with refused(wv.RunError, "not a readable checkpoint", advice):
            wv.load_policy(source)
