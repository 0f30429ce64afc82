"""PPO in one file, in the manner of CleanRL, on torch tensors throughout: python cleanrl_ppo.py [iterations]"""

import sys
from collections import deque

import torch
from torch import nn
from torch.distributions import Normal

import warpvox as wv

STEPS, EPOCHS, MINIBATCHES, GAMMA, LAM, CLIP, SCALE = 32, 4, 4, 0.99, 0.95, 0.2, 0.5


def network(inputs, outputs):
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


def main(iterations=100, num_envs=128):
    torch.set_num_threads(1)  # the networks are small: more threads wait for each other
    torch.manual_seed(0)
    env = wv.make_vec("Walker-v0", "walker", num_envs, device="cpu")
    actor, critic = network(env.num_obs, env.num_actions), network(env.num_obs, 1)
    log_std = nn.Parameter(torch.full((env.num_actions,), -0.5))
    weights = [*actor.parameters(), *critic.parameters(), log_std]
    adam, (obs, _) = torch.optim.Adam(weights, 1e-3), env.reset()
    ended = deque(maxlen=num_envs)
    for iteration in range(1, iterations + 1):
        rows = []
        with torch.no_grad():
            for _ in range(STEPS):
                normal = Normal(actor(obs), log_std.exp())
                output = normal.sample()
                new, reward, terminated, truncated, info = env.step(1.1 + SCALE * output)
                after = critic(info["final_obs"]).squeeze(1) * ~terminated  # a time limit is no end of the world
                value, done = critic(obs).squeeze(1), terminated | truncated
                rows.append((obs, output, normal.log_prob(output).sum(1), value, 10 * reward + GAMMA * after, done))
                ended += info["episode"]["return"][done].tolist()
                obs = new
            advantage, carried = [], torch.zeros(num_envs)
            for *_, value, target, done in reversed(rows):
                carried = target - value + GAMMA * LAM * carried * ~done
                advantage.insert(0, carried)
        data = [torch.cat([row[k] for row in rows]) for k in range(4)]
        gain = torch.cat(advantage)
        for _ in range(EPOCHS):
            for k in torch.randperm(len(gain)).chunk(MINIBATCHES):
                seen, output, old, value = (one[k] for one in data)
                good = (gain[k] - gain[k].mean()) / (gain[k].std() + 1e-8)
                ratio = (Normal(actor(seen), log_std.exp()).log_prob(output).sum(1) - old).exp()
                surrogate = torch.min(ratio * good, ratio.clamp(1 - CLIP, 1 + CLIP) * good).mean()
                error = (critic(seen).squeeze(1) - value - gain[k]).square().mean()
                adam.zero_grad()
                (0.5 * error - surrogate).backward()
                nn.utils.clip_grad_norm_(weights, 0.5)
                adam.step()
        if ended and (iteration % 10 == 0 or iteration == iterations):
            print(f"{iteration * STEPS * num_envs:9,} steps: return {sum(ended) / len(ended):.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
