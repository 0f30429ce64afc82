"""Repeats trainings of the zoo's robots with other seeds, into ``docs/results/repeats.csv``. Not part of the library.

    python docs/repeats.py [FOLDER [TASK ...]]   # those without a row: outputs/repeats, all robots that were trained

The commands are those of an entry (``warpvox zoo task=TASK``) with another seed, for the same body, and the best policy
is judged under noise as an entry is. With the entry itself each task has :data:`RUNS` of them. Several processes may
share a folder, in which the runs stay; what is interrupted begins anew. ``docs/results.md`` shows the table.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import warpvox as wv
from warpvox.algos.codesign.robots import robots_of
from warpvox.envs.registry import task_ids
from warpvox.errors import RunError
from warpvox.io.reading import read_table
from warpvox.io.writing import claimed, write_table
from warpvox.robots.returns import judge_robust
from warpvox.runs import BEST, read_summary

TABLE = Path(__file__).resolve().parent / "results" / "repeats.csv"
COLUMNS = ("task", "seed", "noise", "control_steps", "seconds", "processor", "commit")
"""``noise``: the mean of 32 episodes with noise on the actions."""
RUNS = 5
NOISE = "noise"
TRAIN = "warpvox train "


def seeds_of(task: str) -> list[int]:
    """The first seeds that the entry of ``task`` does not come from."""
    own = wv.zoo(task).about["config"]["seed"]
    return [seed for seed in range(RUNS) if seed != own][: RUNS - 1]


def repeat(task: str, seed: int, folder: Path) -> Path:
    """Run the commands of the zoo's robot of ``task`` with another seed; returns the folder of the last."""
    shutil.rmtree(folder / "train", ignore_errors=True)
    about, place = wv.zoo(task).about, folder
    for number, one in enumerate([*about.get("start", ()), about]):
        words = [
            word for word in one["command"].removeprefix(TRAIN).split() if not word.startswith(("seed=", "pretrained="))
        ]
        words += [f"seed={seed}", f"output_dir={folder}", f"name={number}"]
        words += [f"pretrained={place / BEST}"] if number else []
        subprocess.run([sys.executable, "-m", "warpvox", "train", *words], check=True, stdout=subprocess.DEVNULL)
        (place,) = folder.glob(f"train/*/*_{number}")
    return place


def run(folder: Path, tasks: Sequence[str]) -> None:
    """Make the repeats that are not in the table."""
    for task, seed in [(one, seed) for one in tasks for seed in seeds_of(one)]:
        place = folder / f"{task}-{seed}"
        place.mkdir(parents=True, exist_ok=True)
        try:
            with claimed(place):
                if any((row["task"], row["seed"]) == (task, str(seed)) for row in read_table(TABLE)):
                    continue
                print(task, seed, flush=True)
                store(task, seed, repeat(task, seed, place))
        except RunError as error:  # another process makes it
            print(error, flush=True)


def store(task: str, seed: int, place: Path) -> None:
    """Judge the robot of a run and add its row to the table."""
    robot, summary = next(robots_of(place, 1)), read_summary(place)
    returns = judge_robust(robot, NOISE)[NOISE]
    row = {"task": task, "seed": seed, "noise": f"{sum(returns) / len(returns):.6g}"}
    row |= {"control_steps": robot.about["control_steps"], "seconds": f"{robot.about['wall_s']:.0f}"}
    row |= {name: summary.get(name) for name in ("processor", "commit")}
    print(*row.values(), flush=True)
    with claimed(TABLE.parent, wait=True):
        rows = [*read_table(TABLE), row]
        rows.sort(key=lambda one: (task_ids().index(one["task"]), int(one["seed"])))
        write_table(TABLE, COLUMNS, [[one[name] for name in COLUMNS] for one in rows])


if __name__ == "__main__":
    place, *tasks = sys.argv[1:] or ["outputs/repeats"]
    run(Path(place), tasks or [task for task in task_ids() if wv.zoo(task).about["command"].startswith(TRAIN)])
