"""``python -m warpvox.bench.sample OPTIONS BODIES STEPS``: control steps in a process of their own.

NVIDIA's tools watch it, and a first compilation is timed with it. ``OPTIONS`` of ``make_vec`` are JSON; ``BODIES`` is
the number of random bodies, 0: the example.
"""

import json
import sys

import numpy as np

import warpvox as wv

if __name__ == "__main__":
    bodies, steps = map(int, sys.argv[2:])
    designs = [wv.sample_design((5, 5), seed=k) for k in range(bodies)] or None
    env = wv.make_vec(designs=designs, **json.loads(sys.argv[1]))
    env.reset()
    random = np.random.default_rng(0)
    for _ in range(steps):
        obs, *_ = env.step(random.uniform(0.6, 1.6, (env.num_envs, env.num_actions)))
    env.sim.reset()
    print("finite" if obs.isfinite().all() else "NOT FINITE")
