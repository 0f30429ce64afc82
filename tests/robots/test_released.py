"""The example that reads EvoGym's released data sets, on files made up here in their format."""

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
import released_robots
import torch

from warpvox.algos.robots.entry import read_robot
from warpvox.algos.robots.policies import STEP
from warpvox.design import load_design
from warpvox.errors import RunError

BODY = load_design("mini")


def state_of(num_obs: int, num_actions: int) -> dict[str, torch.Tensor]:
    """Weights by the names that Stable-Baselines3 gives them."""
    sizes = {"mlp_extractor.policy_net.0": (64, num_obs), "mlp_extractor.policy_net.2": (64, 64)}
    sizes["action_net"] = (num_actions, 64)
    state = {}
    for name, (rows, columns) in sizes.items():
        state |= {f"{name}.weight": torch.randn(rows, columns) / columns**0.5, f"{name}.bias": torch.randn(rows) / 10}
    return state


def saved(state: Any, activation: str | None = None) -> bytes:
    weights, file = io.BytesIO(), io.BytesIO()
    torch.save(state, weights)
    settings = {"activation_fn": f"<class 'torch.nn.modules.activation.{activation}'>"} if activation else {}
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("data", json.dumps({"policy_kwargs": settings}))
        archive.writestr("policy.pth", weights.getvalue())
    return file.getvalue()


@pytest.mark.parametrize("suffix", [".parquet", ".jsonl"])
def test_the_best_robots_of_a_task_become_files(suffix: str, tmp_path: Path, capfd: Any, warpvox: Callable) -> None:
    names = ("Walker-v0", "WingspanMazimizer-v0", "Walker-v0", "Walker-v0")
    rows = [{"uid": f"u{k}", "body": BODY.tolist(), "reward": float(k), "env_name": names[k]} for k in range(4)]
    rows = [row | {"connections": None, "generated_by": "GA", "policy_blob": saved(state_of(40, 8))} for row in rows]
    rows[2]["policy_blob"] = b"another kind"
    path = tmp_path / f"set{suffix}"
    if suffix == ".parquet":
        pa = pytest.importorskip("pyarrow")
        from pyarrow import parquet

        parquet.write_table(pa.Table.from_pylist(rows), path)
    else:
        for row in rows:
            row["policy_blob"] = base64.b64encode(row["policy_blob"]).decode()
        path.write_text("\n".join(map(json.dumps, rows)))
    released_robots.main(str(path))
    assert "'Walker-v0'                           3 robots, best 3.000" in capfd.readouterr().out
    released_robots.main(str(path), "Walker-v0", "2", "found")
    assert "it is not read (BadZipFile" in capfd.readouterr().out
    assert [read_robot(f"found/{rank}.npz").about["uid"] for rank in (1, 2)] == ["u3", "u2"]
    released_robots.main(str(path), "WingspanMaximizer-v0", "1", "other")
    assert read_robot("other/1.npz").task == "WingspanMaximizer-v0"
    words = "agent=sine", "task=Walker-v0", "design=zoo:found/1.npz", "steps=2", "window=off", "export=[]", "num_envs=1"
    warpvox("play", *words)


@pytest.mark.parametrize("activation", [None, "ReLU"])
def test_a_policy_acts_as_its_layers_do(activation: str | None) -> None:
    state, obs = state_of(5, 2), torch.randn(40, 5)
    values = obs
    for name in ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2"):
        values = (torch.relu if activation else torch.tanh)(values @ state[f"{name}.weight"].T + state[f"{name}.bias"])
    expected = (values @ state["action_net.weight"].T + state["action_net.bias"]).clamp(0.6, 1.6)
    np.testing.assert_allclose(released_robots.policy_of(saved(state, activation))(obs), expected, atol=2 * STEP)


class Trap:
    """Unpickled, it would write a file."""

    def __reduce__(self) -> tuple[Callable, tuple]:
        return Path.touch, (Path("trapped"),)


LARGE = state_of(5, 2) | {"action_net.weight": torch.zeros(1).expand(30_000, 30_000)}


@pytest.mark.parametrize(
    ("blob", "words"),
    [
        (pickle.dumps(Trap()), "BadZipFile"),
        (saved({"trap": Trap()}), "UnpicklingError"),
        (saved({"actor.weight": torch.zeros(2)}), "KeyError"),
        (saved(LARGE), "larger than its storage"),
        (saved(state_of(5, 2), "Hardtanh"), "hardtanh"),
    ],
    ids=["a pickle", "an object", "other layers", "too large", "an activation"],  # not the bytes, which differ
)
def test_a_policy_of_another_kind_leaves_the_body(blob: bytes, words: str, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    robot = released_robots.robot_of({"body": BODY.tolist(), "reward": 1.0, "policy_blob": blob}, "Walker-v0")
    assert robot.policy is None
    assert words in robot.about["no_policy"]
    assert not Path("trapped").exists()


@pytest.mark.parametrize("text", ["[1]", '{"uid": 1', "[" * 10**6, '{"reward": 1}', " " * (1 << 24) + "1"])
def test_a_file_of_another_kind_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "set.jsonl").write_text(text)
    with pytest.raises(RunError, match="row 1"):
        list(released_robots.rows_of(tmp_path / "set.jsonl"))


def test_rows_have_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(released_robots, "MOST_ROWS", 2)
    (tmp_path / "set.jsonl").write_text('{"reward": 1, "env_name": "x"}\n' * 3)
    with pytest.raises(RunError, match="more than 2 rows"):
        list(released_robots.rows_of(tmp_path / "set.jsonl"))
