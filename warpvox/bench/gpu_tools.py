"""NVIDIA's tools and torch's profiler in ``warpvox bench suite=gpu``, where the machine has them."""

import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import torch

from warpvox.bench.cases import make, one_body
from warpvox.bench.report import Report
from warpvox.bench.runner import training_of
from warpvox.errors import SimulationError
from warpvox.io.writing import write_text

TOOLS = "memcheck", "racecheck", "synccheck", "initcheck"
LARGE = "Climber-v1", "Traverser-v0"
"""Tasks in which 64 and 128 threads take an environment."""
SECONDS = 90
"""For one run under a tool, at most."""
TOOLKIT = "/usr/local/cuda/bin"
ONE_LAUNCH = "--set full --clock-control none --kernel-name regex:group_step --launch-skip 1 --launch-count 1".split()
ITERATIONS, LINES = 3, 40
"""Iterations of the training that is profiled; rows of its table."""


def sanitizer(config: Any, report: Report) -> None:
    """Control steps under compute-sanitizer, all tools at once: different bodies, then worlds of several warps each."""
    program, wrong = _find("compute-sanitizer", report), []
    if program is None:
        return

    def watched(task: str, bodies: int, tool: str) -> subprocess.CompletedProcess[str] | None:
        words = [program, "--tool", tool, "--error-exitcode", "9"]
        return _sample(words, config, report, task, envs=64, bodies=bodies)

    runs = [(*case, tool) for case in ((config.task, 8), *((task, 0) for task in LARGE)) for tool in TOOLS]
    with ThreadPoolExecutor(len(TOOLS)) as pool:
        outcomes = list(pool.map(watched, *zip(*runs, strict=True)))
    for (task, _, tool), done in zip(runs, outcomes, strict=True):
        if done is None:
            continue
        last = [line for line in done.stdout.splitlines() if "SUMMARY" in line][-1:] or [done.stderr[-300:]]
        good = done.returncode == 0
        report.row("sanitizer", f"{task}, {tool}: {last[0].strip('= ')}", task=task, tool=tool, good=good, said=last[0])
        if not good:
            write_text(report.folder / f"{tool}_{task}.txt", done.stdout + done.stderr)
            wrong.append(f"{tool} in {task}")
    if wrong:
        raise SimulationError(f"compute-sanitizer complains: {', '.join(wrong)}; see the files in the folder.")


def profile(config: Any, report: Report, count: int) -> None:
    """The group kernel under Nsight Compute (``ncu.txt``), and a training under torch's profiler (``profile.txt``)."""
    program = None if config.device == "cpu" else _find("ncu", report)
    if program and (done := _sample([program, *ONE_LAUNCH], config, report, config.task, envs=count, bodies=1)):
        write_text(report.folder / "ncu.txt", done.stdout + done.stderr)
        report.row("profile", "ncu.txt", noted=True, tool="ncu", good=done.returncode == 0)
    training = training_of(make(config, [one_body(config)], count))
    training.learn(1)
    with torch.profiler.profile() as found:  # of all that this torch can follow
        training.learn(ITERATIONS)
    order = "self_cpu_time_total" if config.device == "cpu" else "self_device_time_total"
    table = found.key_averages().table(sort_by=order, row_limit=LINES, max_name_column_width=80)
    write_text(report.folder / "profile.txt", table)
    report.row("profile", f"profile.txt, {ITERATIONS} iterations of {count:,} environments", noted=True, tool="torch")


def _find(name: str, report: Report) -> str | None:
    """A program on PATH or in the CUDA toolkit; if there is none it is said."""
    found = shutil.which(name) or shutil.which(name, path=TOOLKIT)
    if found is None:
        report.note(f"There is no {name} here: left out.")
    return found


def _sample(
    words: list[str], config: Any, report: Report, task: str, envs: int, bodies: int
) -> subprocess.CompletedProcess[str] | None:
    """Two control steps under a tool; None if that takes too long, which is said."""
    limit = max(1.0, min(SECONDS, report.left))
    options = json.dumps({"task": task, "num_envs": envs, "device": config.device})
    command = [*words, sys.executable, "-m", "warpvox.bench.sample", options, str(bodies), "2"]
    # with torch's cache of memory nothing that is written beyond an array would show
    surroundings = os.environ | {"PYTORCH_NO_CUDA_MEMORY_CACHING": "1"}
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=limit, env=surroundings)
    except subprocess.TimeoutExpired:
        report.note(f"{Path(words[0]).name} {' '.join(words[1:3])} was stopped after {limit:.0f} s.")
        return None
