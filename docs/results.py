"""Makes ``docs/results.md`` from committed data: ``python docs/results.py``. Not part of the library.

``python docs/results.py random`` measures what random bodies reach under random actions, and writes it into
``envs/known_returns.csv``.
"""

from __future__ import annotations

import csv
import io
import sys
from pathlib import Path
from typing import Any

import warpvox as wv
from warpvox.algos.evaluate import evaluate
from warpvox.envs import known_returns as known
from warpvox.envs.registry import task_ids
from warpvox.io.writing import write_text

ROOT = Path(__file__).resolve().parents[1]
BODIES = 64
"""Random bodies of 5 x 5 cells, one episode each."""


def random_return(task: str) -> float:
    """The mean return of random bodies under actions that are uniform in each control step."""
    import torch

    bodies = [wv.sample_design((5, 5), seed=seed) for seed in range(BODIES)]
    env = wv.make_vec(task, designs=bodies, num_envs=BODIES, seed=0, device="cpu", auto_reset=False)
    draws = torch.Generator().manual_seed(0)
    low, high = 0.6, 1.6

    def policy(obs: Any) -> Any:
        return low + (high - low) * torch.rand((env.num_envs, env.num_actions), generator=draws)

    return evaluate(env, policy).mean_return


def measure_random() -> None:
    """Renew the column ``random``."""
    path = ROOT / "envs" / known.FILE
    with path.open(encoding="utf-8", newline="") as file:
        rows = {row["task"]: row for row in csv.DictReader(file)}
    for task in task_ids():
        rows[task]["random"] = f"{random_return(task):.3f}"
        print(task, rows[task]["random"], flush=True)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows["Walker-v0"]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows[task] for task in task_ids())
    write_text(path, text.getvalue())


if __name__ == "__main__":
    if sys.argv[1:] == ["random"]:
        measure_random()
