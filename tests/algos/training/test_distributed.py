"""One training on two processes under ``torchrun``, which talk by gloo on the CPU."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from learning import rows
from tiny import tiny

from warpvox.algos.checkpoints.files import load_checkpoint
from warpvox.algos.training.distributed import SINGLE_PROCESS, ProcessGroup, join_process_group
from warpvox.errors import ConfigError

SIZES = "num_envs=16", "ppo.steps=8", "ppo.epochs=2", "seed=3"


def torchrun(folder: Path, *words: str) -> subprocess.CompletedProcess:
    folder.mkdir(exist_ok=True)
    line = [sys.executable, *"-m torch.distributed.run --standalone --nproc-per-node=2 -m warpvox".split()]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.run([*line, *words], cwd=folder, env=environment, capture_output=True, text=True, timeout=600)


def test_alone_nothing_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    assert join_process_group("cpu") is SINGLE_PROCESS
    assert (SINGLE_PROCESS.sum([1.5, 2]), SINGLE_PROCESS.seed(7)) == ([1.5, 2], 7)
    assert len({ProcessGroup(rank, 4).seed(7) for rank in range(4)}) == 4


def test_one_gpu_for_all_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"WORLD_SIZE": 2, "RANK": 1, "LOCAL_RANK": 1, "LOCAL_WORLD_SIZE": 2}.items():
        monkeypatch.setenv(name, str(value))
    with pytest.raises(ConfigError):
        join_process_group("cuda:0")


@pytest.mark.slow
def test_two_processes_train_one_policy_and_go_on_exactly(tmp_path: Path) -> None:
    for name, total in (("whole", 6), ("parts", 4)):
        run = torchrun(tmp_path / name, *tiny("train", *SIZES, f"max_iterations={total}"))
        assert run.returncode == 0, run.stderr
    whole, parts = (next((tmp_path / name).glob("outputs/train/*/*")) for name in ("whole", "parts"))
    # one voice, one folder, one set of files besides the state of each process
    assert run.stdout.count("run folder:") == 1
    assert len(list((tmp_path / "parts").glob("outputs/train/*/*"))) == 1
    assert {"state.pt", "state_1.pt", "model_4.pt", "metrics.csv"} <= {file.name for file in parts.iterdir()}
    states = [load_checkpoint(parts / name) for name in ("state.pt", "state_1.pt")]
    for name, value in states[0]["actor_state_dict"].items():
        assert torch.equal(value, states[1]["actor_state_dict"][name]), name
    # 8 of the 16 environments each, with randomness of their own
    assert [len(state["env"]["obs"]) for state in states] == [8, 8]
    assert not torch.equal(states[0]["env"]["obs"], states[1]["env"]["obs"])
    figures = json.loads((parts / "summary.json").read_text())
    assert figures["steps"] == 4 * 8 * 16
    run = torchrun(tmp_path / "parts", "train", "resume=latest", "max_iterations=6")
    assert run.returncode == 0, run.stderr
    ours, theirs = (load_checkpoint(folder / "model_6.pt") for folder in (parts, whole))
    for name, value in theirs["actor_state_dict"].items():
        assert torch.equal(value, ours["actor_state_dict"][name]), name
    assert rows(parts) == rows(whole)
    # a state of two processes is none for one
    line = [sys.executable, "-m", "warpvox", "train", f"resume={parts}", "max_iterations=8"]
    alone = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True)
    assert alone.returncode == 2
    assert "made by 2 process(es)" in alone.stderr


@pytest.mark.slow
def test_environments_that_cannot_be_shared_out_are_refused(tmp_path: Path) -> None:
    run = torchrun(tmp_path / "odd", *tiny("train", *SIZES, "num_envs=15"))
    assert run.returncode != 0
    assert "cannot be shared out evenly" in run.stderr
    assert not (tmp_path / "odd" / "outputs").exists()
