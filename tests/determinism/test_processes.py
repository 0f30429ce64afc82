"""What follows from a seed is the same in every process: whatever hashes, threads, folder and time zone it has.

Trainings, searches and files; the digests of all tasks are another matter.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from chores import CHORES, do

NEEDS = {"search map_elites": "ribs", "file rollout.mp4": "imageio_ffmpeg"}
HERE = {name for name in CHORES if name not in NEEDS or find_spec(NEEDS[name])}


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Of torch, as every command has it unless told otherwise."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The digests of all chores that can be done here, of a process in other circumstances."""
    folder = tmp_path_factory.mktemp("elsewhere")
    circumstances = {
        "PYTHONHASHSEED": "4242" if os.environ.get("PYTHONHASHSEED") != "4242" else "17",
        "TZ": "Pacific/Chatham",
        "OMP_NUM_THREADS": "3",
        "COLUMNS": "40",
    }
    program = Path(__file__).with_name("chores.py")
    command = [sys.executable, program, "--threads=2", *sorted(HERE)]
    done = subprocess.run(command, cwd=folder, env=os.environ | circumstances, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not list(folder.iterdir())
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("chore", CHORES)
def test_another_process_comes_to_the_same(chore: str, elsewhere: dict[str, str]) -> None:
    if chore not in HERE:
        pytest.skip(f"needs {NEEDS[chore]}")
    assert elsewhere[chore] == do(chore, threads=1)


@pytest.mark.parametrize("chore", ["train", "population", "search random", "file rollout.npz"])
def test_another_seed_comes_to_something_else(chore: str) -> None:
    assert do(chore, threads=1, seed=1) != do(chore, threads=1, seed=2)
