"""PPO of Stable-Baselines3 on a batch of 128: python sb3_ppo.py [control steps]; a return of 4 after 200,000."""

import sys

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from warpvox.envs.adapters.sb3 import VoxelSB3VecEnv


def main(steps=400_000, num_envs=128):
    torch.set_num_threads(1)  # the networks are small: more threads wait for each other
    envs = VoxelSB3VecEnv("Walker-v0", num_envs, body="walker")
    model = PPO("MlpPolicy", envs, n_steps=32, batch_size=4 * num_envs, learning_rate=1e-3, device="cpu", seed=0)
    model.learn(steps)

    judge = VoxelSB3VecEnv("Walker-v0", 1, body="walker")
    mean, _ = evaluate_policy(model, judge, n_eval_episodes=1, warn=False)
    print(f"return {mean:.2f} after {model.num_timesteps:,} steps")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
