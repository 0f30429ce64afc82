"""gymnasium's vector interface with its wrappers, and random search over gaits: python gymnasium_vector.py [rounds]

All environments are one batch: each tries another gait, a sine for every actuator, and the best is mutated.
"""

import sys

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import warpvox.envs  # noqa: F401  (registers the tasks)


def main(rounds=10, num_envs=64, steps=200):
    torch.set_num_threads(1)
    envs = gym.make_vec("warpvox/Walker-v0", num_envs=num_envs, body="walker", max_episode_steps=steps)
    envs = RecordEpisodeStatistics(envs)
    rng, count = np.random.default_rng(0), len(envs.single_action_space.sample())
    best, best_return = rng.uniform(0, 2 * np.pi, count), -np.inf
    for number in range(1, rounds + 1):
        phases = best + 0.5 * rng.standard_normal((num_envs, count))
        phases[0] = best
        envs.reset(seed=0)
        returns = np.zeros(num_envs)
        for step in range(steps):
            actions = 1.1 + 0.5 * np.sin(0.5 * step + phases)
            _, rewards, _, _, _ = envs.step(actions.astype(envs.action_space.dtype))
            returns += rewards
        if returns.max() > best_return:
            best, best_return = phases[returns.argmax()], returns.max()
        print(f"round {number}: best return {best_return:.2f}")
    envs.close()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
