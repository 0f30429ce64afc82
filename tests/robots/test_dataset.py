"""Files in the format of EvoGym's released data sets, made up here: what they list, and the robots in them."""

from __future__ import annotations

import base64
import io
import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from warpvox.design import full_connections, load_design
from warpvox.envs.vec_env import make_vec
from warpvox.errors import DesignError, RunError
from warpvox.robots.dataset import DataSet, network_of_blob
from warpvox.robots.entry import find_robot
from warpvox.robots.network import STEP
from warpvox.robots.replay import judge

BODY = load_design("mini")
TASKS = ("Walker-v0", "Walker-v0", "WingspanMazimizer-v0", "Walker-v0")
REWARDS = (1.5, 3.0, 0.2, 2.0)


def sizes() -> tuple[int, int]:
    env = make_vec("Walker-v0", body=BODY, num_envs=1, device="cpu", memory_check=False)
    return env.num_obs, env.num_actions


def state_of(num_obs: int, num_actions: int, seed: int = 0) -> dict[str, torch.Tensor]:
    """Weights by the names that Stable-Baselines3 gives them."""
    torch.manual_seed(seed)
    widths = {"mlp_extractor.policy_net.0": (64, num_obs), "mlp_extractor.policy_net.2": (64, 64)}
    widths |= {"mlp_extractor.value_net.0": (64, num_obs), "mlp_extractor.value_net.2": (64, 64)}
    widths |= {"action_net": (num_actions, 64), "value_net": (1, 64)}
    state = {"log_std": torch.zeros(num_actions)}
    for name, (rows, columns) in widths.items():
        state |= {f"{name}.weight": torch.randn(rows, columns) / columns**0.5, f"{name}.bias": torch.randn(rows) / 10}
    state["action_net.bias"] += 1.1
    return state


def saved(state: Any) -> bytes:
    file = io.BytesIO()
    torch.save(state, file)
    return file.getvalue()


def model_zip(state: Any, settings: object = None) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", json.dumps({"policy_kwargs": settings or {}}))
        archive.writestr("policy.pth", saved(state))
        archive.writestr("policy.optimizer.pth", b"not read")
    return file.getvalue()


def rows_of(blob: bytes | None) -> list[dict[str, Any]]:
    pairs = full_connections(BODY).T.tolist()
    every = [
        {"uid": f"uid-{k}", "body": BODY.tolist(), "connections": pairs, "reward": reward, "env_name": task}
        for k, (task, reward) in enumerate(zip(TASKS, REWARDS, strict=True))
    ]
    names = ("Genetic Algorithm", "Bayesian Optimization", "CPPN-NEAT", "Genetic Algorithm")
    return [
        row | {"generated_by": name} | ({} if blob is None else {"policy_blob": blob})
        for row, name in zip(every, names, strict=True)
    ]


def write(path: Path, rows: list[dict[str, Any]]) -> Path:
    if path.suffix == ".parquet":
        pa = pytest.importorskip("pyarrow")
        from pyarrow import parquet

        parquet.write_table(pa.Table.from_pylist(rows), path)
        return path
    rows = [row | {name: base64.b64encode(row[name]).decode() for name in row if name == "policy_blob"} for row in rows]
    text = json.dumps(rows) if path.suffix == ".json" else "\n".join(map(json.dumps, rows)) + "\n"
    path.write_text(text)
    return path


@pytest.mark.parametrize("suffix", [".parquet", ".json", ".jsonl"])
def test_robots_are_found_by_task_rank_and_uid(suffix: str, tmp_path: Path) -> None:
    path = write(tmp_path / f"robots{suffix}", rows_of(model_zip(state_of(5, 2))))
    data = DataSet(path)
    assert (len(data), data.has_policies) == (4, True)
    assert data.task_names == ["Walker-v0", "WingspanMaximizer-v0"]
    assert data.best("Walker-v0", 2) == [1, 3]
    found = {which: find_robot(f"{path}:{which}") for which in ("Walker-v0", "Walker-v0:3", "uid-2")}
    assert [robot.mean_return for robot in found.values()] == [3.0, 1.5, 0.2]
    assert found["uid-2"].task == "WingspanMaximizer-v0"
    assert found["Walker-v0"].about["generated_by"] == "Bayesian Optimization"
    np.testing.assert_array_equal(load_design(f"zoo:{path}:Walker-v0"), BODY)
    assert (found["Walker-v0"].policy.num_obs, found["Walker-v0"].policy.num_actions) == (5, 2)
    with pytest.raises(RunError, match="Did you mean 'Walker-v0'"):
        find_robot(f"{path}:walker-v0")
    with pytest.raises(RunError, match="1 to 3, got '4'"):
        find_robot(f"{path}:Walker-v0:4")
    with pytest.raises(RunError, match="4 robots: name one"):
        find_robot(str(path))


def test_a_folder_of_parquet_files_is_one_set(tmp_path: Path) -> None:
    rows = rows_of(None)
    for number in range(2):
        write(tmp_path / f"train-{number}.parquet", rows[2 * number :][:2])
    data = DataSet(tmp_path)
    assert data.uids == [row["uid"] for row in rows]
    assert not data.has_policies
    assert [data.robot(row).about["uid"] for row in range(4)] == data.uids
    assert find_robot(f"{tmp_path}:Walker-v0:2").mean_return == 2.0


