"""``warpvox bench suite=soak``: a training or a design search for an hour, watched from outside.

A leak shows after hours, in memory, in files left open or in speed. The command runs in a process of its own, as a user
would start it, and is interrupted at the end as a user would. Speed is counted in control steps per second of CPU time,
which another program on the machine disturbs little.
"""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from warpvox.algos.checkpoints.files import read_tensors
from warpvox.algos.codesign.archive import FILE as ARCHIVE
from warpvox.algos.codesign.archive import Archive
from warpvox.algos.training.metrics import FILE as METRICS
from warpvox.bench.report import Report, number
from warpvox.errors import ConfigError, RunError
from warpvox.system import knows_processes, own_group, usage_of

__all__ = ["Sample", "judge", "run", "watch"]

ENDLESS = 10**5
"""Iterations or evaluations that no hour is long enough for."""
GRACE = 600.0
"""Seconds that the command may take to save its state when it is interrupted."""
TERMINATED = 143
MEMORY_LIMIT, SPEED_LIMIT = 0.02, 0.10
"""Growth of memory and loss of speed (shares) that make the suite fail. Speed varies with what else the machine does,
also by CPU time: caches and clocks are shared."""

COMMANDS = {
    "train": [f"max_iterations={ENDLESS}", "eval_interval=20", "save_interval=20"],
    "codesign": [f"search.max_evaluations={ENDLESS}"],
}
"""What is added to the task and threads of the configuration, by the command that is watched."""


@dataclass(frozen=True)
class Sample:
    """A look at the process: seconds since its start, CPU seconds, bytes in memory, open files, control steps done."""

    seconds: float
    cpu: float
    memory: int
    files: int
    steps: int


def run(config: Any, report: Report) -> dict[str, Any]:
    """Watch one command for ``soak.seconds`` and judge memory, open files and speed.

    Raises:
        ConfigError: the system does not tell about processes. RunError: the command ended by itself or badly.
    """
    if not knows_processes():
        raise ConfigError("suite=soak reads /proc, which this system does not have; run it on Linux.")
    options = config.soak
    words = [options.command, f"task={config.task}", f"threads={config.threads}", *COMMANDS[options.command]]
    words += [f"device={config.device}", f"output_dir={report.folder / 'runs'}", *options.overrides]
    log = report.folder / "output.txt"
    with report.status(f"{options.command} for {options.seconds:,.0f} s"), open(log, "wb") as output:
        command = [sys.executable, "-m", "warpvox", *words]
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, **own_group())
        try:
            samples = watch(process, _progress(report.folder / "runs"), options.seconds, options.interval)
            process.terminate()  # SIGINT is ignored where this process was told to ignore it
            code = process.wait(GRACE)
        finally:
            process.kill()
            process.wait()
    if code != TERMINATED:
        raise RunError(
            f"Asked to end, the command ended with exit code {code} in place of {TERMINATED}: {_last_line(log)}"
        )
    state = _check_state(report.folder / "runs")
    figures = judge(samples)
    _show(config, report, figures, state)
    report.plot("soak", lambda figure: _draw(figure, samples))
    rows = [[item.seconds, item.cpu, item.memory, item.files, item.steps] for item in samples]
    return {"command": options.command, "task": config.task, **figures, "samples": rows}


def watch(process: Any, progress: Callable[[], int], seconds: float, interval: float) -> list[Sample]:
    """Look at a running process (a ``subprocess.Popen``) every ``interval`` seconds, for so long.

    Raises:
        RunError: it ended before.
    """
    began, samples = time.monotonic(), []
    while (now := time.monotonic() - began) < seconds:
        if process.poll() is not None:
            raise RunError(f"The command ended by itself after {now:,.0f} s with exit code {process.returncode}.")
        samples.append(_look(process.pid, now, progress()))
        time.sleep(interval)
    return samples


