"""Forward locomotion over difficult terrain (paper section B.5)."""

from math import radians

from warpvox.envs.spec import TaskSpec, observes, rewards, terminates
from warpvox.envs.terms.observations import ceiling, elevation, floor, orientation, overhang, shape, velocity
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.terms.terminations import beyond, fallen_or_tilted, reaches, short, tilted
from warpvox.envs.worlds import block, heights, rows

__all__ = ["TASKS"]


def _sees(terrain, *objects):
    """Observations of all robots of this family: velocity, orientation, shape and the terrain below."""
    below = observes(terrain, reach=5, objects=objects)
    return (observes(velocity), observes(orientation), observes(shape), below)


def _tilts(degrees):
    """The penalty for turning further than this to either side."""
    return terminates(tilted, low=radians(degrees), high=radians(360 - degrees), bonus=-3.0)


def _arrives(limit, bonus):
    """The end of a terrain that a wall closes a voxel beyond ``limit``: the front of the robot has passed it.

    Reading of the paper's "end of the terrain", whose line lies a voxel before the edge of open terrain, too.
    """
    return (terminates(reaches, axis="x", limit=limit, bonus=bonus),)


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
    terminations=(terminates(beyond, axis="x", limit=6.9, bonus=2.0), _tilts(75)),
    paper={"observations": _sees(elevation, "ground")},
)

STAIRS_DOWN = rows(
    *["ground", "65. 10F", "61. 5F", "57. 5F", "52. 6F", "47. 6F"],
    *["41. 7F", "35. 7F", "28. 8F", "20. 9F", "21F"],
)

DOWN_STEPPER = TaskSpec(
    id="DownStepper-v0",
    section="B.5.2",
    summary="Climb down stairs of varying lengths.",
    difficulty="easy",
    objects=(STAIRS_DOWN,),
    robot_cell=(1, 11),  # as released: one voxel above the top stair
    max_episode_steps=500,
    observations=_sees(floor, "ground"),
    rewards=(rewards(displacement, axis="x"),),
    terminations=(terminates(beyond, axis="x", limit=7.4, bonus=2.0), _tilts(90)),
    paper={"observations": _sees(elevation, "ground")},
)

BUMPS = heights(
    "ground",
    "1x22 2 1x5 2 1x4 2x2 1x4 2 1x2 2x2 1 2 1 2 1x2 2x2 1x2 2 3 2x2 1 2 3 1 2x2 3 2 1 2x2 1x3 2 1x7",
)

OBSTACLE_TRAVERSER_0 = TaskSpec(
    id="ObstacleTraverser-v0",
    section="B.5.3",
    summary="Walk across terrain that gets more and more bumpy.",
    difficulty="medium",
    objects=(BUMPS,),
    robot_cell=(2, 1),
    max_episode_steps=1000,
    observations=_sees(floor, "ground"),
    rewards=(rewards(displacement, axis="x"),),
    terminations=(terminates(beyond, axis="x", limit=7.9, bonus=2.0), _tilts(90)),
    paper={"observations": _sees(elevation, "ground")},
)

ROUGH = heights(
    "ground",
    "3x2 4 3 4 3x3 2 3 2x2 3x2 2x2 1 3 4 3 2 3x2 4 3 2 3 2 3x2 2 3 4x2 2 3 4 3 4x3 2 3 4 5 4 3 4 3 4 3 2x2 3 4"
    " 3 2 3 10x2",
)

OBSTACLE_TRAVERSER_1 = TaskSpec(
    id="ObstacleTraverser-v1",
    section="B.5.4",
    summary="Walk through very bumpy terrain.",
    difficulty="hard",
    objects=(ROUGH,),
    robot_cell=(2, 4),
    max_episode_steps=1000,
    observations=_sees(floor, "ground"),
    rewards=(rewards(displacement, axis="x"),),
    # As released: the line lies inside the wall that closes the terrain, so that no robot gets the bonus.
    terminations=(terminates(beyond, axis="x", limit=5.9, bonus=2.0),),
    paper={"observations": _sees(elevation, "ground"), "terminations": _arrives(limit=5.7, bonus=2.0)},
)

HURDLES = heights("ground", "1x12 2 1x7 3 1x7 2 1x7 3x2 1x7 2 1x6 3 1x5 3 1x10 6")

HURDLER = TaskSpec(
    id="Hurdler-v0",
    section="B.5.5",
    summary="Walk across terrain with tall obstacles.",
    difficulty="hard",
    objects=(HURDLES,),
    robot_cell=(2, 4),  # as released: three voxels above the ground
    max_episode_steps=1000,
    observations=_sees(floor, "ground"),
    rewards=(rewards(displacement, axis="x"),),
    terminations=(_tilts(90),),
    paper={"observations": _sees(elevation, "ground")},
)


def _platforms(*places):
    """Platforms of these widths at these cells, named from platform_1 on."""
    return tuple(block(f"platform_{k}", width, 1, x=x, y=y) for k, (width, x, y) in enumerate(places, 1))


