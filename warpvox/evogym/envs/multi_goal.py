"""Tasks with a list of goals, reached one after another, under the names of ``evogym.envs.multi_goal``."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from warpvox.envs.registry import get_task
from warpvox.envs.snapshot import Snapshot
from warpvox.envs.spec import TaskSpec
from warpvox.evogym.envs.base import BenchmarkBase
from warpvox.evogym.envs.task import TaskEnv
from warpvox.evogym.errors import ArgumentError
from warpvox.evogym.world import EvoWorld
from warpvox.types import VOXEL

__all__ = ["BiWalk", "Goal", "GoalBase", "WalkToX"]

_BEFORE, _AFTER = "robot_com_pos_initial", "robot_com_pos_final"


class Goal:
    """Base class of goals: a name for messages, and the keys of ``args`` that the goal needs."""

    def __init__(self, name: str, requirements: Sequence[str] | None = None) -> None:
        self.name = name
        self.requirements = list(requirements or ())

    def evaluate(self, args: Mapping[str, Any]) -> tuple[float, bool]:
        """Return the reward of a step, and whether the goal has been reached."""
        raise NotImplementedError(f"The goal '{self.name}' must define evaluate(args).")

    def get_obs(self, args: Mapping[str, Any]) -> np.ndarray:
        """Return the observation of the goal."""
        raise NotImplementedError(f"The goal '{self.name}' must define get_obs(args).")


class WalkToX(Goal):
    """Goal of walking to a place along x, in voxels; ``args`` hold the robot's points before and after, ``[2, n]``."""

    def __init__(self, x_goal: float) -> None:
        super().__init__(f"Walk to x = {x_goal}", [_BEFORE, _AFTER])
        self.x_goal = x_goal

    def evaluate(self, args: Mapping[str, np.ndarray]) -> tuple[float, bool]:
        """Return how much closer the robot came to the goal, and whether it is within two voxels."""
        goal = self.x_goal * VOXEL
        before = abs(goal - np.mean(args[_BEFORE][0]))
        after = abs(goal - np.mean(args[_AFTER][0]))
        # A goal is reached within two voxels.
        return before - after, bool(after < 2 * VOXEL)

    def get_obs(self, args: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the goal's x and the remaining distance along x, ``[2]``."""
        place = self.x_goal * VOXEL
        return np.array([place, place - np.mean(args[_AFTER][0])])


class GoalBase(BenchmarkBase):
    """Base class of tasks with a list of goals.

    Attributes:
        goals: the list.
        current_goal: how many of them have been reached.
    """

    def init_reward_goals(self, goals: Sequence[Goal]) -> None:
        """Start a list of goals at its first one; ArgumentError if the list is empty."""
        if not goals:
            raise ArgumentError("An environment with goals needs at least one.")
        self.goals = list(goals)
        self.current_goal = 0
        keys = dict.fromkeys(key for goal in self.goals for key in goal.requirements)
        self.requirements = {key: [goal.name for goal in self.goals if key in goal.requirements] for key in keys}

    def get_reward(self, args: Mapping[str, Any]) -> tuple[float, bool]:
        """Return the reward for the present goal, and whether all goals have been reached."""
        for key, names in self.requirements.items():
            if args.get(key) is None:
                raise ArgumentError(f"args lack '{key}', which {', '.join(dict.fromkeys(names))} need.")
        reward = 0.0
        reached = True
        while reached and self.current_goal < len(self.goals):
            reward, reached = self.goals[self.current_goal].evaluate(args)
            self.current_goal += int(reached)
        return reward, self.current_goal == len(self.goals)

    def get_obs(self, args: Mapping[str, Any]) -> np.ndarray:
        """Return the observation of the present goal, or of the last one after all are reached."""
        return self.goals[min(self.current_goal, len(self.goals) - 1)].get_obs(args)


class BiWalk(TaskEnv, GoalBase):
    """BidirectionalWalker-v0: walk to random goals on both sides.

    Goals are drawn when the environment is made and at every reset, as released from Python's global generator
    ``random``; ``reset(seed=...)`` gives the environment a generator of its own.
    """

    task = "BidirectionalWalker-v0"

    _random: Any = random

    def _make_world(self, *parts: Any) -> EvoWorld:
        self.set_random_goals(20, 50, 100)  # the size of observations is that of the first one
        return super()._make_world(*parts)

    def set_random_goals(self, lower_bound: int, upper_bound: int, goal_dist: float) -> None:
        """Sample goals in [lower_bound, upper_bound) voxels until the whole path is ``goal_dist`` or longer."""
        place = 35
        way = 0
        goals = []
        while way < goal_dist:
            goal = self._random.randrange(lower_bound, upper_bound)
            way = way + abs(place - goal)
            place = goal
            goals.append(WalkToX(goal))
        self.init_reward_goals(goals)

    def _rules(self) -> TaskSpec:
        """Return the task's specification without rules about goals, which :class:`GoalBase` computes."""
        spec = super()._rules()
        return replace(spec, observations=spec.observations[:2], rewards=(), terminations=(), memory=())

    def _observe(self, now: Snapshot) -> np.ndarray:
        return np.concatenate([super()._observe(now), [self.current_goal], self.get_obs({_AFTER: self._points()})])

    def _judge(self, before: Snapshot, after: Snapshot, stopped: bool) -> tuple[float, bool]:
        reward, done = self.get_reward({_BEFORE: self._points(1 - stopped), _AFTER: self._points()})
        return float(reward) + done + stopped * get_task(self.task).unstable_penalty, done or stopped

    def _points(self, ago: int = 0) -> np.ndarray:
        """Return the robot's points a number of steps ago, ``[2, points]``."""
        engine = self._sim._engine
        return engine.positions(engine.time - ago, "robot").T

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode with new random goals; return the observation and an empty dictionary."""
        if seed is not None:
            self._random = random.Random(seed)
        self.set_random_goals(20, 50, 100)
        return super().reset(seed=seed, options=options)
