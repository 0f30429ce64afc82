"""Repeats trainings of the zoo's robots with other seeds, into ``docs/results/repeats.csv``. Not part of the library.

    python docs/repeats.py [FOLDER [TASK ...]]   # those without a row: outputs/repeats, all robots that were trained

The commands are those of an entry (``warpvox zoo task=TASK``) with another seed, for the same body, and the best policy
is judged under noise as an entry is; the entry itself counts as one of five. Several processes may share a folder, in
which the runs stay; an interrupted one is started again from its beginning. ``docs/results.md`` shows the table.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from results import REPEATED, RUNS, write_table

import warpvox as wv
from warpvox.algos.codesign.robots import robots_of
from warpvox.envs.registry import task_ids
from warpvox.errors import RunError
from warpvox.io.reading import read_table
from warpvox.io.writing import claimed
from warpvox.robots import Robot
from warpvox.robots.returns import recorded
from warpvox.runs import BEST

TRAIN = "warpvox train "


def run(folder: Path, tasks: Sequence[str]) -> None:
    """Add the rows that the table lacks."""
    for task, seed in [(one, seed) for one in tasks for seed in range(RUNS)]:
        place = folder / f"{task}-{seed}"
        place.mkdir(parents=True, exist_ok=True)
        try:
            with claimed(place):
                if any((row["task"], row["seed"]) == (task, str(seed)) for row in read_table(REPEATED)):
                    continue
                print(task, seed, flush=True)
                own = wv.zoo(task)
                store(seed, own if own.about["config"]["seed"] == seed else repeat(own, seed, place))
        except RunError as error:  # another process makes it
            print(error, flush=True)


def repeat(robot: Robot, seed: int, folder: Path) -> Robot:
    """The robot that the commands of one of the zoo give with another seed, with its returns under noise."""
    shutil.rmtree(folder / "train", ignore_errors=True)
    place = folder
    for number, one in enumerate([*robot.about.get("start", ()), robot.about]):
        given = one["command"].removeprefix(TRAIN).split()
        words = [word for word in given if not word.startswith(("seed=", "pretrained="))]
        words += [f"seed={seed}", f"output_dir={folder}", f"name={number}"]
        words += [f"pretrained={place / BEST}"] if number else []
        subprocess.run([sys.executable, "-m", "warpvox", "train", *words], check=True, stdout=subprocess.DEVNULL)
        (place,) = folder.glob(f"train/*/*_{number}")
    found = next(robots_of(place, 1))
    return recorded(found, found.about)


def store(seed: int, robot: Robot) -> None:
    """Add the row of a robot; ``noise`` is the mean of 32 episodes with noise on the actions."""
    about = robot.about
    row = {"task": robot.task, "seed": seed, "noise": f"{robot.robust_return:.6g}"}
    row |= {"control_steps": about["control_steps"], "seconds": f"{about['wall_s']:.0f}"}
    row |= {name: about[name] for name in ("processor", "commit")}
    print(*row.values(), flush=True)
    with claimed(REPEATED.parent, wait=True):
        write_table(REPEATED, sorted([*read_table(REPEATED), row], key=lambda one: int(one["seed"])))


if __name__ == "__main__":
    place, *tasks = sys.argv[1:] or ["outputs/repeats"]
    run(Path(place), tasks or [task for task in task_ids() if wv.zoo(task).about["command"].startswith(TRAIN)])