@pytest.mark.parametrize("named", [None, "ReLU"])
@pytest.mark.parametrize("whole", [True, False])
def test_a_policy_acts_as_its_layers_do(named: str | None, whole: bool) -> None:
    state = state_of(5, 2)
    settings = named and {"activation_fn": f"<class 'torch.nn.modules.activation.{named}'>"}
    function = torch.relu if named and whole else torch.tanh  # weights alone do not name it
    network = network_of_blob(model_zip(state, settings) if whole else saved(state))
    obs = torch.randn(40, 5)
    hidden = function(obs @ state["mlp_extractor.policy_net.0.weight"].T + state["mlp_extractor.policy_net.0.bias"])
    hidden = function(hidden @ state["mlp_extractor.policy_net.2.weight"].T + state["mlp_extractor.policy_net.2.bias"])
    expected = (hidden @ state["action_net.weight"].T + state["action_net.bias"]).clamp(0.6, 1.6)
    np.testing.assert_allclose(network(obs), expected, atol=2 * STEP)


class Trap:
    """Unpickled, it would write a file."""

    def __reduce__(self) -> tuple[Callable, tuple]:
        return (Path.touch, (Path("trapped"),))


@pytest.mark.parametrize(
    ("blob", "words"),
    [
        (pickle.dumps({"actor": 1}), "no model of Stable-Baselines3|no state of a Stable-Baselines3"),
        (saved({"trap": Trap()}), "no state of a Stable-Baselines3 policy"),
        (saved([torch.zeros(2)]), "no state of a Stable-Baselines3 policy"),
        (saved({"actor.weight": torch.zeros(2)}), "expected an MlpPolicy"),
        (model_zip(state_of(5, 2) | {"action_net.weight": torch.zeros(2, 3)}), "do not fit together"),
        (model_zip(state_of(5, 2), {"activation_fn": "<class 'torch.nn.modules.activation.Mish'>"}), "activations"),
    ],
    ids=["pickle", "trap", "list", "names", "sizes", "activation"],
)
def test_a_policy_of_another_kind_leaves_the_body(blob: bytes, words: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    robot = find_robot(f"{write(tmp_path / 'robots.json', rows_of(blob))}:Walker-v0")
    assert robot.policy is None
    with pytest.raises(RunError, match=words):
        judge(robot)
    np.testing.assert_array_equal(robot.body, BODY)
    assert not Path("trapped").exists()


def test_a_body_that_is_not_valid_is_named(tmp_path: Path) -> None:
    rows = rows_of(None)
    rows[1]["body"] = [[1, 0], [0, 1]]
    rows[3]["connections"] = [[0, 1, 99], [1, 2, 3]]
    rows[0]["connections"] = [[], []]
    path = write(tmp_path / "robots.json", rows)
    with pytest.raises(RunError, match="uid-1 is not valid: The body is not connected"):
        find_robot(f"{path}:uid-1")
    with pytest.raises(RunError, match="uid-3 is not valid: connections"):
        find_robot(f"{path}:uid-3")
    with pytest.raises(DesignError, match="not connected"):
        load_design(f"zoo:{path}:uid-0")


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("robots.json", "[1]", "list of rows"),
        ("robots.json", '{"uid": 1', "rows of JSON"),
        ("robots.jsonl", '{"uid": "a"}', "its columns are uid"),
        ("robots.parquet", "nothing", "cannot be read as Parquet"),
    ],
)
def test_a_file_of_another_kind_is_refused(name: str, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(RunError, match=words):
        DataSet(tmp_path / name)
    with pytest.raises(RunError, match="no such file"):
        DataSet(tmp_path / "missing.parquet")


def test_the_command_lists_evaluates_and_plays_them(warpvox: Callable, tmp_path: Path) -> None:
    rows = rows_of(model_zip(state_of(*sizes())))
    rows[3]["policy_blob"] = b"another kind"
    path = write(Path("robots.parquet"), rows)
    outcome = warpvox("zoo", f"file={path}")
    assert outcome.code == 0, outcome.err
    assert "4 robots with policies" in outcome.out
    outcome = warpvox("zoo", f"file={path}", "task=Walker-v0", "top=2", "evaluate=true")
    assert outcome.code == 0, outcome.err
    here = judge(find_robot(f"{path}:Walker-v0")).mean_return
    assert f"{here:.3f}" in outcome.out
    assert "rank 2: The robot has no policy" in outcome.out
    assert "uid-1" in outcome.out
    assert "uid-0" not in outcome.out  # the third
    outcome = warpvox("play", f"zoo={path}:Walker-v0:3", "steps=3", "window=off", "export=[]")
    assert outcome.code == 0, outcome.err
    outcome = warpvox("play", "agent=sine", "task=Walker-v0", f"design=zoo:{path}:uid-0", "steps=3", "window=off")
    assert outcome.code == 0, outcome.err
    assert "goes with file=" in warpvox("zoo", "evaluate=true").err


def test_a_model_that_stable_baselines_has_saved_acts_as_there() -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    from warpvox.envs.adapters.sb3 import VoxelSB3VecEnv

    env = VoxelSB3VecEnv("Walker-v0", 1, BODY, normalize_actions=False)
    model = sb3.PPO("MlpPolicy", env, n_steps=8, batch_size=4, device="cpu")
    file = io.BytesIO()
    model.save(file)
    obs = np.random.default_rng(0).normal(size=(20, env.observation_space.shape[0])).astype(np.float32)
    expected = model.predict(obs, deterministic=True)[0]
    np.testing.assert_allclose(network_of_blob(file.getvalue())(obs), expected, atol=2 * STEP)
