"""Everything that is made with a seed, made once: a program that prints ``{what: digest}`` as JSON in its last line.

    python labour.py FOLDER THREADS

A part whose packages are not installed is left out.
"""

import csv
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch

from warpvox.cli import main

TINY = "device=cpu task=Walker-v0"
TRAIN = (
    "design=mini num_envs=16 lanes=8 ppo.steps=4 ppo.hidden=[8] ppo.epochs=2 max_iterations=3 eval_interval=1"
    " seed=4"  # two packs, one for each of two threads
)
SEARCH = (
    "shape=[3,3] search.population=4 search.max_designs=6 training.envs=8 training.iterations=2"
    " training.eval_interval=1 training.ppo.steps=4 training.ppo.hidden=[8] training.ppo.epochs=1 seed=4"
)
PLAY = "task=Catcher-v0 agent=random design=mini num_envs=2 steps=12 seed=4 window=off size=[160,120]"
TIMES = ("steps_per_second", "elapsed")
FORMATS = {"usd": "pxr", "html": None, "png": "PIL", "strip": "PIL", "gif": "imageio", "mp4": "imageio_ffmpeg"}
FILES = {"usd": "rollout.usd", "strip": "rollout_strip.png"}
NEEDS = {"bo": "botorch", "map_elites": "ribs"}
HASTY = {"bo": {"optimizer_restarts": 1, "optimizer_iterations": 5, "candidates": 40}}
GENERATIONS = 3


def sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def command(name: str, words: str, threads: int) -> Path:
    before = set(Path("outputs").glob(f"{name}/*/*"))
    if main([name, *words.split(), f"threads={threads}"]) != 0:
        raise SystemExit(f"warpvox {name} has failed")
    (folder,) = set(Path("outputs").glob(f"{name}/*/*")) - before
    return folder


def training(threads: int) -> Iterator[tuple[str, str]]:
    """PPO by rsl-rl: the state that is saved, byte for byte, and what was noted on the way but for durations."""
    folder = command("train", f"{TINY} {TRAIN}", threads)
    for name in ("model_3.pt", "model_best.pt"):
        yield f"training: {name}", sha((folder / name).read_bytes())
    with open(folder / "metrics.csv", encoding="utf-8") as file:
        rows = [{name: value for name, value in row.items() if name not in TIMES} for row in csv.DictReader(file)]
    yield "training: metrics", sha(json.dumps(rows).encode())


def codesign(threads: int) -> Iterator[tuple[str, str]]:
    """A search over two generations, each trained at once: all candidates, curves and policies."""
    from warpvox.algos.archive import FILE, Archive

    folder = command("codesign", f"{TINY} {SEARCH}", threads)
    with Archive.read(folder / FILE) as archive:
        yield "codesign: archive", archive.digest()[:16]


def proposals() -> Iterator[tuple[str, str]]:
    """What each search proposes over a few generations."""
    from warpvox.algos.search.factory import make_search
    from warpvox.algos.search.settings import ALGORITHMS

    for name, settings in ALGORITHMS.items():
        if name == "custom" or (name in NEEDS and find_spec(NEEDS[name]) is None):
            continue
        search = make_search(settings(population=6, max_designs=30, **HASTY.get(name, {})), (4, 4), 4)
        seen = []
        for _ in range(GENERATIONS):
            asked = search.ask()
            seen += [[c.id, c.body.tolist(), list(c.parents), c.origin] for c in asked]
            search.tell([float(np.mean(c.body >= 3) - 0.3 * np.mean(c.body == 1)) for c in asked])
        yield f"search: {name}", sha(json.dumps(seen).encode())


def files(threads: int) -> Iterator[tuple[str, str]]:
    """A rollout and all that is made from one, byte for byte."""
    formats = [name for name, package in FORMATS.items() if package is None or find_spec(package)]
    folder = command("play", f"device=cpu {PLAY} export=[{','.join(formats)}]", threads)
    for name in ("rollout.npz", *(FILES.get(name, f"rollout.{name}") for name in formats)):
        yield f"file: {name}", sha((folder / name).read_bytes())


def everything(threads: int) -> dict[str, str]:
    """All parts, made in the current folder by simulations with so many threads."""
    torch.set_num_threads(1)
    return dict([*training(threads), *codesign(threads), *files(threads), *proposals()])


if __name__ == "__main__":
    place = Path(sys.argv[1])
    place.mkdir(parents=True, exist_ok=True)
    os.chdir(place)
    print(json.dumps(everything(int(sys.argv[2]))))
