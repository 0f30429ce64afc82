"""Object manipulation (paper section B.3)."""

from functools import partial
from operator import methodcaller

from warpvox.envs.spec import Memory, TaskSpec, Termination, observes, rewards, terminates
from warpvox.envs.terms.observations import orientation, separation, shape, velocity
from warpvox.envs.terms.rewards import away_from_start, displacement, distance, drop, gap, motion, staged_drop
from warpvox.envs.terms.terminations import beyond, short
from warpvox.envs.worlds import block, heights, rows
from warpvox.types import VOXEL

_ROBOT, _PACKAGE = observes(velocity), observes(velocity, "package")
_BETWEEN, _TURN = observes(separation, "package", other="robot"), observes(orientation, "package")
_RELEASED = (_ROBOT, _BETWEEN, _PACKAGE, observes(shape))
# The paper has the velocities the other way round in all tasks that observe these four.
_PRINTED = (_PACKAGE, _BETWEEN, _ROBOT, observes(shape))
_task = partial(TaskSpec, robot_cell=(1, 1), max_episode_steps=1000)


def _arrives(x: float) -> tuple[Termination, ...]:
    return (terminates(beyond, axis="x", limit=x, bonus=1.0),)


_GROUND = block("ground", 100, 1)
_CARRIED = (
    rewards(distance, weight=-1.0, axis="x", goal=4.0),
    rewards(staged_drop, "package", weight=10.0, below=6 * VOXEL, x=2.0, below_beyond=4 * VOXEL),
)
_PUSHED = (
    rewards(displacement, "package", weight=0.75, axis="x"),
    rewards(displacement, weight=0.5, axis="x"),
    rewards(gap, "package", weight=-1.0, other="robot", axis="x"),
)
# As released: shared with the carriers, but the box would have to be below the floor.
_NEVER = rewards(drop, "package", weight=10.0, below=0.0)
_THROWN = rewards(displacement, "package", axis="x")

_BEAM = (
    observes(separation, "beam", other="robot"),
    observes(velocity),
    observes(velocity, "beam"),
    observes(orientation, "beam"),
    observes(shape),
)
_CLOSER = rewards(gap, "beam", weight=-1.0, other="robot", axis="x")
_STIRRED = (_CLOSER, rewards(motion, "beam", axis="x"), rewards(motion, "beam", weight=3.0, axis="y"))
# As released: the beam starts at 3.4, so that toppling it does not meet this; and the slider is to go to the right.
_LEFT = (terminates(short, "beam", axis="x", limit=0.2, bonus=1.0),)


