"""Training, searches and files: two processes, with other hashes, threads, folders and clocks, make the same bytes."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from labour import FILES, FORMATS, NEEDS, everything

from warpvox.algos.search.settings import ALGORITHMS

PROGRAM = Path(__file__).with_name("labour.py")
ENVIRONMENT = {"PYTHONHASHSEED": "123", "TZ": "Asia/Tokyo"}
"""Of the other process, which has two threads; as they work in turn, any time that is written down differs."""

PARTS = {
    "training: model_3.pt": None,
    "training: model_best.pt": None,
    "training: metrics": None,
    "codesign: archive": None,
    "file: rollout.npz": None,
    **{f"file: {FILES.get(name, f'rollout.{name}')}": package for name, package in FORMATS.items()},
    **{f"search: {name}": NEEDS.get(name) for name in ALGORITHMS if name != "custom"},
}  # what is made, and the package that it needs


@pytest.mark.slow
def test_two_processes_make_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """This one, which has its own hashes and other work behind it, and a fresh one."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    threads = torch.get_num_threads()
    with torch.random.fork_rng():
        ours = everything(1)
    torch.set_num_threads(threads)
    program = [sys.executable, str(PROGRAM), str(tmp_path / "there"), "2"]
    done = subprocess.run(program, env=os.environ | ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == ours
    assert set(ours) == {part for part, package in PARTS.items() if package is None or find_spec(package)}
