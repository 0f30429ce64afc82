"""The fixed rollout of every task, and its digest.

Run as a program it prints, as the last line, ``{precision: {task: digest}}`` as JSON, in the environment and with the
options that it is given::

    python rollouts.py '{"threads": 2}' [TASK ...]
"""

import hashlib
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from warpvox.design import example_design
from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec

PINNED = Path(__file__).with_name("digests.json")
"""``{precision: {task: digest}}``: a rollout is made of what rounds alike on every machine."""
PRECISIONS = ("float32", "float64")
STEPS, ENVS, LANES = 24, 4, 8
LIMIT = 20  # control steps of an episode: every rollout holds a reset, and the draws of a second episode
SEED = 11
LONG = 16  # hexadecimal digits of a digest that are kept
SMALL = np.array([[3, 1, 4], [4, 2, 3], [1, 0, 2], [3, 0, 4]], dtype=np.int8)


def fixed_env(task: str, precision: str, **options: object) -> VoxelVecEnv:
    """Two environments of either of two bodies; the smaller one's rows are padded."""
    defaults = dict(device="cpu", lanes=LANES, max_episode_steps=LIMIT, seed=SEED, threads=1)
    return make_vec(task, [example_design("walker"), SMALL], ENVS, dtype=precision, **(defaults | options))


def fixed_actions(env: VoxelVecEnv, steps: int = STEPS, seed: int = SEED) -> torch.Tensor:
    """``[steps, environments, actions]``, held for four steps each; an environment's own do not depend on the batch.

    Of numpy's generators that of old is used, because it alone is promised never to change.
    """
    drawn = [np.random.RandomState(seed + e).randint(0, 1025, (-(-steps // 4), 64)) for e in range(env.num_envs)]
    held = np.stack(drawn, 1).repeat(4, 0)[:steps, :, : env.num_actions]
    return torch.as_tensor(0.6 + held / 1024).to(env.dtype)


def walk(env: VoxelVecEnv, actions: torch.Tensor) -> list[dict[str, torch.Tensor]]:
    """All that there is to see after the reset and after every step: tensors with a row for every environment."""
    seen = [{"obs": env.reset()[0], **env.sim.state()}]
    for action in actions.to(env.device):
        obs, reward, terminated, truncated, info = env.step(action)
        ends = {"terminated": terminated, "truncated": truncated, "final_obs": info["final_obs"]}
        seen.append({"obs": obs, "reward": reward, **ends, **env.sim.state()})
    return seen


def digest(task: str, precision: str, **options: object) -> str:
    """Of all states of the simulator, observations, rewards and ends of the task's fixed rollout."""
    env = fixed_env(task, precision, **options)
    found = hashlib.sha256()
    for seen in walk(env, fixed_actions(env)):
        for name, tensor in seen.items():
            found.update(name.encode() + tensor.cpu().contiguous().numpy().tobytes())
    return found.hexdigest()[:LONG]


def digests(tasks: Sequence[str], **options: object) -> dict[str, dict[str, str]]:
    return {name: {task: digest(task, name, **options) for task in tasks} for name in PRECISIONS}


if __name__ == "__main__":
    torch.set_num_threads(1)
    given = json.loads(sys.argv[1]) if len(sys.argv) > 1 else {}
    print(json.dumps(digests(sys.argv[2:] or task_ids(), **given)))
