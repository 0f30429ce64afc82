"""An environment of the benchmark, made from its :class:`warpvox.envs.spec.TaskSpec`."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from warpvox.envs.registry import get_task
from warpvox.envs.spec import TaskSpec
from warpvox.evogym.envs.base import BenchmarkBase, EvoGymBase
from warpvox.evogym.envs.moment import OBSERVATIONS, REWARDS, TERMINATIONS, Moment
from warpvox.evogym.world import EvoWorld, WorldObject
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["TaskEnv"]

_BOUND = 100.0  # as released: nominal, observations are not clipped
_FOLLOWED = ("package", "beam")


class TaskEnv(BenchmarkBase):
    """A task of the benchmark with the rules of the release. A subclass says which, as ``task``.

    Observations are float64 ``[n]``, actions ``[actuators]``: goal lengths of the actuators, row by row from the top of
    the body, in units of their rest length. An environment that has ended can be stepped on.

    Args:
        body: cells ``[rows, columns]``, row 0 on top; with an actuator.
        connections: ``[2, k]`` pairs of flat indices; None connects all neighbours.
        render_mode, render_options: see :class:`EvoGymBase`.

    Raises:
        WorldError (a ValueError): the body is not valid or does not fit. ArgumentError: it has no actuator.

    Attributes:
        world: the world, with the body as ``robot``.
        sight_dist: windows of terrain that are observed to each side, in tasks that observe it.
        terrain_list: the objects that are terrain then.
    """

    task = ""

    def __init__(
        self,
        body: np.ndarray,
        connections: np.ndarray | None = None,
        render_mode: str | None = None,
        render_options: dict[str, Any] | None = None,
    ) -> None:
        self._spec = get_task(self.task)
        self.world = self._make_world(self._spec, body, connections)
        BenchmarkBase.__init__(self, world=self.world, render_mode=render_mode, render_options=render_options)
        self.default_viewer.track_objects("robot", *(name for name in _FOLLOWED if name in self.world.objects))
        self._observations = [(OBSERVATIONS.get(t.function.__name__), dict(t.params)) for t in self._spec.observations]
        self._rewards = [(REWARDS.get(t.function.__name__), dict(t.params), t.weight) for t in self._spec.rewards]
        self._ends = [(TERMINATIONS.get(t.function.__name__), dict(t.params), t.bonus) for t in self._spec.terminations]
        for _, params in self._observations:
            if "reach" in params:
                self.sight_dist, self.terrain_list = params["reach"], list(params["objects"])
        self._last: Moment | None = None
        count = self.get_actuator_indices("robot").size
        self.action_space = spaces.Box(ACTION_LOW, ACTION_HIGH, (count,), float)
        self.observation_space = spaces.Box(-_BOUND, _BOUND, self._observe(self._moment()).shape, float)

    def _make_world(self, spec: TaskSpec, body: np.ndarray, connections: np.ndarray | None) -> EvoWorld:
        world = EvoWorld()
        for obj in spec.objects:
            world.add_object(WorldObject.from_core(obj))
        world.add_from_array("robot", body, *spec.robot_cell, connections=connections)
        return world

    def _moment(self) -> Moment:
        """The present, known from the last step if nothing has happened since."""
        engine = self._sim._engine
        if self._last is None or self._last.changes != engine.changes:
            self._last = Moment(engine)
        return self._last

    def _observe(self, now: Moment) -> np.ndarray:
        return np.concatenate([look(now, **params) for look, params in self._observations])

    def _judge(self, before: Moment, after: Moment) -> tuple[float, bool]:
        """Reward of a step, and whether the task has ended with it."""
        reward, ended = 0.0, False
        for score, params, weight in self._rewards:
            reward += weight * float(score(before, after, **params))
        for test, params, bonus in self._ends:
            if test(after, **params):
                reward, ended = reward + bonus, True
        return reward, ended

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control step.

        Returns:
            Observation, reward, terminated, False (the time limit is gymnasium's), and an empty dictionary.

        Raises:
            ArgumentError (a ValueError): another number of values than actuators.
        """
        before = self._moment()
        stopped = EvoGymBase.step(self, {"robot": action})
        after = self._moment()
        obs = self._observe(after)
        reward, ended = self._judge(before, after)
        if stopped:
            reward += self._spec.unstable_penalty
        return obs, reward, stopped or ended, False, {}

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode; ``options`` are not used. Returns the observation and an empty dictionary."""
        EvoGymBase.reset(self, seed=seed, options=options)
        return self._observe(self._moment()), {}
