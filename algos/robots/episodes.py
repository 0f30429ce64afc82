"""Evaluation of stored robots: environments, and returns in exact arithmetic, equal on every machine."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

from warpvox.algos.checkpoints.policy import Policy
from warpvox.algos.robots.entry import DIGITS, Robot
from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ConfigError

SEEDS = tuple(range(1000, 1008))
"""Seeds of a robot's evaluation episodes in random tasks; other tasks have one episode."""


def robot_env(robot: Robot, seeds: Sequence[int] = (0,), **options: Any) -> VoxelVecEnv:
    """Create environments with the robot's body, one for each seed; exact and on the CPU unless ``options`` differ.

    They give the observations that its policy takes (:attr:`Robot.obs`).

    Raises:
        TaskError, DesignError, WorldError: as :func:`warpvox.make_vec`. RunError: another number of observations or
            actions than the policy has.
    """
    defaults = {"device": "cpu", "dtype": "float64", "auto_reset": False, "seed": list(seeds), "num_envs": len(seeds)}
    connections = None if robot.fully_connected else robot.connections
    env = make_vec(robot.task, body=robot.body, connections=connections, obs=robot.obs, **(defaults | options))
    if robot.policy is not None:
        robot.policy.check_sizes(env.num_obs, env.num_actions)
    return env


def known_task(robot: Robot) -> str:
    """Return the id of the robot's task; ConfigError: an unknown task, whose code must be named."""
    if robot.task not in task_ids():
        raise ConfigError(f"The robot is for {robot.task}, a task of your own: name its code, task=FILE.py:NAME.")
    return robot.task


def with_facts(robot: Robot) -> Policy:
    """Copy the robot's policy in float32, with the settings of its evaluation as ``metadata``.

    Evaluation is exact, with a seed for each episode (``seed_each``).
    """
    policy = robot.own_policy
    about: dict[str, Any] = {
        "task": robot.task,
        "rules": "evogym",
        "obs": robot.obs,
        "design": robot.body.tolist(),
        "dtype": "float64",
        "seed_each": True,
    }
    if not robot.fully_connected:
        about["connections"] = robot.connections.tolist()
    spec = policy.spec
    if spec.gait is not None:
        spec = replace(spec, num_obs=robot_env(robot).num_obs)
    return Policy(spec, policy.actor.state_dict(), about)


@dataclass(frozen=True)
class Judgement:
    """Results of a robot's episodes: ``seeds``, ``returns`` (nine decimals) and ``lengths`` (control steps)."""

    returns: list[float]
    lengths: list[int]
    seeds: list[int]

    @property
    def mean_return(self) -> float:
        """Mean of the returns, rounded to nine decimals."""
        return round(sum(self.returns) / len(self.returns), DIGITS)


def judge(robot: Robot, seeds: Sequence[int] | None = None) -> Judgement:
    """Run the episodes of ``robot`` in exact arithmetic, with the same returns as EvoGym.

    Args:
        seeds: one an episode; None: :data:`SEEDS` where the task draws something, else a single episode.

    Raises:
        RunError: it has no policy, or one for other environments.
    """
    policy = robot.own_policy
    task = get_task(robot.task)
    if seeds is None:
        seeds = SEEDS if task.is_random else (0,)

    # One at a time, as a single environment is stepped faster than a batch of one
    connections = None if robot.fully_connected else robot.connections
    env = VoxelEnv(robot.task, robot.body, connections, obs=robot.obs)
    policy.check_sizes(*cast(Any, env.observation_space.shape), *cast(Any, env.action_space.shape))
    returns = []
    lengths = []
    for seed in seeds:
        obs, _ = env.reset(seed=seed)
        rewards: list[float] = []
        terminated = False
        while not terminated and len(rewards) < task.max_episode_steps:
            obs, reward, terminated, _, _ = env.step(policy.act(obs))
            rewards.append(reward)
        returns.append(round(sum(rewards), DIGITS))
        lengths.append(len(rewards))
    return Judgement(returns, lengths, list(seeds))
