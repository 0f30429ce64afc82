"""A process that trains and says what it takes: estimated and measured bytes; run by ``test_needs.py``.

Arguments: task, method (``train`` or ``population``), environments of a design, designs, and keys of ``ppo.*``.
"""

from __future__ import annotations

import gc
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch

from warpvox.algos.candidate import Candidate
from warpvox.algos.codesign.population_evaluator import PopulationEvaluator
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.needs import training_bytes
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.cli.config import load
from warpvox.envs.vec_env import make_vec
from warpvox.types import Physics

BODY = np.full((4, 4), 3, np.int8)


def status(name: str) -> int:
    """A figure of this process, in bytes."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name))
    return 1024 * int(line.split()[1])


def train(task: str, envs: int, designs: int, ppo: Any) -> None:
    env = make_vec(task, [BODY] * designs, envs * designs, device="cpu", threads=1)
    Runner(adapt(env, ppo), ppo, Schedule(2)).learn(2)


def search(task: str, envs: int, designs: int, ppo: Any) -> None:
    config = load("codesign", [f"training.envs={envs}", "training.iterations=2", "training.eval_interval=2"])
    config.training.ppo = ppo
    factory = EnvFactory(task, "evogym", Physics.preset("evogym"), "cpu", "float32", 1)
    evaluator = PopulationEvaluator(factory, config.training, 0)
    candidates = [Candidate(number, BODY) for number in range(designs)]
    evaluator.evaluate(candidates, {}, lambda event: None)


def main(task: str, method: str, envs: int, designs: int, *keys: str) -> None:
    """Print both."""
    torch.set_num_threads(1)
    ppo = load("train", [f"ppo.{key}" for key in keys]).ppo
    work = {"train": train, "population": search}[method]
    work(task, min(envs, 32), min(designs, 2), ppo)  # libraries and the kernels of these lanes
    gc.collect()
    before = status("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    work(task, envs, designs, ppo)
    probe = make_vec(task, BODY, min(envs, 32), device="cpu", threads=1)
    estimate = training_bytes(probe, envs, designs, ppo, together=method == "population")
    print(json.dumps({"estimated": estimate, "measured": status("VmHWM") - before}))


if __name__ == "__main__":
    main(*sys.argv[1:3], *map(int, sys.argv[3:5]), *sys.argv[5:])
