"""Changing shape (paper section B.6)."""

from functools import partial

from warpvox.envs.spec import TaskSpec, observes, rewards
from warpvox.envs.terms.observations import shape
from warpvox.envs.terms.rewards import grown, hull
from warpvox.envs.worlds import heights

# A robot that sees nothing but its shape, between two walls.
_change = partial(
    TaskSpec,
    objects=(heights("new_object_4", "10x2 1x16 10x2"),),
    robot_cell=(7, 1),
    max_episode_steps=600,
    observations=(observes(shape),),
)

TASKS = (
    _change(
        *("AreaMaximizer-v0", "B.6.1", "Grow to occupy the largest possible area.", "easy"),
        rewards=(rewards(hull, weight=10.0),),
        paper={"rewards": (rewards(hull, weight=1.0),)},
    ),
    _change(
        *("AreaMinimizer-v0", "B.6.2", "Shrink to occupy the smallest possible area.", "medium"),
        rewards=(rewards(hull, weight=-10.0),),
        paper={"rewards": (rewards(hull, weight=-1.0),)},
    ),
    # The release spells it WingspanMazimizer-v0; the registry knows that name as well.
    _change(
        *("WingspanMaximizer-v0", "B.6.3", "Grow to be as wide as possible.", "easy"),
        rewards=(rewards(grown, axis="x"),),
    ),
    _change(
        *("HeightMaximizer-v0", "B.6.4", "Grow to be as tall as possible.", "medium"),
        rewards=(rewards(grown, axis="y"),),
        max_episode_steps=500,
    ),
)
