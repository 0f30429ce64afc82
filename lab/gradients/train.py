"""Training or tuning of one policy for many bodies by gradients through the physics."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

import warpvox as wv
from lab.gradients.ascent import UNIVERSAL, Ascent, judge, load_network, make_env
from lab.gradients.cpg import CpgNetwork

HELD_OUT_SEED = 1_000_003
"""Seed of the held-out bodies, independent of the training's seed."""


def read_arguments(words: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--task", default="Walker-v0")
    parser.add_argument("--designs", nargs="+", help="bodies to train for; without, new random ones in each iteration")
    parser.add_argument(
        "--begin", type=Path, help=f"policy to begin with, such as {UNIVERSAL.name}; without, a new one"
    )
    parser.add_argument("--shape", type=int, nargs=2, default=(5, 5), help="rows and columns of the grid of bodies")
    parser.add_argument("--envs", type=int, default=512, help="random bodies of an iteration")
    parser.add_argument("--iterations", type=int, default=280)
    parser.add_argument("--steps", type=int, default=120, help="control steps that are differentiated")
    parser.add_argument("--updates", type=int, default=24, help="steps of Adam in an iteration")
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument("--fixed", action="store_true", help="keep the learning rate, which else falls to 0")
    parser.add_argument("--judge-every", type=int, default=10, help="iterations between evaluations")
    parser.add_argument("--held-out", type=int, default=100, help="random bodies of an evaluation, without --designs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int)
    parser.add_argument("--out", type=Path, default=Path("policy.pt"), help="file for the best policy")
    return parser.parse_args(words)


def random_bodies(count: int, shape: tuple[int, int], rng: np.random.Generator) -> list[np.ndarray]:
    return [wv.sample_design(shape, rng) for _ in range(count)]


def train(given: argparse.Namespace) -> list[float]:
    """Train the policy and save the best version to ``given.out``; return the mean return of each evaluation."""
    torch.manual_seed(given.seed)
    rng = np.random.default_rng(given.seed)
    shape: tuple[int, int] = (given.shape[0], given.shape[1])

    # Bodies, environments, policy
    if given.designs:
        bodies = judged = [np.asarray(wv.load_design(name)) for name in given.designs]
    else:
        bodies = random_bodies(given.envs, shape, rng)
        judged = random_bodies(given.held_out, shape, np.random.default_rng(HELD_OUT_SEED))
    options = {"device": given.device, "threads": given.threads, "seed": given.seed}
    env = make_env(given.task, bodies, shape, **options)
    judging = make_env(given.task, judged, shape, **options)
    network = CpgNetwork(*shape) if given.begin is None else load_network(given.begin, shape)
    network.to(env.device)
    iterations = None if given.fixed else given.iterations
    ascent = Ascent(network, env, given.steps, given.updates, given.learning_rate, iterations)

    # Training
    found = [float(judge(network, judging, judged).mean())]
    print(f"before: mean return {found[0]:.3f} of {len(judged)} bodies", flush=True)
    best = -np.inf
    for iteration in range(1, given.iterations + 1):
        row = ascent.iterate()
        if not given.designs:
            env.set_designs(random_bodies(given.envs, shape, rng), torch.ones(len(bodies), dtype=torch.bool))
        if iteration % given.judge_every and iteration < given.iterations:
            continue
        value = float(judge(network, judging, judged).mean())
        found.append(value)
        steps = iteration * len(bodies) * given.steps
        print(
            f"iteration {iteration}: {steps:,} steps, return {value:.3f}, in training {row['return']:.3f}", flush=True
        )
        if value > best:
            best = value
            torch.save(network.state_dict(), given.out)
    return found


if __name__ == "__main__":
    torch.set_num_threads(1)  # the network is small
    train(read_arguments())