def judge(samples: list[Sample]) -> dict[str, Any]:
    """Compare the last quarter with the second (the first one loads kernels and fills caches).

    Memory and open files: the most that was seen in each quarter. Speed: control steps per CPU second of the third
    and fourth quarter together against the second; None if too few steps were counted to tell.
    """
    end = samples[-1].seconds
    second, third, last = ([item for item in samples if low <= item.seconds / end <= low + 0.25] for low in QUARTERS)
    memory = [max(item.memory for item in part) for part in (second, last)]
    files = [max(item.files for item in part) for part in (second, last)]
    speed = [_rate(part) for part in (second, third + last)]
    growth = memory[1] / memory[0] - 1
    loss = None if None in speed else 1 - speed[1] / speed[0]
    failed = []
    if growth > MEMORY_LIMIT:
        failed.append(f"memory grew by {growth:.1%}")
    if files[1] > files[0]:
        failed.append(f"open files grew from {files[0]} to {files[1]}")
    if loss is not None and loss > SPEED_LIMIT:
        failed.append(f"speed fell by {loss:.1%}")
    return {
        "seconds": end,
        "steps": samples[-1].steps,
        "memory": memory,
        "memory_growth": growth,
        "files": files,
        "speed": speed,
        "speed_loss": loss,
        "failed": failed,
    }


QUARTERS = (0.25, 0.5, 0.75)


def _rate(part: list[Sample]) -> float | None:
    """Control steps per CPU second, between the first and the last time that the count of steps moved."""
    moved = [after for before, after in pairwise(part) if after.steps > before.steps]
    if len(moved) < 2:
        return None
    return (moved[-1].steps - moved[0].steps) / (moved[-1].cpu - moved[0].cpu)


def _look(pid: int, seconds: float, steps: int) -> Sample:
    return Sample(seconds, *usage_of(pid), steps)


def _last_line(log: Path) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    return next((line.strip() for line in reversed(lines) if line.strip()), "it said nothing")


def _progress(runs: Path) -> Callable[[], int]:
    """A function that says how many control steps the run in this folder has written down."""

    def steps() -> int:
        for path in runs.rglob(METRICS):
            lines = path.read_bytes().splitlines()
            return int(lines[-1].split(b",")[1]) if len(lines) > 1 else 0
        for path in runs.rglob(ARCHIVE):
            try:
                with Archive.read(path) as archive:
                    return sum(row["steps"] or 0 for row in archive.generations())
            except (RunError, sqlite3.Error):  # not yet all there
                return 0
        return 0

    return steps


def _check_state(runs: Path) -> str:
    """What was saved, after it has been read.

    Raises:
        RunError: a file that cannot be read, or none.
    """
    checkpoints = sorted(runs.rglob("*.pt"))
    for path in checkpoints:
        read_tensors(path)
    for path in runs.rglob(ARCHIVE):
        with Archive.read(path) as archive:
            return f"{archive.trained()} designs in the archive, {len(checkpoints)} policies and checkpoints read"
    if not checkpoints:
        raise RunError("The command has left no checkpoint; give it more time: soak.seconds.")
    return f"{len(checkpoints)} checkpoints read"


def _show(config: Any, report: Report, figures: dict[str, Any], state: str) -> None:
    shown = [number(value / 2**20) for value in figures["memory"]], [str(count) for count in figures["files"]]
    rates = [number(rate) for rate in figures["speed"]]
    loss = figures["speed_loss"]
    rows = [
        ["memory, MiB", *shown[0], f"{figures['memory_growth']:+.2%}"],
        ["open files", *shown[1], f"{figures['files'][1] - figures['files'][0]:+d}"],
        ["control steps per CPU second", *rates, "-" if loss is None else f"{-loss:+.2%}"],
    ]
    title = (
        f"`warpvox {config.soak.command}` on {config.task} for {figures['seconds'] / 60:.0f} minutes,"
        f" {config.threads} threads, {figures['steps']:,} control steps"
    )
    report.table(title, ["most in", "second quarter", "last quarter (speed: half)", "change"], rows)
    report.note(f"Interrupted at the end: {state}.")


def _draw(figure: Any, samples: list[Sample]) -> None:
    above, below = figure.subplots(2, 1, sharex=True)
    minutes = [item.seconds / 60 for item in samples]
    above.plot(minutes, [item.memory / 2**20 for item in samples])
    above.set(ylabel="memory, MiB", ylim=(0, None))
    below.plot(minutes, [item.steps / 1e6 for item in samples])
    below.set(xlabel="minutes", ylabel="million control steps")
    for axes in (above, below):
        axes.grid(alpha=0.3)
