"""What ``warpvox bench suite=soak`` sees: leaks of memory and of files, a loss of speed, a command that ends."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from warpvox.bench.soak import Sample, judge, watch
from warpvox.errors import RunError

pytestmark = pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="/proc is needed to watch a process")

STEADY = [Sample(float(k), float(k), 100 << 20, 10, 1000 * k) for k in range(100)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda item: item, ""),
        (lambda item: replace(item, memory=int(item.memory * (1 + item.seconds / 2000))), "memory grew"),
        (lambda item: replace(item, files=10 + int(item.seconds) // 30), "open files grew"),
        (lambda item: replace(item, steps=int(item.steps * (1 - item.seconds / 250))), "speed fell"),
    ],
)
def test_what_is_judged(change: Callable[[Sample], Sample], words: str) -> None:
    failed = judge([change(item) for item in STEADY])["failed"]
    assert len(failed) == bool(words)
    assert all(words in text for text in failed)


def test_the_first_quarter_may_grow() -> None:
    start = [replace(item, memory=item.memory // 4, files=1) for item in STEADY[:25]]
    assert judge(start + STEADY[25:])["failed"] == []


@pytest.fixture
def child() -> Iterator[Callable[[str], subprocess.Popen]]:
    """Start a Python program that is killed at the end of the test."""
    started: list[subprocess.Popen] = []

    def start(program: str) -> subprocess.Popen:
        started.append(subprocess.Popen([sys.executable, "-c", program]))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def test_a_real_leak_is_seen(child: Callable[[str], subprocess.Popen]) -> None:
    leaks = "import time\nkept = []\nwhile True: kept.append((bytes(1 << 20).replace(b'\\0', b'x'), open('/dev/null')))"
    process = child(leaks + "; time.sleep(0.02)")
    failed = judge(watch(process, lambda: 0, seconds=2.0, interval=0.05))["failed"]
    assert [text.split(" grew")[0] for text in failed] == ["memory", "open files"]


def test_a_command_that_ends_is_not_waited_for(child: Callable[[str], subprocess.Popen]) -> None:
    with pytest.raises(RunError, match=r"ended by itself .* exit code 3"):
        watch(child("raise SystemExit(3)"), lambda: 0, seconds=60.0, interval=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["train", "codesign"])
def test_a_minute(warpvox: Callable, command: str) -> None:
    small = {
        "train": ["num_envs=32", "ppo.steps=8"],
        "codesign": ["search.population=3", "training.envs=8", "training.iterations=4", "training.ppo.steps=8"],
    }
    words = [f"soak.command={command}", f"soak.overrides={small[command]}", "soak.seconds=60", "soak.interval=0.5"]
    warpvox("bench", "suite=soak", *words)  # a minute is too short for the judgement to mean much
    (folder,) = Path("outputs/bench/soak").iterdir()
    figures = json.loads((folder / "summary.json").read_text())
    assert figures["steps"] > 0
    assert len(figures["samples"]) > 50
