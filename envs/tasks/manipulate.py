"""Object manipulation (paper section B.3)."""

from operator import methodcaller

from warpvox.envs.spec import Memory, TaskSpec, observes, rewards, terminates
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


def _task(id, section, summary, difficulty, *objects, cell=(1, 1), steps=1000, sees, gains, ends=(), **others):
    """A task over ``objects``: what the robot observes, what it gains, what ends an episode."""
    return TaskSpec(
        id=id,
        section=section,
        summary=summary,
        difficulty=difficulty,
        objects=objects,
        robot_cell=cell,
        max_episode_steps=steps,
        observations=sees,
        rewards=gains,
        terminations=ends,
        **others,
    )


def _arrives(x):
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
        *(_GROUND, block("package", 3, 2, "S", x=3, y=6)),
        steps=500,
        sees=_RELEASED,
        gains=(
            rewards(displacement, "package", weight=0.5, axis="x"),
            rewards(displacement, weight=0.5, axis="x"),
            rewards(drop, "package", weight=10.0, below=3 * VOXEL),
        ),
        ends=_arrives(9.9),
        paper={"observations": _PRINTED},
    ),
    _task(
        *("Carrier-v1", "B.3.2", "Carry a box to a table and place it on the table.", "hard"),
        rows("ground", "26. 34F", "23. 4F 21. 2F", "24F 24. 2F", "48. 2F", y=1),
        block("package", 3, 2, "R", x=3, y=10),
        cell=(1, 4),
        sees=_RELEASED,
        # As released: what the box gets for nearing its goal is computed, then overwritten.
        gains=_CARRIED,
        paper={
            "observations": _PRINTED,
            "rewards": (rewards(distance, "package", weight=-2.0, axis="x", goal=4.85), *_CARRIED),
        },
    ),
    _task(
        *("Pusher-v0", "B.3.3", "Push a box that starts in front as far as possible.", "easy"),
        *(_GROUND, block("package", 3, 2, "S", x=8, y=1)),
        steps=500,
        sees=_RELEASED,
        gains=(*_PUSHED, _NEVER),
        ends=_arrives(9.9),
        paper={"observations": _PRINTED, "rewards": _PUSHED},
    ),
    _task(
        *("Pusher-v1", "B.3.4", "Push or drag a box that starts behind as far as possible.", "medium"),
        *(_GROUND, block("package", 3, 2, "R", x=8, y=1)),
        cell=(13, 1),
        steps=600,
        sees=_RELEASED,
        gains=(*_PUSHED, _NEVER),
        # As released: the line lies at voxel 69 of 100. The paper has it at the end of the terrain.
        ends=_arrives(6.9),
        paper={"observations": _PRINTED, "rewards": _PUSHED, "terminations": _arrives(9.9)},
    ),
    _task(
        *("Thrower-v0", "B.3.5", "Throw a box that starts on top as far as possible.", "medium"),
        heights("ground", "1x10 3 1x3 4 1x3 5 1x4 7 1x4 8 1x10 10 1x29 10"),
        block("package", 3, 2, "S", x=3, y=7),
        steps=300,
        sees=_RELEASED,
        gains=(_THROWN, rewards(away_from_start, weight=-0.25)),
        paper={"observations": _PRINTED, "rewards": (_THROWN, rewards(away_from_start, weight=-1.0))},
    ),
    _task(
        *("Catcher-v0", "B.3.6", "Catch a fast, tumbling box.", "hard"),
        *(_GROUND, block("package", 3, 2, "S", x=21, y=41)),
        *(block("peg1", 5, 1, x=17, y=39), block("peg2", 5, 1, x=19, y=25)),
        cell=(22, 1),
        steps=400,
        sees=(_BETWEEN, _ROBOT, _PACKAGE, _TURN, observes(shape)),
        gains=(
            rewards(gap, "package", weight=-1.0, other="robot", axis="x"),
            rewards(drop, "package", weight=10.0, below=0.5),
        ),
        # As released; the paper does not say that the box and the pegs are moved together, cell by cell.
        memory=(Memory("offset", methodcaller("cells", x=(-6, 4), y=(0, 5))),),
        randomized=("package", "peg1", "peg2"),
    ),
    _task(
        *("BeamToppler-v0", "B.3.7", "Knock a beam off two pegs from underneath.", "easy"),
        *(block("ground", 70, 1), block("peg1", 5, 1, x=27, y=4), block("peg2", 5, 1, x=36, y=4)),
        block("beam", 10, 2, "R", x=29, y=5),
        sees=_BEAM,
        gains=(*_STIRRED, rewards(displacement, "beam", weight=-10.0, axis="y")),
        ends=_LEFT,
        paper={
            "rewards": (*_STIRRED, rewards(displacement, "beam", weight=-1.0, axis="y")),
            # Reading of "completing the task": the beam's centre has come down past the tops of the pegs.
            "terminations": (terminates(short, "beam", axis="y", limit=0.5, bonus=1.0),),
        },
    ),
    _task(
        *("BeamSlider-v0", "B.3.8", "Slide a beam across a line of pegs from underneath.", "hard"),
        *(block("ground", 70, 1), block("peg1", 5, 1, x=20, y=4)),
        *(block(f"peg{k}", 3, 1, x=x, y=4) for k, x in ((2, 29), (3, 35), (4, 41), (5, 49))),
        block("beam", 10, 2, "R", x=22, y=5),
        sees=_BEAM,
        gains=(_CLOSER, rewards(displacement, "beam", axis="x")),
        ends=_LEFT,
        paper={"terminations": ()},
    ),
    _task(
        *("Lifter-v0", "B.3.9", "Lift a box out of a hole.", "hard"),
        rows("ground", "3. 5F", "3. F 3. F", "4F 3. 4F", "F 9. F", "F 9. F"),
        block("package", 1, 2, "R", x=5, y=1),
        cell=(2, 3),
        steps=300,
        sees=(_ROBOT, _BETWEEN, _PACKAGE, _TURN, observes(shape)),
        gains=(
            rewards(displacement, "package", weight=10.0, axis="y"),
            rewards(distance, "package", weight=-10.0, axis="x", goal=0.55),
            rewards(drop, weight=20.0, below=3 * VOXEL),
        ),
        paper={"observations": (_BETWEEN, _ROBOT, _PACKAGE, _TURN, observes(shape))},
    ),
)
