"""Search for bodies, compared by a pretrained policy tuned for them: python -m lab.gradients.search [evaluations]"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

import warpvox as wv
from lab.gradients.ascent import UNIVERSAL, Ascent, judge, load_network, make_env
from warpvox.algos.candidate import Candidate, Outcome


class Tuned:
    """Evaluation by the pretrained policy, tuned for all bodies of a generation together.

    Each generation begins with the pretrained weights again.

    Args:
        policy: a file that ``train.py`` has written.
        options: of the environments: ``device``, ``threads``, ...
    """

    def __init__(
        self,
        task: str = "Walker-v0",
        shape: tuple[int, int] = (5, 5),
        policy: Path = UNIVERSAL,
        iterations: int = 5,
        steps: int = 120,
        updates: int = 40,
        learning_rate: float = 1e-3,
        seed: int = 0,
        **options: Any,
    ) -> None:
        self.task, self.shape, self.policy, self.iterations, self.seed = task, shape, policy, iterations, seed
        self.learning = {"steps": steps, "updates": updates, "learning_rate": learning_rate}
        self.options = options

    def evaluate(
        self, candidates: Sequence[Candidate], parents: Any, report: Any = None, checkpoint: Path | None = None
    ) -> list[Outcome]:
        bodies = [candidate.body for candidate in candidates]
        network = load_network(self.policy, self.shape)
        env = make_env(self.task, bodies, self.shape, **self.options)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.seed + candidates[0].id)
            if self.iterations:
                ascent = Ascent(network, env, **self.learning)
                for _ in range(self.iterations):
                    ascent.iterate()
        returns = judge(network, env, bodies)
        steps = self.iterations * self.learning["steps"] + env.max_episode_steps
        return [Outcome(float(value), steps=steps) for value in returns]


if __name__ == "__main__":
    torch.set_num_threads(1)
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 150
    tuned = Tuned(device="cpu", threads=1)
    print(wv.codesign("Walker-v0", (5, 5), search=wv.GA(max_designs=count), fitness=tuned, device="cpu"))
