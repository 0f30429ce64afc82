"""Environment of a benchmark task, built from the task's :class:`warpvox.envs.spec.TaskSpec`."""

import sys
from typing import Any

import numpy as np
from gymnasium import Env, spaces, wrappers
from gymnasium.envs.registration import EnvSpec

from warpvox.envs.registry import get_task
from warpvox.envs.snapshot import Snapshot
from warpvox.envs.spec import TaskSpec
from warpvox.evogym.envs.base import BenchmarkBase, EvoGymBase
from warpvox.evogym.world import EvoWorld, WorldObject
from warpvox.types import ACTION_HIGH, ACTION_LOW

__all__ = ["TaskEnv", "TimeLimit", "task_env"]


class TaskEnv(BenchmarkBase):
    """A task of the benchmark under the release's rules; subclasses set the id ``task``.

    Observations are float64 ``[n]``. Actions ``[actuators]`` are target lengths of the actuators, row by row from the
    top of the body, in units of their rest length. An environment that has ended can be stepped further.

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
        self.world = self._make_world(self._rules(), body, connections)
        BenchmarkBase.__init__(self, self.world, render_mode, render_options)
        # The camera follows what the robot handles, too.
        handled = [name for name in ("package", "beam") if name in self.world.objects]
        self.default_viewer.track_objects("robot", *handled)
        for params in (dict(term.params) for term in self._rules().observations):
            if "reach" in params:
                self.sight_dist = params["reach"]
                self.terrain_list = list(params["objects"])
        self.action_space = spaces.Box(ACTION_LOW, ACTION_HIGH, (self.get_dim_action_space("robot"),), np.float64)
        # As released: nominal, observations are not clipped.
        self.observation_space = spaces.Box(-100.0, 100.0, self._observe(self._state()).shape, np.float64)

    def _rules(self) -> TaskSpec:
        return get_task(self.task)

    def _make_world(self, spec: TaskSpec, body: np.ndarray, connections: np.ndarray | None) -> EvoWorld:
        world = EvoWorld()
        for obj in spec.objects:
            world.add_object(WorldObject.from_core(obj))
        world.add_from_array("robot", body, *spec.robot_cell, connections=connections)
        return world

    def _state(self) -> Snapshot:
        """Return the quantities that terms read from the present state, cached until the simulation moves."""
        if not hasattr(self, "_terms"):  # a subclass may make its own world and call another base's __init__
            from warpvox.envs.adapters.single import RowTerms  # brings torch, which registering must not

            self._terms = RowTerms(self._rules())
            self._compared = ()
            self._seen = None
            self._compared = self._terms.compared(self._state())
        engine = self._sim._engine
        if self._seen != (engine, engine.changes):
            self._seen = engine, engine.changes
            self._now = Snapshot(engine.sensors).fetch(self._compared)
        return self._now

    def _observe(self, now: Snapshot) -> np.ndarray:
        return self._terms.observe(now)

    def _judge(self, before: Snapshot, after: Snapshot, stopped: bool) -> tuple[float, bool]:
        """Compute the reward of a step, and whether the episode terminates."""
        terms, ended = self._terms.judge(before, after, stopped)
        return sum(terms.values()), ended

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Do a control step; return observation, reward, terminated, truncated (always False) and an empty info.

        ArgumentError (a ValueError): another number of values than actuators.
        """
        before = self._state()
        stopped = EvoGymBase.step(self, {"robot": action})
        after = self._state()
        obs = self._observe(after)
        return obs, *self._judge(before, after, stopped), False, {}

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode; return the observation and an empty dictionary. ``options`` are not used."""
        EvoGymBase.reset(self, seed=seed, options=options)
        return self._observe(self._state()), {}


class TimeLimit(wrappers.TimeLimit):
    """gymnasium's TimeLimit that exposes the environment's public attributes, such as ``env.sim``.

    Wrappers of gymnasium before 1.0 did so, and scripts rely on it. It takes the place of the TimeLimit that
    ``gymnasium.make`` has put around the environment.
    """

    def __init__(self, env: Env) -> None:
        steps = sys.maxsize  # made with max_episode_steps=-1
        if isinstance(env, wrappers.TimeLimit):
            steps = env.get_wrapper_attr("_max_episode_steps")
            env = env.env
        super().__init__(env, steps)

    def __getattr__(self, name: str) -> Any:
        """Return a public attribute of the wrapped environment."""
        if name.startswith("_"):  # private; and copying asks for such before there is an `env`
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        return self.env.get_wrapper_attr(name)

    def set_wrapper_attr(self, name: str, value: Any, *, force: bool = True) -> bool:
        """Set an attribute of this wrapper if present, else of the environment; return success."""
        if name in vars(self):
            setattr(self, name, value)
            return True
        return self.env.set_wrapper_attr(name, value, force=force)

    @property
    def spec(self) -> EnvSpec | None:
        """Specification for ``gymnasium.make(env.spec)``, with this time limit."""
        fresh = self._cached_spec is None
        spec = super().spec
        if fresh and spec is not None:
            spec.additional_wrappers += (self.wrapper_spec(),)
        return spec


def task_env(name: str, task: str, *bases: type, **constants: float) -> type:
    """Create the environment class of a task: :class:`TaskEnv` with further ``bases`` and class ``constants``."""
    module = sys._getframe(1).f_globals["__name__"]
    members = {"__module__": module, "__doc__": f"{task}: {get_task(task).summary}", "task": task, **constants}
    return type(name, (TaskEnv, *bases), members)
