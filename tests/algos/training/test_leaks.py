"""Memory and open files of a training and of a design search stay what they are, however long they go on."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="/proc is needed to watch a process"),
]
SECONDS = float(os.environ.get("WARPVOX_LEAK_SECONDS", "60"))
GROWTH = 0.02  # of memory, from the second quarter of the time to the last; the first loads kernels and fills caches
ENDLESS = 10**5
TERMINATED = 143
COMMANDS = {
    "train": f"train num_envs=32 ppo.steps=8 max_iterations={ENDLESS} eval_interval=20 save_interval=20",
    "codesign": f"codesign search.population=3 search.max_designs={ENDLESS} training.envs=8 training.iterations=4"
    " training.ppo.steps=8",
}


def watch(process: subprocess.Popen, seconds: float) -> list[tuple[int, int]]:
    """Bytes in memory and open files of a process, every half second or more often."""
    place, found, began = Path("/proc") / str(process.pid), [], time.monotonic()
    while time.monotonic() - began < seconds:
        assert process.poll() is None, "it ended by itself"
        pages = int((place / "statm").read_text().split()[1])
        found.append((pages * os.sysconf("SC_PAGE_SIZE"), len(os.listdir(place / "fd"))))
        time.sleep(min(0.5, seconds / 100))
    return found


def growth(samples: list[tuple[int, int]]) -> tuple[float, int]:
    """From the second quarter to the last: growth of the most memory, and of the fewest files (others are closed)."""
    quarter = len(samples) // 4
    middle, last = samples[quarter : 2 * quarter], samples[-quarter:]
    memory = max(memory for memory, _ in last) / max(memory for memory, _ in middle) - 1
    return memory, min(files for _, files in last) - min(files for _, files in middle)


@pytest.mark.parametrize("command", ["train", "codesign"])
def test_nothing_leaks(command: str, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "warpvox", *COMMANDS[command].split(), "threads=1", f"output_dir={tmp_path}"]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        while not list(tmp_path.rglob("*.pt" if command == "train" else "archive.sqlite")):  # kernels may be compiled
            watch(process, 0.5)
        memory, files = growth(watch(process, SECONDS))
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == TERMINATED
    finally:
        process.kill()
        process.wait()
    assert memory < GROWTH
    assert files <= 0
