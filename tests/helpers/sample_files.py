"""Small valid files of every format that warpvox reads, for damaging."""

import json
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.design import sample_design
from warpvox.world import World


@cache
def world_tree() -> dict:
    """Build a world as JSON values; the stone has a ``box``, because its grid has empty cells around it."""
    world = World(12, 8)
    world.add_from_array("ground", np.full((1, 12), 5), 0, 0)
    world.add_from_array("robot", sample_design((3, 3), 0), 2, 2)
    world.add_from_array("stone ä", [[0, 0, 0, 0], [0, 1, 2, 0], [0, 0, 0, 0]], 7, 3)
    return json.loads(world.to_json())


@cache
def rollout_bytes() -> bytes:
    """Record a short rollout of two environments with different bodies."""
    from warpvox.envs.vec_env import make_vec
    from warpvox.view.rollout import record

    env = make_vec("Walker-v0", [[[3]], [[4, 3]]], 2, device="cpu", threads=1)
    with tempfile.TemporaryDirectory() as folder:
        return record(env, "sine", 3).save(Path(folder, "rollout.npz")).read_bytes()


@cache
def checkpoint_content() -> dict[str, Any]:
    """Build the content of a small policy's checkpoint."""
    import torch

    from warpvox.algos.checkpoints.files import PolicySpec, build_actor, spec_dict

    spec = PolicySpec(6, 3, [8, 4], "elu", True, 0.4)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        weights = build_actor(spec).state_dict()
    return {"policy": spec_dict(spec), "actor_state_dict": weights, "iteration": 3, "score": [1.0, None]}


@cache
def archive_bytes() -> bytes:
    """Create an archive of two generations."""
    from warpvox.algos.archive import Archive, Finished
    from warpvox.algos.candidate import Candidate, Outcome

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "archive.sqlite")
        with Archive.create(path, {"task": "Walker-v0", "search": {"name": "ga"}}) as archive:
            for generation in range(2):
                numbers = [2 * generation, 2 * generation + 1]
                parents = (0,) * generation
                archive.propose([Candidate(k, sample_design((3, 3), k), parents, "x", generation) for k in numbers], 1)
                outcome = Outcome(1.0, [(10, 0.5)], 20)
                archive.finish([Finished(k, outcome, f"designs/{k}/p.pt", "ab") for k in numbers], seconds=1.0)
        return path.read_bytes()


@cache
def config_text() -> str:
    """Build a run's stored configuration."""
    from warpvox.cli.config import load
    from warpvox.io.writing import to_yaml
    from warpvox.runs import END

    return to_yaml(load("train", [])) + END
