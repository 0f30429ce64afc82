"""``python -m warpvox.bench.gpu_sample DEVICE TASK ENVS BODIES STEPS``: control steps for NVIDIA's tools."""

from __future__ import annotations

import sys

import torch

from warpvox.bench.case import sampled_bodies
from warpvox.envs.vec_env import make_vec

if __name__ == "__main__":
    device, task = sys.argv[1:3]
    envs, bodies, steps = map(int, sys.argv[3:])
    env = make_vec(task, sampled_bodies(5, bodies, 0), envs, device=device)
    env.reset()
    random = torch.Generator(env.device).manual_seed(0)
    for _ in range(steps):
        actions = torch.rand((envs, env.num_actions), generator=random, dtype=env.dtype, device=env.device)
        obs, *_ = env.step(0.6 + actions)
    print("finite" if bool(torch.isfinite(obs).all()) else "NOT FINITE")