TASKS = (
    _task(
        *("Carrier-v0", "B.3.1", "Catch a box that starts above and carry it as far as possible.", "easy"),
        objects=(_GROUND, block("package", 3, 2, "S", x=3, y=6)),
        max_episode_steps=500,
        observations=_RELEASED,
        rewards=(
            rewards(displacement, "package", weight=0.5, axis="x"),
            rewards(displacement, weight=0.5, axis="x"),
            rewards(drop, "package", weight=10.0, below=3 * VOXEL),
        ),
        terminations=_arrives(9.9),
        paper={"observations": _PRINTED},
    ),
    _task(
        *("Carrier-v1", "B.3.2", "Carry a box to a table and place it on the table.", "hard"),
        objects=(
            rows("ground", "26. 34F", "23. 4F 21. 2F", "24F 24. 2F", "48. 2F", y=1),
            block("package", 3, 2, "R", x=3, y=10),
        ),
        robot_cell=(1, 4),
        observations=_RELEASED,
        # As released: what the box gets for nearing its goal is computed, then overwritten.
        rewards=_CARRIED,
        paper={
            "observations": _PRINTED,
            "rewards": (rewards(distance, "package", weight=-2.0, axis="x", goal=4.85), *_CARRIED),
        },
    ),
    _task(
        *("Pusher-v0", "B.3.3", "Push a box that starts in front as far as possible.", "easy"),
        objects=(_GROUND, block("package", 3, 2, "S", x=8, y=1)),
        max_episode_steps=500,
        observations=_RELEASED,
        rewards=(*_PUSHED, _NEVER),
        terminations=_arrives(9.9),
        paper={"observations": _PRINTED, "rewards": _PUSHED},
    ),
    _task(
        *("Pusher-v1", "B.3.4", "Push or drag a box that starts behind as far as possible.", "medium"),
        objects=(_GROUND, block("package", 3, 2, "R", x=8, y=1)),
        robot_cell=(13, 1),
        max_episode_steps=600,
        observations=_RELEASED,
        rewards=(*_PUSHED, _NEVER),
        # As released: the line lies at voxel 69 of 100. The paper has it at the end of the terrain.
        terminations=_arrives(6.9),
        paper={"observations": _PRINTED, "rewards": _PUSHED, "terminations": _arrives(9.9)},
    ),
    _task(
        *("Thrower-v0", "B.3.5", "Throw a box that starts on top as far as possible.", "medium"),
        objects=(
            heights("ground", "1x10 3 1x3 4 1x3 5 1x4 7 1x4 8 1x10 10 1x29 10"),
            block("package", 3, 2, "S", x=3, y=7),
        ),
        max_episode_steps=300,
        observations=_RELEASED,
        rewards=(_THROWN, rewards(away_from_start, weight=-0.25)),
        paper={"observations": _PRINTED, "rewards": (_THROWN, rewards(away_from_start, weight=-1.0))},
    ),
    _task(
        *("Catcher-v0", "B.3.6", "Catch a fast, tumbling box.", "hard"),
        objects=(
            *(_GROUND, block("package", 3, 2, "S", x=21, y=41)),
            *(block("peg1", 5, 1, x=17, y=39), block("peg2", 5, 1, x=19, y=25)),
        ),
        robot_cell=(22, 1),
        max_episode_steps=400,
        observations=(_BETWEEN, _ROBOT, _PACKAGE, _TURN, observes(shape)),
        rewards=(
            rewards(gap, "package", weight=-1.0, other="robot", axis="x"),
            rewards(drop, "package", weight=10.0, below=0.5),
        ),
        # As released; the paper does not say that the box and the pegs are moved together, cell by cell.
        memory=(Memory("offset", methodcaller("cells", x=(-6, 4), y=(0, 5))),),
        randomized=("package", "peg1", "peg2"),
    ),
    _task(
        *("BeamToppler-v0", "B.3.7", "Knock a beam off two pegs from underneath.", "easy"),
        objects=(
            *(block("ground", 70, 1), block("peg1", 5, 1, x=27, y=4), block("peg2", 5, 1, x=36, y=4)),
            block("beam", 10, 2, "R", x=29, y=5),
        ),
        observations=_BEAM,
        rewards=(*_STIRRED, rewards(displacement, "beam", weight=-10.0, axis="y")),
        terminations=_LEFT,
        paper={
            "rewards": (*_STIRRED, rewards(displacement, "beam", weight=-1.0, axis="y")),
            # Reading of "completing the task": the beam's centre has come down past the tops of the pegs.
            "terminations": (terminates(short, "beam", axis="y", limit=0.5, bonus=1.0),),
        },
    ),
    _task(
        *("BeamSlider-v0", "B.3.8", "Slide a beam across a line of pegs from underneath.", "hard"),
        objects=(
            *(block("ground", 70, 1), block("peg1", 5, 1, x=20, y=4)),
            *(block(f"peg{k}", 3, 1, x=x, y=4) for k, x in ((2, 29), (3, 35), (4, 41), (5, 49))),
            block("beam", 10, 2, "R", x=22, y=5),
        ),
        observations=_BEAM,
        rewards=(_CLOSER, rewards(displacement, "beam", axis="x")),
        terminations=_LEFT,
        paper={"terminations": ()},
    ),
    _task(
        *("Lifter-v0", "B.3.9", "Lift a box out of a hole.", "hard"),
        objects=(
            rows("ground", "3. 5F", "3. F 3. F", "4F 3. 4F", "F 9. F", "F 9. F"),
            block("package", 1, 2, "R", x=5, y=1),
        ),
        robot_cell=(2, 3),
        max_episode_steps=300,
        observations=(_ROBOT, _BETWEEN, _PACKAGE, _TURN, observes(shape)),
        rewards=(
            rewards(displacement, "package", weight=10.0, axis="y"),
            rewards(distance, "package", weight=-10.0, axis="x", goal=0.55),
            rewards(drop, weight=20.0, below=3 * VOXEL),
        ),
        paper={"observations": (_BETWEEN, _ROBOT, _PACKAGE, _TURN, observes(shape))},
    ),
)
