"""Training, searches and files: two processes, with other hashes, threads, folders and clocks, make the same bytes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from labour import FILES, FORMATS, NEEDS

from warpvox.algos.search.settings import ALGORITHMS

PROGRAM = Path(__file__).with_name("labour.py")
ENVIRONMENTS = ({"PYTHONHASHSEED": "0", "TZ": "UTC"}, {"PYTHONHASHSEED": "123", "TZ": "Asia/Tokyo"})
"""Of the two processes. The second has two threads; as they run in turn, any time that is written down differs."""

PARTS = {
    "training: model_3.pt": None,
    "training: model_best.pt": None,
    "training: metrics": None,
    "codesign: archive": None,
    "file: rollout.npz": None,
    **{f"file: {FILES.get(name, f'rollout.{name}')}": package for name, package in FORMATS.items()},
    **{f"search: {name}": NEEDS.get(name) for name in ALGORITHMS if name != "custom"},
}
"""What is made, and the package that it needs."""


def made(folder: Path, threads: int) -> dict[str, str]:
    """What a process has made, as digests."""
    program = [sys.executable, str(PROGRAM), str(folder), str(threads)]
    done = subprocess.run(program, env=os.environ | ENVIRONMENTS[threads - 1], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_two_processes_make_the_same(tmp_path: Path) -> None:
    """One test, so that the two processes are started once, however tests are spread."""
    one, other = (made(tmp_path / str(threads), threads) for threads in (1, 2))
    assert one == other
    assert set(one) == {part for part, package in PARTS.items() if package is None or find_spec(package)}
