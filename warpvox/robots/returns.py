"""Returns of stored robots: episodes in exact arithmetic, which any machine repeats."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from typing import Any, cast

from warpvox.algos.disturbance import JUDGED, Disturbed
from warpvox.algos.evaluate import evaluate
from warpvox.algos.protocols import ROBUST, parts_of
from warpvox.algos.statistics import difference
from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.registry import get_task
from warpvox.robots.entry import DIGITS, Robot
from warpvox.robots.gait import Gait
from warpvox.robots.network import Network
from warpvox.robots.replay import SEEDS, check_sizes, robot_env

EPISODES, CANDIDATE = 32, 128
"""Disturbed episodes of a robot, and those that entries are chosen by: a few do not show a rare fall."""
EQUAL = 1e-3
"""Share of a mean under noise by which a policy with feedback may be below that of a gait and still be preferred."""


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


def judge_robust(
    robot: Robot, protocol: str = ROBUST, episodes: int = EPISODES, stream: int = JUDGED
) -> dict[str, list[float]]:
    """Returns of ``robot`` in disturbed episodes in exact arithmetic: ``episodes`` of each disturbance.

    Those of :data:`warpvox.algos.protocols.PROTOCOLS`, side by side; :func:`judge` gives the nominal ones. The best of
    many robots owes a part of its return to chance: it is chosen by the episodes of the ``stream`` CHOOSING, and its
    return is that of others.

    Raises:
        RunError: it has no policy, or one for other environments. ConfigError: no disturbance of ``protocol`` concerns
            its policy.
    """
    parts = parts_of(protocol, feedback=robot.has_feedback)
    first = SEEDS[0] if stream == JUDGED else 2 * SEEDS[0]  # what the task itself draws differs, too
    env = robot_env(robot, list(range(first, first + episodes)) * len(parts))
    found = evaluate(env, Disturbed(cast(Any, robot.own_policy), env, parts, SEEDS[0], stream)).returns
    return {
        part: [round(value, DIGITS) for value in row.tolist()]
        for part, row in zip(parts, found.view(len(parts), -1), strict=True)
    }


def _episode(env: VoxelEnv, policy: Network | Gait, limit: int, seed: int) -> tuple[float, int]:
    obs, _ = env.reset(seed=seed)
    rewards: list[float] = []
    terminated = False
    while not terminated and len(rewards) < limit:
        obs, reward, terminated, _, _ = env.step(policy(obs))
        rewards.append(reward)
    return round(sum(rewards), DIGITS), len(rewards)


def is_better(robot: Robot, entry: Robot) -> bool:
    """True if the zoo takes ``robot`` in place of ``entry``.

    Its mean under noise is higher. Between feedback and a gait the gait has to be better by more than :data:`EQUAL`, as
    far as the 95 % interval of the difference can tell: other disturbances throw it off its course for good.
    """
    if robot.has_feedback != entry.has_feedback:
        seeing, gait = (robot, entry) if robot.has_feedback else (entry, robot)
        one, other = (each.about.get("chosen_by") for each in (seeing, gait))
        if one and other and difference(one, other).low >= -EQUAL * abs(gait.choosing_return):
            return robot.has_feedback
    return not robot.choosing_return <= entry.choosing_return  # than an entry's NaN anything is better


def recorded(robot: Robot, about: dict[str, Any]) -> Robot:
    """``robot`` with its returns, nominal and under noise, and ``about`` as an entry of the zoo states them."""
    result = judge(robot)
    found = {"return": result.mean_return, "returns": result.returns, "lengths": result.lengths, "seeds": result.seeds}
    noisy = judge_robust(robot, "noise")["noise"]
    found["noise"] = {"return": round(sum(noisy) / len(noisy), DIGITS), "returns": noisy}
    date = datetime.now(timezone.utc).strftime("%Y-%m-%d")
    return replace(robot, about=found | about | {"date": date})
