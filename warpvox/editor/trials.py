"""Trial runs of the editor's documents: open-loop rollouts without a policy."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from warpvox.checks import check_integer, is_number
from warpvox.editor.documents import design_of, world_of
from warpvox.errors import ConfigError, TaskError, WorldError, did_you_mean
from warpvox.types import FRAME_SECONDS
from warpvox.view.rollout import Rollout, agent_of, record

if TYPE_CHECKING:
    from warpvox.envs.spec import TaskSpec

LONGEST = 20.0
"""Maximum simulated seconds of a trial rollout."""
MOST_MOVING = 1000
"""Maximum number of movable cells in a world that is simulated."""
TIME_LIMIT = 60.0
"""Seconds of real time after which a rollout is aborted."""


def try_out(
    document: Mapping[str, Any],
    agent: Any,
    seconds: object,
    seed: object,
    task: object,
    tasks: Mapping[str, TaskSpec],
) -> Rollout:
    """Record an open-loop episode of a body in a task, or of a world without a task.

    In a world the reward of a step is how far the centre of mass of the first robot has moved to the right, in
    simulator units (0.1 a voxel); without a robot it is 0.

    Args:
        document: see :mod:`warpvox.editor.documents`.
        agent: one of :data:`warpvox.view.rollout.AGENTS`.
        task: one of ``tasks``, for a body.
        tasks: what there is to choose from. A name of code that is not here is not imported.
    """
    if not is_number(seconds) or not FRAME_SECONDS <= seconds <= LONGEST:
        raise ConfigError(f"seconds must be a number from {FRAME_SECONDS} to {LONGEST:g}, got {seconds!r:.80}.")
    seed = check_integer("seed", seed, 0, 2**31 - 1)

    if document.get("kind") == "body":
        # A body in a task
        from warpvox.envs.vec_env import make_vec

        if not isinstance(task, str):
            raise ConfigError(f"task must be the id of a task, got {task!r:.80}.")
        if task not in tasks:
            hint = did_you_mean(task, tasks)
            raise TaskError(
                f"Unknown task {task!r:.80}.{hint} Tasks of your own are named when the editor is started:"
                " warpvox design tasks=[file.py:NAME]."
            )
        env: Any = make_vec(tasks[task], [design_of(document)], 1, device="cpu", seed=seed, auto_reset=False, threads=1)
    else:
        # A world as it stands
        from warpvox.simulation import Simulation

        world = world_of(document)
        moving = sum(int((obj.grid != 0).sum()) for obj in world.objects.values() if not obj.is_static)
        if not moving:
            raise WorldError("Nothing in this world moves: it needs cells that are not fixed.")
        if moving > MOST_MOVING:
            raise WorldError(f"{moving} cells of this world move; the editor tries out up to {MOST_MOVING}.")
        env = _OpenWorld(Simulation([world], device="cpu", threads=1), seed)

    act = agent_of(agent, env)
    deadline = time.monotonic() + TIME_LIMIT

    def in_time(obs: Any) -> Any:
        if time.monotonic() > deadline:
            raise ConfigError(f"This takes more than {TIME_LIMIT:g} s to simulate: choose fewer seconds or cells.")
        return act(obs)

    return record(env, in_time, round(seconds / FRAME_SECONDS), metadata={"agent": agent})


class _OpenWorld:
    """A simulation of one world behind an environment's interface, so that it can be recorded."""

    def __init__(self, sim: Any, seed: int) -> None:
        self.sim = sim
        self.seed = seed
        self.auto_reset = False
        self.num_envs = sim.num_envs
        self.num_actions = sim.num_actions
        self.max_episode_steps = round(LONGEST / FRAME_SECONDS)
        self._robot = min((obj.name for obj in sim.worlds[0].objects.values() if obj.is_robot), default=None)
        self._where = self._place()

    def _place(self) -> Any:
        return self.sim.unstable * 0.0 if self._robot is None else self.sim.com(self._robot)[:, 0]

    def reset(self) -> tuple[None, dict[str, Any]]:
        """Reset the world to its start."""
        self.sim.reset()
        self._where = self._place()
        return None, {}

    def step(self, actions: Any) -> tuple[Any, ...]:
        """Do a control step; the reward is the progress to the right, and there are no observations."""
        self.sim.step(actions)
        before = self._where
        self._where = self._place()
        return None, self._where - before, self.sim.unstable, self.sim.unstable & False, {}
