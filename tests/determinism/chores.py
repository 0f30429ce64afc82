"""Everything that follows from a seed, each as a digest. As a program it does the chores named and prints JSON::

python chores.py --threads=2 CHORE [CHORE ...]
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import torch

from warpvox.algos.arena import Arena
from warpvox.algos.candidate import Candidate
from warpvox.algos.checkpoint import save_checkpoint
from warpvox.algos.evaluate import evaluator
from warpvox.algos.population import PopulationEvaluator
from warpvox.algos.presets import training_preset
from warpvox.algos.runner import Runner, Schedule, adapt
from warpvox.algos.search import ALGORITHMS, make_search
from warpvox.cli.config import load
from warpvox.design import sample_design
from warpvox.envs.vec_env import make_vec
from warpvox.player import write_html
from warpvox.render import write_filmstrip, write_gif, write_mp4, write_png
from warpvox.rollout import Rollout, record
from warpvox.usd import write_usd

SEED = 5
TIMING = {"steps_per_second", "elapsed"}
SEARCHES = [name for name in ALGORITHMS if name != "custom"]
HASTY = {"bo": {"optimizer_restarts": 1, "optimizer_iterations": 5, "candidates": 40}}
WRITERS: dict[str, Callable[[Rollout, Path], object]] = {
    "rollout.npz": Rollout.save,
    "checkpoint.pt": lambda rollout, path: save_checkpoint(path, {"at": 3, "actions": torch.tensor(rollout.actions)}),
    "rollout.usdc": write_usd,
    "rollout.usda": write_usd,
    "rollout.html": write_html,
    "rollout.gif": write_gif,
    "rollout.png": write_png,
    "strip.png": write_filmstrip,
    "rollout.mp4": write_mp4,
}


def train(threads: int, seed: int) -> bytes:
    """Weights and metrics after PPO on a task that draws, on so many rows that torch would use several threads."""
    torch.manual_seed(seed)
    ppo = load("train", []).ppo
    ppo.steps = 8
    options = dict(device="cpu", threads=threads, seed=seed, max_episode_steps=6)
    env = make_vec("Catcher-v0", ["walker"], 256, **options)
    judge = evaluator(make_vec("Catcher-v0", ["walker"], 8, auto_reset=False, **options))
    rows: list[str] = []
    keep = lambda row: rows.append(repr({key: value for key, value in row.items() if key not in TIMING}))  # noqa: E731
    runner = Runner(adapt(env, ppo), ppo, Schedule(3, evaluate=2), evaluator=judge, report=keep)
    runner.run()
    state = runner.alg.save()
    return _bytes(state["actor_state_dict"]) + _bytes(state["critic_state_dict"]) + "".join(rows).encode()


def population(threads: int, seed: int) -> bytes:
    """Outcomes of bodies that are trained side by side."""
    quick = {"steps": 8, "epochs": 2, "minibatches": 2, "hidden": [32]}
    how = training_preset("fast", quick, envs=8, iterations=4, eval_interval=2)
    found = [Candidate(number, sample_design((3, 3), seed=number)) for number in range(4)]
    arena = Arena("Catcher-v0", threads=threads, max_episode_steps=16)
    outcomes = PopulationEvaluator(arena, how, seed).evaluate(found, {})
    return b"".join(repr((o.fitness, o.curve, o.steps)).encode() + _bytes(o.policy) for o in outcomes)


def search(name: str, seed: int) -> bytes:
    """All bodies that a search proposes, and whose children it says they are."""
    settings = ALGORITHMS[name](**{"population": 8, "max_evaluations": 24, **HASTY.get(name, {})})
    searching = make_search(settings, (5, 5), seed)
    said: list[object] = []
    while asked := searching.ask():
        said += [(c.id, c.body.tolist(), c.parents, c.origin, c.generation) for c in asked]
        searching.tell([float((c.body >= 3).mean() - 0.3 * (c.body == 1).mean()) for c in asked])
    return repr(said).encode()


def written(name: str, threads: int, seed: int) -> bytes:
    """The bytes of a file made of an episode of different bodies on a task that draws."""
    bodies = [sample_design((5, 5), seed=0), sample_design((3, 4), seed=1)]
    env = make_vec("Catcher-v0", bodies, 4, device="cpu", threads=threads, seed=seed, max_episode_steps=20)
    rollout = record(env, "random", metadata={"note": "é", "list": [1, 2]})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        WRITERS[name](rollout, path)
        return path.read_bytes()


def _bytes(state: Mapping[str, torch.Tensor]) -> bytes:
    return b"".join(name.encode() + value.contiguous().numpy().tobytes() for name, value in state.items())


CHORES: dict[str, Callable[[int, int], bytes]] = {
    "train": train,
    "population": population,
    **{f"search {name}": lambda _, seed, name=name: search(name, seed) for name in SEARCHES},
    **{f"file {name}": lambda threads, seed, name=name: written(name, threads, seed) for name in WRITERS},
}
"""By name; each takes the simulation's number of threads and a seed."""


def do(chore: str, threads: int, seed: int = SEED) -> str:
    """The digest of a chore."""
    return hashlib.sha256(CHORES[chore](threads, seed)).hexdigest()


def main() -> None:
    """Print ``{chore: digest}`` of the chores named."""
    option, *names = sys.argv[1:]
    threads = int(option.removeprefix("--threads="))
    found = {}
    for name in names:
        # How a product of matrices is split over torch's threads decides how it rounds: `torch_threads` is a setting
        # of a training like any other, 1 unless told otherwise. Everything else must not depend on it.
        torch.set_num_threads(1 if name == "train" else threads)
        found[name] = do(name, threads)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
