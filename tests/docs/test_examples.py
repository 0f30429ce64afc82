"""The scripts of ``examples/`` are up to date: the quick ones run."""

import importlib
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import torch

from warpvox.cli.application import read_options
from warpvox.cli.config import read_words

FOLDER = Path(__file__).resolve().parents[2] / "examples"
QUICK: dict[str, dict[str, Any]] = {
    "cleanrl_ppo": {"iterations": 1, "num_envs": 4},
    "gymnasium_vector": {"rounds": 1, "num_envs": 2, "steps": 3},
    "sb3_ppo": {"steps": 64, "num_envs": 2},
}


@pytest.mark.parametrize("name", QUICK)
def test_a_script_runs(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    if name == "sb3_ppo":
        pytest.importorskip("stable_baselines3")
        monkeypatch.setenv("SB3_LOGDIR", str(tmp_path))
    threads = torch.get_num_threads()
    try:
        importlib.import_module(name).main(**QUICK[name])
    finally:
        torch.set_num_threads(threads)


@pytest.mark.slow
def test_a_search_on_ray_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ray = pytest.importorskip("ray")
    monkeypatch.chdir(tmp_path)
    try:
        found = importlib.import_module("ray_search").main(workers=1, bodies=4, iterations=1)
    finally:
        ray.shutdown()
    assert len(found.designs) == 4


def test_the_sweep_is_one_that_train_takes() -> None:
    text = (FOLDER / "slurm_sweep.sh").read_text(encoding="utf-8").replace("\\\n", " ").replace('"$@"', "")
    (line,) = re.findall(r"^warpvox train (.+)$", text, re.MULTILINE)
    options = read_options("train", shlex.split(line))
    overrides = read_words("train", [word for word in options.overrides if not word.startswith("hydra")])
    listed = [[*one.sweep_string_iterator()] for one in overrides.values() if one.is_sweep_override()]
    assert options.multirun
    assert [len(values) for values in listed] == [3, 3]
