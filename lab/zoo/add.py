"""Add the best robot of each search or training to the zoo, if better under noise than the present entry.

python -m lab.zoo.add FOLDER ...    # of searches, of designs in them (designs/17) or of trainings; or checkpoints
"""

from __future__ import annotations

import argparse
import copy
import dataclasses
import json
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

import warpvox as wv
from warpvox.algos.codesign.robots import robots_of
from warpvox.algos.robots import Robot, judge, read_robot, save_robot

ENTRIES = Path(__file__).resolve().parents[2] / "warpvox" / "data"
"""Folder of the packaged zoo."""
RECORDED_SEED, CHOOSING_SEED = 1000, 2000
"""First seeds of the noisy episodes for an entry's record, and for choosing between robots."""
RECORDED_EPISODES, CHOOSING_EPISODES = 32, 128
FEEDBACK_MARGIN = 1e-3
"""Relative margin by which a gait must beat a policy with feedback."""
DIGITS = 9
"""Decimals of recorded returns."""
WEIGHT_BITS = 8
"""Number of low bits of each weight (of 23) set to zero, so that the compressed zoo fits into a megabyte."""
COUNTED = ("control_steps", "wall_s")
"""Costs of an entry, including those of earlier robots and policies."""
ELSEWHERE = {"output_dir", "name", "resume", "preset", "threads", "device", "executor", "workers"}
"""Keys that do not affect results or name places on a machine."""
PLAIN = re.compile(r"[\w./:+-]+")
"""Pattern of text that Hydra reads without quotes."""


def read_arguments(words: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sources", nargs="+", type=Path, metavar="FOLDER")
    parser.add_argument("--folder", type=Path, default=ENTRIES, help="folder of the entries; without, the package's")
    parser.add_argument("--top", type=int, default=10, help="best designs of a search that are compared (10)")
    return parser.parse_args(words)


def add(source: Path, folder: Path, top: int) -> str:
    """Compare the robots of ``source`` with the zoo's entry for their task, and write the best if better.

    Returns a line that says what was done.

    Raises:
        WarpvoxError: there are no robots in ``source``, or their task is none of the benchmark's.
    """
    robots = [shortened(robot) for robot in robots_of(source, top)]
    if not robots:
        raise wv.RunError(f"{source} has no design with a policy yet.")
    about = facts(source)

    # The best of the robots, by episodes that its entry does not record
    found = [returns_under_noise(robot, CHOOSING_SEED, CHOOSING_EPISODES) for robot in robots]
    best = int(np.argmax([np.mean(returns) for returns in found]))
    robot = robots[best]
    line = f"{robot.task}: {np.mean(found[best]):.6f} under noise"

    # The entry that there is, in the same episodes
    path = folder / f"{robot.task}.npz"
    known = read_robot(path) if path.is_file() else None
    if known is not None and known.policy is not None:
        returns = returns_under_noise(known, CHOOSING_SEED, CHOOSING_EPISODES)
        line += f", the entry {np.mean(returns):.6f}"
        if not is_better(robot, found[best], known, returns):
            return f"{line}; kept the entry"

    save_robot(path, dataclasses.replace(robot, about=measured(robot) | about))
    return f"{line}; wrote {path}"


def is_better(robot: Robot, returns: list[float], known: Robot, known_returns: list[float]) -> bool:
    """Return whether the mean of ``returns`` is higher, with a margin (:data:`FEEDBACK_MARGIN`) for feedback."""
    ours, theirs = float(np.mean(returns)), float(np.mean(known_returns))
    if robot.has_feedback and not known.has_feedback:
        return ours >= theirs - FEEDBACK_MARGIN * abs(theirs)
    if known.has_feedback and not robot.has_feedback:
        return theirs < ours - FEEDBACK_MARGIN * abs(ours)
    return ours > theirs


def shortened(robot: Robot) -> Robot:
    """Zero the low bits of a network's weights."""
    if robot.policy is None or not robot.has_feedback:
        return robot
    policy = copy.deepcopy(robot.policy)
    for values in policy.parameters():
        values.copy_(torch.from_numpy(_rounded(values.numpy())))
    return dataclasses.replace(robot, policy=policy)


def _rounded(values: np.ndarray) -> np.ndarray:
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32).astype(np.uint64) + (1 << (WEIGHT_BITS - 1))
    return (bits & ~np.uint64((1 << WEIGHT_BITS) - 1)).astype(np.uint32).view(np.float32)