PLATFORMS = _platforms(*[(20, 0, 5), (10, 21, 7), (10, 33, 8), (10, 46, 6), (10, 57, 5), (10, 70, 6), (10, 81, 3)])
_FALLS = terminates(short, axis="y", limit=0.4, bonus=-3.0)

PLATFORM_JUMPER = TaskSpec(
    id="PlatformJumper-v0",
    section="B.5.6",
    summary="Cross floating platforms at different heights.",
    difficulty="hard",
    objects=PLATFORMS,
    robot_cell=(1, 6),
    max_episode_steps=1000,
    observations=_sees(floor, *(platform.name for platform in PLATFORMS)),
    rewards=(rewards(displacement, axis="x"),),
    # As released: a robot that falls and tilts pays twice. The top of the last platform lies at 0.4.
    terminations=(_FALLS, _tilts(90)),
    paper={
        "observations": _sees(elevation, *(platform.name for platform in PLATFORMS)),
        "terminations": (terminates(fallen_or_tilted, limit=0.4, low=radians(90), high=radians(270), bonus=-3.0),),
    },
)

GAPS = _platforms(*[(20, 0, 5), (10, 25, 5), (10, 40, 5), (10, 55, 5), (10, 70, 5)])

GAP_JUMPER = TaskSpec(
    id="GapJumper-v0",
    section="B.5.7",
    summary="Cross floating platforms of one height with gaps between them.",
    difficulty="hard",
    objects=GAPS,
    robot_cell=(1, 6),
    max_episode_steps=1000,
    observations=_sees(floor, *(platform.name for platform in GAPS)),
    rewards=(rewards(displacement, axis="x"),),
    terminations=(_FALLS,),
    paper={"observations": _sees(elevation, *(platform.name for platform in GAPS))},
)

# Rigid squares by layers: height of the layer, then pairs of column and size.
LAYERS = {
    1: [(20, 3), (24, 3), (27, 2), (31, 3), (34, 3), (38, 2), (41, 3), (45, 3)],
    4: [(21, 3), (24, 2), (26, 1), (29, 2), (31, 3), (34, 2), (36, 2), (40, 3), (43, 2), (46, 3)],
    7: [(x, 2) for x in range(20, 45, 3)],
}
PIT = rows("ground", "19. 31F", *5 * ["19. F 29. F"], "19. F 29. 11F", "19. F", "20F")
SQUARES = [(x, y, size) for y, layer in LAYERS.items() for x, size in layer]
BLOCKS = tuple(block(f"block_{k}", size, size, "R", x=x, y=y) for k, (x, y, size) in enumerate(SQUARES))
_PIT_NAMES = ("ground", *(item.name for item in BLOCKS))  # robots see the blocks as terrain, too

TRAVERSER = TaskSpec(
    id="Traverser-v0",
    section="B.5.8",
    summary="Cross a pit of loose rigid blocks without sinking into it.",
    difficulty="hard",
    objects=(PIT, *BLOCKS),  # the pit first: the blocks lie within its bounding box
    robot_cell=(1, 9),
    max_episode_steps=600,
    observations=_sees(floor, *_PIT_NAMES),
    rewards=(rewards(displacement, axis="x"),),
    terminations=(terminates(beyond, axis="x", limit=5.9, bonus=2.0),),
    paper={"observations": _sees(elevation, *_PIT_NAMES), "max_episode_steps": 1000},
)

CAVE = rows(
    *["terrain", "70F", "46. 5S 18. F", *2 * ["69. F"], "25. 6S 28. F 9. F", "23. 10S 9. 10S 7. 2F 8. F"],
    *["21. 14S 4. 15S 4. 3F 8. F", "20. 2F 12. 36F", *2 * ["20. F 48. F"], *4 * ["20. F"]],
)


def _sees_both(below, above):
    terrain = [observes(term, reach=5, objects=("terrain",)) for term in (below, above)]
    return (observes(velocity), observes(shape), *terrain)


CAVE_CRAWLER = TaskSpec(
    id="CaveCrawler-v0",
    section="B.5.9",
    summary="Squeeze through caves and below low-hanging obstacles.",
    difficulty="medium",
    objects=(CAVE,),
    robot_cell=(1, 2),  # as released: one voxel above the ground
    max_episode_steps=1000,
    observations=_sees_both(floor, ceiling),
    rewards=(rewards(displacement, axis="x"),),
    # As released: the line is the face of the wall that closes the cave, so that no robot gets the bonus.
    terminations=(terminates(beyond, axis="x", limit=6.9, bonus=1.0),),
    paper={"observations": _sees_both(elevation, overhang), "terminations": _arrives(limit=6.8, bonus=1.0)},
)

TASKS = (
    UP_STEPPER,
    DOWN_STEPPER,
    OBSTACLE_TRAVERSER_0,
    OBSTACLE_TRAVERSER_1,
    HURDLER,
    PLATFORM_JUMPER,
    GAP_JUMPER,
    TRAVERSER,
    CAVE_CRAWLER,
)
