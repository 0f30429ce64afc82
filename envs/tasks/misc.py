"""Flipping, jumping and balancing (paper section B.7)."""

from warpvox.envs.spec import Function, Observation, TaskSpec, observes, rewards, terminates
from warpvox.envs.terms.observations import elevation, floor, orientation, shape, short_of, velocity
from warpvox.envs.terms.rewards import displacement, distance, motion, turned
from warpvox.envs.terms.terminations import short
from warpvox.envs.worlds import block, heights
from warpvox.types import VOXEL


def _sees(terrain: Function) -> tuple[Observation, ...]:
    return (observes(velocity), observes(shape), observes(terrain, reach=2, objects=("ground",)))


def _balancer(*about: str, profile: str, cell: tuple[int, int], x: float, y: float) -> TaskSpec:
    """Define a task of balancing on a pole with the goal at (x, y)."""
    return TaskSpec(
        *about,
        objects=(heights("ground", profile),),
        robot_cell=cell,
        max_episode_steps=600,
        # As released: the goal is not observed, the orientation is.
        observations=(observes(orientation), observes(shape)),
        rewards=tuple(rewards(distance, weight=-1.0, axis=axis, goal=goal) for axis, goal in (("x", x), ("y", y))),
        paper={"observations": (observes(short_of, x=x, y=y), observes(shape))},
    )


TASKS = (
    TaskSpec(
        *("Flipper-v0", "B.7.1", "Flip counter-clockwise as many times as possible on flat terrain.", "easy"),
        objects=(block("new_object_1", 70, 1),),
        robot_cell=(60, 1),
        max_episode_steps=600,
        observations=(observes(orientation), observes(shape)),
        rewards=(rewards(turned),),
        # As released: at the left end of the terrain it is over, which the paper does not say.
        terminations=(terminates(short, axis="x", limit=0.1),),
        paper={"terminations": ()},
    ),
    TaskSpec(
        *("Jumper-v0", "B.7.2", "Jump as high as possible in place on flat terrain.", "easy"),
        objects=(heights("ground", "8 1x58 8"),),
        robot_cell=(32, 1),
        max_episode_steps=500,
        observations=_sees(floor),
        rewards=(rewards(displacement, weight=10.0, axis="y"), rewards(motion, weight=-5.0, axis="x")),
        paper={"observations": _sees(elevation)},
    ),
    _balancer(
        *("Balancer-v0", "B.7.3", "Start on top of a thin pole and balance on it.", "easy"),
        profile="5 1x16 3 1x11 5",
        cell=(15, 3),
        x=17 * VOXEL,  # as released: the goal is not the middle of the pole, 1.75
        y=5 * VOXEL,
    ),
    _balancer(
        *("Balancer-v1", "B.7.4", "Jump onto a thin pole and balance on it.", "medium"),
        profile="5 1x16 4 1x11 5",
        cell=(10, 1),
        x=1.75,
        y=6 * VOXEL,
    ),
)
