"""Deterministic evaluation of policies over whole episodes, without exploration."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from warpvox.algos.disturbance import as_judged
from warpvox.algos.protocols import NOMINAL
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import ConfigError

Policy = Callable[[torch.Tensor], torch.Tensor]
"""Function from observations ``[num_envs, num_obs]`` to actions ``[num_envs, num_actions]`` in [0.6, 1.6]."""


@dataclass(frozen=True)
class EpisodeReturns:
    """Returns of one episode in every environment, on the CPU.

    ``returns`` float64, ``lengths`` (control steps) and ``design_index`` long: all ``[num_envs]``.
    """

    returns: torch.Tensor
    lengths: torch.Tensor
    design_index: torch.Tensor

    @property
    def mean_return(self) -> float:
        """Mean return of all episodes."""
        return float(self.returns.mean())

    @property
    def fitness(self) -> torch.Tensor:
        """Mean return of each design, float64 ``[num_designs]``, the fitness in a design search."""
        return torch.bincount(self.design_index, self.returns) / torch.bincount(self.design_index)


Evaluator = Callable[[Policy], EpisodeReturns]
"""Function that evaluates a policy during training, in environments of its own."""


def evaluate(env: VoxelVecEnv, policy: Policy, seed: int | Sequence[int] | None = None) -> EpisodeReturns:
    """Run one episode of a policy in every environment of ``env`` and return the returns.

    Args:
        env: made with ``auto_reset=False``: an environment that has ended waits for the others.
        policy: without exploration, for a result that can be repeated bit for bit.
        seed: of what the episodes draw, see :meth:`VoxelVecEnv.reset`; None goes on with the numbers of ``env``.

    Raises:
        ConfigError: ``env`` resets itself.
    """
    if env.auto_reset:
        raise ConfigError("An evaluation needs environments that wait at the end: make_vec(auto_reset=False).")
    # A check waits for the device.
    check_every = 1 if torch.device(env.device).type == "cpu" else 25
    if hasattr(policy, "reset"):  # it remembers episodes
        policy.reset()
    with torch.no_grad():
        obs, _ = env.reset(seed)
        for step in range(env.max_episode_steps):
            obs, _, terminated, truncated, info = env.step(policy(obs))
            if (step + 1) % check_every == 0 and bool((terminated | truncated).all()):
                break
    returns = info["episode"]["return"].double().cpu()
    lengths = info["episode"]["length"].long().cpu()
    return EpisodeReturns(returns, lengths, env.design_index.cpu())


def evaluator(env: VoxelVecEnv, seed: int | Sequence[int] | None = None, protocol: str = NOMINAL) -> Evaluator:
    """Create an :class:`Evaluator` that reuses ``env``; with ``seed``, all evaluations use the same episodes.

    ``protocol``: nominal, or noise: the episodes of each design are disturbed copies.
    """
    return lambda policy: evaluate(env, as_judged(policy, env, seed, protocol), seed=seed)
