"""Returns of stored robots: episodes in exact arithmetic, which any machine repeats."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.registry import get_task
from warpvox.robots.entry import DIGITS, Robot
from warpvox.robots.gait import Gait
from warpvox.robots.network import Network
from warpvox.robots.replay import SEEDS, check_sizes


@dataclass(frozen=True)
class Judgement:
    """Episodes of a robot: ``returns`` (rounded to nine decimals) and ``lengths`` (control steps) by ``seeds``."""

    returns: list[float]
    lengths: list[int]
    seeds: list[int]

    @property
    def mean_return(self) -> float:
        """Over the episodes, rounded in the same way."""
        return round(sum(self.returns) / len(self.returns), DIGITS)


def judge(robot: Robot, seeds: Sequence[int] | None = None) -> Judgement:
    """Run the episodes of ``robot`` in exact arithmetic: those are the returns that EvoGym itself gives.

    Args:
        seeds: one an episode; None: :data:`SEEDS` where the task draws something, else a single episode.

    Raises:
        RunError: it has no policy, or one for other environments.
    """
    policy, limit = robot.own_policy, get_task(robot.task).max_episode_steps
    seeds = list(seeds if seeds is not None else SEEDS if get_task(robot.task).is_random else (0,))
    # one at a time, as numpy steps a single environment faster than torch
    env = VoxelEnv(robot.task, robot.body, None if robot.fully_connected else robot.connections, obs=robot.obs)
    check_sizes(robot, *cast(Any, env.observation_space.shape), *cast(Any, env.action_space.shape))
    returns, lengths = zip(*(_episode(env, policy, limit, seed) for seed in seeds), strict=True)
    return Judgement(list(returns), list(lengths), seeds)


def _episode(env: VoxelEnv, policy: Network | Gait, limit: int, seed: int) -> tuple[float, int]:
    obs, _ = env.reset(seed=seed)
    rewards: list[float] = []
    terminated = False
    while not terminated and len(rewards) < limit:
        obs, reward, terminated, _, _ = env.step(policy(obs))
        rewards.append(reward)
    return round(sum(rewards), DIGITS), len(rewards)