def returns_under_noise(robot: Robot, seed: int, episodes: int) -> list[float]:
    """Run episodes with action noise in exact arithmetic, and return the returns."""
    with tempfile.TemporaryDirectory() as folder:
        file = save_robot(Path(folder) / "robot.npz", robot)
        (row,) = wv.evaluate(f"zoo:{file}", protocol="noise", seed=seed, episodes=episodes, device="cpu")
    return [round(value, DIGITS) for value in row.returns]


def measured(robot: Robot) -> dict[str, Any]:
    """Measure the returns recorded in an entry: undisturbed and under noise."""
    nominal = judge(robot)
    noisy = returns_under_noise(robot, RECORDED_SEED, RECORDED_EPISODES)
    return {
        "return": nominal.mean_return,
        "returns": nominal.returns,
        "lengths": nominal.lengths,
        "seeds": nominal.seeds,
        "noise": {"return": round(sum(noisy) / len(noisy), DIGITS), "returns": noisy},
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%d"),
    }


def facts(source: Path) -> dict[str, Any]:
    """Read a run's command, configuration and version, and its cost including earlier runs.

    ``start`` are the facts of the robots and policies that it began with, the earliest first.
    """
    home = source if source.is_dir() else source.parent
    if (home.parent.parent / "archive.sqlite").is_file():  # a design: what it has cost is the search
        home = home.parent.parent
    summary = json.loads((home / "summary.json").read_text(encoding="utf-8"))
    config = yaml.safe_load((home / "config.yaml").read_text(encoding="utf-8"))
    about = {name: summary.get(name) for name in ("version", "commit", "processor")}
    about |= {"control_steps": summary["steps"], "wall_s": summary["elapsed_seconds"]}

    start = []
    for one in earlier(home, config):
        start += [*one.pop("start", ()), one] if one else []
        for name in COUNTED:
            about[name] = None if None in (about[name], one.get(name)) else about[name] + one[name]
    if start:
        about["start"] = start

    config = {name: value for name, value in config.items() if name not in ("output_dir", "name")}
    if config.get("pretrained"):
        config["pretrained"] = _path_end(config["pretrained"])
    if config.get("start"):
        config["start"] = [text if ":" in text else _path_end(text) for text in config["start"]]
    return about | {"command": command_of(config), "config": config}


def earlier(home: Path, config: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Read the facts of the runs and robots that a run started from; costs are missing for deleted runs."""
    runs = [config["pretrained"]] if config.get("pretrained") else config.get("start", [])
    for text in runs:
        place = Path(text)
        if (place if place.is_dir() else place.parent).joinpath("summary.json").is_file():
            yield facts(place)
        elif config.get("pretrained"):
            yield {}
    for file in sorted((home / "training" / "start").glob("*.npz")):
        robot = read_robot(file)
        if robot.about:
            names = ("return", *COUNTED, "processor", "commit", "command", "start")
            known = {name: robot.about[name] for name in names if name in robot.about}
            yield {"task": robot.task, "sha256": robot.sha256} | known


def command_of(config: dict[str, Any]) -> str:
    """Reconstruct the command from ``config``, the content of a ``config.yaml``, without default keys."""
    words = ["train"]
    if "search" in config:
        words = ["codesign", f"search={config['search']['algorithm']}", f"fitness={config['fitness']['name']}"]
    line = [sys.executable, "-m", "warpvox", *words, "--cfg", "job"]
    usual = yaml.safe_load(subprocess.run(line, check=True, stdout=subprocess.PIPE, encoding="utf-8").stdout)
    preset = wv.Physics.preset(config["physics"]["preset"])  # a run's configuration has all constants
    usual["physics"] = dataclasses.asdict(preset) | {"preset": config["rules"]}
    return shlex.join(["warpvox", *words, *_differences(config, usual)])


def _differences(config: dict[str, Any], usual: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for name, value in config.items():
        if name in ELSEWHERE or name not in usual or value == usual[name]:
            continue
        if isinstance(value, dict) and isinstance(usual[name], dict):
            yield from _differences(value, usual[name], f"{prefix}{name}.")
        elif isinstance(value, str) and PLAIN.fullmatch(value):
            yield f"{prefix}{name}={value}"
        else:
            yield f"{prefix}{name}={json.dumps(value, separators=(',', ':'))}"


def _path_end(path: str) -> str:
    """Return the last parts of a path that are meaningful on another machine."""
    return "/".join(Path(path).parts[-3:])


def main(given: argparse.Namespace) -> int:
    failed = 0
    for source in given.sources:
        try:
            print(f"{source}: {add(source, given.folder, given.top)}", flush=True)
        except (wv.WarpvoxError, OSError) as error:
            print(f"{source}: {error}", flush=True)
            failed = 1
    return failed


if __name__ == "__main__":
    sys.exit(main(read_arguments()))
