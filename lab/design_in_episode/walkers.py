"""Training to design and control walkers of 4x4 cells: python -m lab.design_in_episode.walkers 60 [random]"""

import contextlib
import io
import sys
import time

import numpy as np
import torch
from rsl_rl.runners import OnPolicyRunner

import warpvox as wv
from lab.design_in_episode.episodes import RslRlDesignEnv, design_episodes
from lab.design_in_episode.policy import design_models
from warpvox.view.render import write_gif

TASK, SHAPE, LIMIT, DESIGN_STEPS = "Walker-v0", (4, 4), 100, 3


class RandomBodies(RslRlDesignEnv):
    """Baseline that keeps the random initial bodies and learns only their control."""

    def goals(self, outputs):
        goals, control = super().goals(outputs), self.env.layout.control
        return torch.cat([goals[:, :control], self.env.cells.flatten(1).to(goals)], dim=1)


def make(num_envs=64, random=False):
    start = "random" if random else "empty"
    options = {"start": start, "max_episode_steps": LIMIT, "device": "cpu"}
    env = design_episodes(TASK, num_envs, SHAPE, DESIGN_STEPS, **options)
    return RandomBodies(env) if random else RslRlDesignEnv(env)


def learn(env, iterations, seed=0):
    torch.manual_seed(seed)
    ppo = {"class_name": "PPO", "num_learning_epochs": 4, "num_mini_batches": 4, "learning_rate": 3e-3}
    ppo |= {"schedule": "fixed", "gamma": 0.99, "lam": 0.95, "entropy_coef": 0.003, "max_grad_norm": 0.5}
    settings = {
        "num_steps_per_env": LIMIT + DESIGN_STEPS,
        "save_interval": 1000,
        "algorithm": ppo,
        **design_models(env),
    }
    with contextlib.redirect_stdout(io.StringIO()):
        runner = OnPolicyRunner(env, settings, log_dir=None, device="cpu")
    began, every = time.process_time(), max(1, iterations // 10)
    for done in range(every, iterations + 1, every):
        with contextlib.redirect_stdout(io.StringIO()):  # rsl-rl's own table
            runner.learn(every)
        steps, episodes = done * env.num_envs * settings["num_steps_per_env"], env.pop_episodes()
        print(
            f"{steps:9,} steps  return {episodes['return']:.3f}  {time.process_time() - began:.0f} s of CPU time",
            flush=True,
        )
    return runner


@torch.no_grad()
def design(env, runner):
    """Sample a body for each environment from the policy."""
    obs = env.reset()
    for _ in range(DESIGN_STEPS):
        obs = env.step(runner.alg.get_policy()(obs, stochastic_output=True))[0]
    return list(env.env.cells.numpy())


def play(env, runner, bodies):
    """Run an episode of each body under the trained control, without exploration."""
    options = {"obs": "voxel", "grid": SHAPE, "max_episode_steps": LIMIT, "device": "cpu", "auto_reset": False}
    plain = wv.make_vec(TASK, bodies, len(bodies), **options)
    return wv.record(plain, env.controller(runner.get_inference_policy(), bodies))


if __name__ == "__main__":
    torch.set_num_threads(1)  # the networks are small
    env = make(random="random" in sys.argv)
    runner = learn(env, int(sys.argv[1]) if len(sys.argv) > 1 else 60)
    rng = np.random.default_rng(0)
    found = {"designed": design(env, runner), "random": [wv.sample_design(SHAPE, rng) for _ in range(env.num_envs)]}
    for name, bodies in found.items():
        rollout = play(env, runner, bodies)
        low, middle, high = np.quantile(rollout.returns[-1], (0.1, 0.5, 0.9))
        print(f"{name:8} bodies: mean {rollout.returns[-1].mean():.3f}, quantiles {low:.3f} {middle:.3f} {high:.3f}")
        write_gif(rollout.best_first(), f"{name}.gif", envs=range(12), size=(560, 300), fps=12.5, voxels=8)
