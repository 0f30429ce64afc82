"""Training, searches and files: two processes, with other hashes, threads, folders and clocks, make the same bytes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
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


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, str]]:
    """What two processes have made, as digests."""
    found = []
    for number, environment in enumerate(ENVIRONMENTS):
        program = [sys.executable, str(PROGRAM), str(tmp_path_factory.mktemp(f"process{number}")), str(number + 1)]
        done = subprocess.run(program, env=os.environ | environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout.splitlines()[-1]))
    return found


@pytest.mark.parametrize("part", PARTS)
def test_two_processes_make_the_same(part: str, two: list[dict[str, str]]) -> None:
    package = PARTS[part]
    if package is not None and find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    assert two[0][part] == two[1][part]


def test_nothing_that_is_made_goes_unlooked_at(two: list[dict[str, str]]) -> None:
    assert set(two[0]) == set(two[1])
    assert set(two[0]) <= set(PARTS)
