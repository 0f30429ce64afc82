"""Object manipulation (paper section B.3)."""

from warpvox.envs.spec import TaskSpec, ends, observes, rewards
from warpvox.envs.terms.observations import separation, shape, velocity
from warpvox.envs.terms.rewards import displacement, drop
from warpvox.envs.terms.terminations import beyond
from warpvox.envs.worlds import block
from warpvox.types import VOXEL

__all__ = ["TASKS"]

_ROBOT, _PACKAGE = observes(velocity), observes(velocity, "package")
_BETWEEN = observes(separation, "package", other="robot")

CARRIER = TaskSpec(
    id="Carrier-v0",
    section="B.3.1",
    summary="Catch a box that starts above and carry it as far as possible.",
    difficulty="easy",
    objects=(block("ground", 100, 1), block("package", 3, 2, "S", x=3, y=6)),
    robot_cell=(1, 1),
    max_episode_steps=500,
    observations=(_ROBOT, _BETWEEN, _PACKAGE, observes(shape)),
    rewards=(
        rewards(displacement, "package", weight=0.5, axis="x"),
        rewards(displacement, weight=0.5, axis="x"),
        rewards(drop, "package", weight=10.0, below=3 * VOXEL),
    ),
    terminations=(ends(beyond, axis="x", limit=9.9, bonus=1.0),),
    # The release has the two velocities in the other order than the paper.
    paper={"observations": (_PACKAGE, _BETWEEN, _ROBOT, observes(shape))},
)

TASKS = (CARRIER,)
