"""What a training needs, estimated beforehand, is what its process takes."""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ERROR = 0.2
"""Share by which an estimate may be off: allocators round up, keep what is freed, and differ between systems."""
WORK = [
    "Walker-v0 train 4096 1 steps=24",
    pytest.param("Walker-v0 train 8192 1 steps=24", marks=pytest.mark.slow),
    pytest.param("Climber-v2 train 4096 1 steps=32 hidden=[128,128,128]", marks=pytest.mark.slow),
    pytest.param("Walker-v0 train 1024 8 steps=16 minibatches=1", marks=pytest.mark.slow),
    pytest.param("Walker-v0 population 256 25 steps=16", marks=pytest.mark.slow),
    pytest.param("Walker-v0 population 256 25 steps=64 hidden=[32,32]", marks=pytest.mark.slow),
    pytest.param("Carrier-v0 population 512 12 steps=16 minibatches=2", marks=pytest.mark.slow),
]
GIB = 2**30


def probe(work: str) -> tuple[int, int]:
    """Bytes that a process takes: as estimated, and as measured."""
    line = [sys.executable, str(Path(__file__).with_name("memory_probe.py")), *work.split()]
    done = subprocess.run(line, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    return found["estimated"], found["measured"]


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="peaks of memory are those of Linux")
@pytest.mark.parametrize("work", WORK)
def test_the_estimate_is_what_a_process_takes(work: str) -> None:
    estimated, measured = probe(work)
    if estimated != pytest.approx(measured, rel=ERROR):  # equal processes differ by up to a quarter
        measured = statistics.median([measured, probe(work)[1], probe(work)[1]])
    assert estimated == pytest.approx(measured, rel=ERROR)


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """``free(gibibytes)``: what the machine has left."""

    def call(gibibytes: float) -> None:
        for place in ("warpvox.envs.needs", "warpvox.cli.memory_check"):
            monkeypatch.setattr(f"{place}.free_memory", lambda device: int(gibibytes * GIB))

    return call


def assert_refused(outcome: Any, *phrases: str) -> int:
    """The number that is said to fit."""
    assert outcome.code == 2, outcome
    assert outcome.err.count("\n") == 1, outcome.err
    for phrase in ("fit: ", "memory_check=false", *phrases):
        assert phrase in outcome.err
    return int(outcome.err.split("fit: ")[1].split("=")[1].split(".")[0])


SMALL = "design=mini threads=1 device=cpu ppo.steps=4 ppo.hidden=[8] ppo.epochs=1 max_iterations=1".split()


def test_a_training_that_does_not_fit_is_refused_with_the_number_that_does(
    warpvox: Callable, tmp_path: Path, free: Callable
) -> None:
    import time

    free(20)
    began = time.process_time()
    fits = assert_refused(
        warpvox("train", "num_envs=10000000"), "10,000,000 environments need about", "are free on cpu"
    )
    assert time.process_time() - began < 20  # nothing was made
    assert 100_000 < fits < 5_000_000
    free(0.002)
    fits = assert_refused(warpvox("train", *SMALL, "num_envs=4096"))
    assert 8 < fits < 4096
    assert list(tmp_path.iterdir()) == []
    assert warpvox("train", *SMALL, f"num_envs={fits}").code == 0
    assert warpvox("train", *SMALL, "num_envs=512", "memory_check=false").code == 0
    assert warpvox("train", "resume=latest", "max_iterations=2", "memory_check=true").code == 2
    assert warpvox("train", "resume=latest", "max_iterations=2").code == 0  # as the run was begun


def test_several_designs_get_whole_shares(warpvox: Callable, free: Callable) -> None:
    free(0.004)
    fits = assert_refused(warpvox("train", *SMALL[1:], "design=[mini,worm,walker]", "num_envs=3000"))
    assert fits % 3 == 0


def test_a_search_that_does_not_fit_says_how_many_designs_do(warpvox: Callable, tmp_path: Path, free: Callable) -> None:
    free(1)
    words = ["codesign", "training.envs=4096", "training.ppo.steps=64", "device=cpu"]
    fits = assert_refused(warpvox(*words), "25 designs of 4,096 environments each need about", "batch=")
    assert 0 < fits < 25
    free(0.1)
    fits = assert_refused(warpvox(*words, "training.method=sequential"), "training.envs=")
    assert 0 < fits < 4096
    assert list(tmp_path.iterdir()) == []


def test_a_search_can_be_told_to_try(warpvox: Callable, free: Callable) -> None:
    free(0.0001)
    words = (
        "codesign shape=[3,3] search.population=3 search.max_evaluations=3 training.envs=8 training.iterations=1"
        " training.ppo.steps=4 training.ppo.hidden=[8] training.ppo.epochs=1 device=cpu threads=1"
    ).split()
    outcome = warpvox(*words)
    assert outcome.code == 2
    assert "memory_check=false" in outcome.err
    assert warpvox(*words, "memory_check=false").code == 0


def test_playing_many_is_refused_and_can_be_tried(warpvox: Callable, free: Callable) -> None:
    free(0.0001)
    words = "play agent=zero num_envs=64 steps=1 window=off export=[] record=false device=cpu threads=1".split()
    outcome = warpvox(*words)
    assert outcome.code == 2
    assert "memory_check=false" in outcome.err
    assert warpvox(*words, "memory_check=false").code == 0
