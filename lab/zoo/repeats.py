"""Repeated training of the zoo's robots with other seeds: python -m lab.zoo.repeats [TASK ...]

A training runs by the commands of its entry with another seed, for the same body. Its best policy is measured under
noise, as an entry is, and becomes a row of repeats.csv; the entry itself counts as one of five. What has a row is left
out.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import warpvox as wv
from lab.zoo.add import RECORDED_EPISODES, RECORDED_SEED, facts, returns_under_noise, shortened
from lab.zoo.results import REPEATED, RUNS, read_table, write_table
from warpvox.algos.codesign.robots import robots_of

TRAIN = ["warpvox", "train"]


def read_arguments(words: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", help="without, all whose robot was trained by `warpvox train`")
    parser.add_argument("--folder", type=Path, default=Path("outputs/repeats"), help="where the runs are written")
    return parser.parse_args(words)


def main(given: argparse.Namespace) -> None:
    trained = [task for task in wv.task_ids() if shlex.split(wv.zoo(task).about["command"])[:2] == TRAIN]
    for task in given.tasks or trained:
        for seed in range(RUNS):
            if any((row["task"], row["seed"]) == (task, str(seed)) for row in read_table(REPEATED)):
                continue
            print(task, seed, flush=True)
            about = wv.zoo(task).about
            if about["config"]["seed"] == seed:
                store(task, seed, wv.zoo(task).robust_return, about)
            else:
                place = repeat(about, seed, given.folder / f"{task}-{seed}")
                robot = shortened(robots_of(place)[0])
                returns = returns_under_noise(robot, RECORDED_SEED, RECORDED_EPISODES)
                store(task, seed, float(np.mean(returns)), facts(place))


def repeat(about: Mapping[str, Any], seed: int, folder: Path) -> Path:
    """Repeat an entry's chain of trainings with another seed; return the last run's folder."""
    shutil.rmtree(folder, ignore_errors=True)  # of a repeat that was interrupted
    place = None
    for number, one in enumerate([*about.get("start", ()), about]):
        words = repeated(one["command"], seed, place)
        line = [sys.executable, "-m", *words, f"output_dir={folder}", f"name={number}"]
        subprocess.run(line, check=True, stdout=subprocess.DEVNULL)
        (place,) = folder.glob(f"train/*/*_{number}")
    assert place is not None
    return place


def repeated(command: str, seed: int, before: Path | None) -> list[str]:
    """Change a command to another seed and to the policy of the run ``before``."""
    words = [word for word in shlex.split(command) if not word.startswith(("seed=", "pretrained="))]
    begin = [] if before is None else [f"pretrained={before}"]
    return [*words, f"seed={seed}", *begin]


def store(task: str, seed: int, noise: float, about: Mapping[str, Any]) -> None:
    """Append a row of results; ``noise`` is the mean return under noise."""
    row = {"task": task, "seed": str(seed), "noise": f"{noise:.6g}"}
    row |= {"control_steps": str(about["control_steps"]), "seconds": f"{about['wall_s']:.0f}"}
    row |= {name: str(about[name]) for name in ("processor", "commit")}
    print(*row.values(), flush=True)
    write_table(REPEATED, sorted([*read_table(REPEATED), row], key=lambda one: int(one["seed"])))


if __name__ == "__main__":
    main(read_arguments())
