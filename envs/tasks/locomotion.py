"""Walking and climbing (paper sections B.2 and B.4)."""

from warpvox.envs.spec import TaskSpec, ends, observes, rewards
from warpvox.envs.terms.observations import shape, velocity
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.terms.terminations import beyond
from warpvox.envs.worlds import block, columns

__all__ = ["TASKS"]

WALKER = TaskSpec(
    id="Walker-v0",
    section="B.2.1",
    summary="Walk as far as possible on flat terrain.",
    difficulty="easy",
    objects=(block("ground", 100, 1),),
    robot_cell=(1, 1),
    max_episode_steps=500,
    observations=(observes(velocity), observes(shape)),
    rewards=(rewards(displacement, axis="x"),),
    terminations=(ends(beyond, axis="x", limit=9.9, bonus=1.0),),
)

CLIMBER = TaskSpec(
    id="Climber-v0",
    section="B.4.1",
    summary="Climb as high as possible through a flat, vertical channel.",
    difficulty="medium",
    objects=(columns("pipe", "90F", *5 * ["F 88. F"], "90F"),),  # a shaft 5 wide, closed at both ends
    robot_cell=(1, 1),
    max_episode_steps=400,
    observations=(observes(velocity), observes(shape)),
    rewards=(rewards(displacement, axis="y"),),
    terminations=(ends(beyond, axis="y", limit=8.6, bonus=1.0),),
)

TASKS = (WALKER, CLIMBER)
