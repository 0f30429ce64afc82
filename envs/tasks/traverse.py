"""Forward locomotion over difficult terrain (paper section B.5)."""

from math import radians

from warpvox.envs.spec import TaskSpec, ends, observes, rewards
from warpvox.envs.terms.observations import elevation, floor, orientation, shape, velocity
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.terms.terminations import beyond, tilted
from warpvox.envs.worlds import rows

__all__ = ["TASKS"]


def _sees(terrain, *objects):
    """What all robots of this family sense: velocity, orientation, shape and the terrain below."""
    below = observes(terrain, reach=5, objects=objects)
    return (observes(velocity), observes(orientation), observes(shape), below)


STAIRS_UP = rows("ground", "21F", "20. 10F", "29. 8F", "36. 7F", "42. 6F", "47. 5F", "51. 5F", "55. 7F", "61. 9F")

UP_STEPPER = TaskSpec(
    id="UpStepper-v0",
    section="B.5.1",
    summary="Climb up stairs of varying lengths.",
    difficulty="medium",
    objects=(STAIRS_UP,),
    robot_cell=(1, 1),
    max_episode_steps=600,
    observations=_sees(floor, "ground"),
    rewards=(rewards(displacement, axis="x"),),
    terminations=(
        ends(beyond, axis="x", limit=6.9, bonus=2.0),
        ends(tilted, low=radians(75), high=radians(285), bonus=-3.0),
    ),
    paper={"observations": _sees(elevation, "ground")},
)

TASKS = (UP_STEPPER,)
