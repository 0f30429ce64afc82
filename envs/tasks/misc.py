"""Flipping, jumping and balancing (paper section B.7)."""

from warpvox.envs.spec import Function, Observation, Reward, TaskSpec, observes, rewards, terminates
from warpvox.envs.terms.observations import elevation, floor, orientation, shape, short_of, velocity
from warpvox.envs.terms.rewards import displacement, distance, motion, turned
from warpvox.envs.terms.terminations import short
from warpvox.envs.worlds import block, heights
from warpvox.types import VOXEL

FLIPPER = TaskSpec(
    id="Flipper-v0",
    section="B.7.1",
    summary="Flip counter-clockwise as many times as possible on flat terrain.",
    difficulty="easy",
    objects=(block("new_object_1", 70, 1),),
    robot_cell=(60, 1),
    max_episode_steps=600,
    observations=(observes(orientation), observes(shape)),
    rewards=(rewards(turned),),
    # As released: at the left end of the terrain it is over, which the paper does not say.
    terminations=(terminates(short, axis="x", limit=0.1),),
    paper={"terminations": ()},
)


def _sees(terrain: Function) -> tuple[Observation, ...]:
    return (observes(velocity), observes(shape), observes(terrain, reach=2, objects=("ground",)))


JUMPER = TaskSpec(
    id="Jumper-v0",
    section="B.7.2",
    summary="Jump as high as possible in place on flat terrain.",
    difficulty="easy",
    objects=(heights("ground", "8 1x58 8"),),
    robot_cell=(32, 1),
    max_episode_steps=500,
    observations=_sees(floor),
    rewards=(rewards(displacement, weight=10.0, axis="y"), rewards(motion, weight=-5.0, axis="x")),
    paper={"observations": _sees(elevation)},
)


def _stays(x: float, y: float) -> tuple[Reward, ...]:
    return tuple(rewards(distance, weight=-1.0, axis=axis, goal=goal) for axis, goal in (("x", x), ("y", y)))


BALANCER_0 = TaskSpec(
    id="Balancer-v0",
    section="B.7.3",
    summary="Start on top of a thin pole and balance on it.",
    difficulty="easy",
    objects=(heights("ground", "5 1x16 3 1x11 5"),),
    robot_cell=(15, 3),
    max_episode_steps=600,
    # As released: the goal is not observed, the orientation is; and the goal is not the middle of the pole, 1.75.
    observations=(observes(orientation), observes(shape)),
    rewards=_stays(17 * VOXEL, 5 * VOXEL),
    paper={"observations": (observes(short_of, x=17 * VOXEL, y=5 * VOXEL), observes(shape))},
)

BALANCER_1 = TaskSpec(
    id="Balancer-v1",
    section="B.7.4",
    summary="Jump onto a thin pole and balance on it.",
    difficulty="medium",
    objects=(heights("ground", "5 1x16 4 1x11 5"),),
    robot_cell=(10, 1),
    max_episode_steps=600,
    # As released: as in Balancer-v0.
    observations=(observes(orientation), observes(shape)),
    rewards=_stays(1.75, 6 * VOXEL),
    paper={"observations": (observes(short_of, x=1.75, y=6 * VOXEL), observes(shape))},
)

TASKS = (FLIPPER, JUMPER, BALANCER_0, BALANCER_1)
