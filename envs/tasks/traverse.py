"""Forward locomotion over difficult terrain (paper section B.5)."""

from math import radians
from typing import Any

from warpvox.envs.spec import Function, Observation, TaskSpec, Termination, observes, rewards, terminates
from warpvox.envs.terms.observations import ceiling, elevation, floor, orientation, overhang, shape, velocity
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.terms.terminations import beyond, fallen_or_tilted, reaches, short, tilted
from warpvox.envs.worlds import block, heights, rows
from warpvox.world import WorldObject


def _course(
    about: tuple[str, str, str, str],
    *objects: WorldObject,
    cell: tuple[int, int],
    steps: int = 1000,
    ends: tuple[Termination, ...],
    **paper: Any,
) -> TaskSpec:
    """Define a task of moving right over terrain ``objects`` with the height below observed."""

    def sees(terrain: Function) -> tuple[Observation, ...]:
        below = observes(terrain, reach=5, objects=tuple(obj.name for obj in objects))
        return (observes(velocity), observes(orientation), observes(shape), below)

    return TaskSpec(
        *about,
        objects=objects,
        robot_cell=cell,
        max_episode_steps=steps,
        observations=sees(floor),
        rewards=(rewards(displacement, axis="x"),),
        terminations=ends,
        paper={"observations": sees(elevation)} | paper,
    )


def _passes(limit: float, bonus: float = 2.0) -> Termination:
    """Declare a termination for reaching the end of a terrain: the centre of mass passes ``limit``."""
    return terminates(beyond, axis="x", limit=limit, bonus=bonus)


def _tilts(degrees: float) -> Termination:
    """Declare a termination with a penalty for rotating by more than ``degrees`` either way."""
    return terminates(tilted, low=radians(degrees), high=radians(360 - degrees), bonus=-3.0)


def _arrives(limit: float, bonus: float) -> tuple[Termination, ...]:
    """Declare a termination with ``bonus`` once the robot's front passes x = ``limit``.

    This is how we read the paper's "end of the terrain": ``limit`` lies one voxel before the wall or the edge.
    """
    return (terminates(reaches, axis="x", limit=limit, bonus=bonus),)


def _platforms(*places: tuple[int, int, int]) -> tuple[WorldObject, ...]:
    """Build platforms named platform_1, platform_2, ... from (width, x, y), the lower left cell."""
    return tuple(block(f"platform_{k}", width, 1, x=x, y=y) for k, (width, x, y) in enumerate(places, 1))


_FALLS = terminates(short, axis="y", limit=0.4, bonus=-3.0)


def _blocks() -> tuple[WorldObject, ...]:
    """Build three layers of rigid squares named block_0, block_1, ..."""
    # By the height of the layer: column and size of each
    layers = {
        1: [(20, 3), (24, 3), (27, 2), (31, 3), (34, 3), (38, 2), (41, 3), (45, 3)],
        4: [(21, 3), (24, 2), (26, 1), (29, 2), (31, 3), (34, 2), (36, 2), (40, 3), (43, 2), (46, 3)],
        7: [(x, 2) for x in range(20, 45, 3)],
    }
    squares = [(x, y, size) for y, layer in layers.items() for x, size in layer]
    return tuple(block(f"block_{k}", size, size, "R", x=x, y=y) for k, (x, y, size) in enumerate(squares))


def _sees_both(below: Function, above: Function) -> tuple[Observation, ...]:
    terrain = [observes(term, reach=5, objects=("terrain",)) for term in (below, above)]
    return (observes(velocity), observes(shape), *terrain)


TASKS = (
    _course(
        ("UpStepper-v0", "B.5.1", "Climb up stairs of varying lengths.", "medium"),
        rows("ground", "21F", "20. 10F", "29. 8F", "36. 7F", "42. 6F", "47. 5F", "51. 5F", "55. 7F", "61. 9F"),
        cell=(1, 1),
        steps=600,
        ends=(_passes(6.9), _tilts(75)),
    ),
    _course(
        ("DownStepper-v0", "B.5.2", "Climb down stairs of varying lengths.", "easy"),
        rows(
            *["ground", "65. 10F", "61. 5F", "57. 5F", "52. 6F", "47. 6F"],
            *["41. 7F", "35. 7F", "28. 8F", "20. 9F", "21F"],
        ),
        cell=(1, 11),  # as released: one voxel above the top stair
        steps=500,
        ends=(_passes(7.4), _tilts(90)),
    ),
    _course(
        ("ObstacleTraverser-v0", "B.5.3", "Walk across terrain that gets more and more bumpy.", "medium"),
        heights(
            "ground", "1x22 2 1x5 2 1x4 2x2 1x4 2 1x2 2x2 1 2 1 2 1x2 2x2 1x2 2 3 2x2 1 2 3 1 2x2 3 2 1 2x2 1x3 2 1x7"
        ),
        cell=(2, 1),
        ends=(_passes(7.9), _tilts(90)),
    ),
    _course(
        ("ObstacleTraverser-v1", "B.5.4", "Walk through very bumpy terrain.", "hard"),
        heights(
            "ground",
            "3x2 4 3 4 3x3 2 3 2x2 3x2 2x2 1 3 4 3 2 3x2 4 3 2 3 2 3x2 2 3 4x2 2 3 4 3 4x3 2 3 4 5 4 3 4 3 4 3 2x2 3 4"
            " 3 2 3 10x2",
        ),
        cell=(2, 4),
        # As released: the line lies inside the wall that closes the terrain, so that no robot gets the bonus.
        ends=(_passes(5.9),),
        terminations=_arrives(limit=5.7, bonus=2.0),
    ),
    _course(
        ("Hurdler-v0", "B.5.5", "Walk across terrain with tall obstacles.", "hard"),
        heights("ground", "1x12 2 1x7 3 1x7 2 1x7 3x2 1x7 2 1x6 3 1x5 3 1x10 6"),
        cell=(2, 4),  # as released: three voxels above the ground
        ends=(_tilts(90),),
    ),
    _course(
        ("PlatformJumper-v0", "B.5.6", "Cross floating platforms at different heights.", "hard"),
        *_platforms(*[(20, 0, 5), (10, 21, 7), (10, 33, 8), (10, 46, 6), (10, 57, 5), (10, 70, 6), (10, 81, 3)]),
        cell=(1, 6),
        # As released: a robot that falls and tilts pays twice. The top of the last platform lies at 0.4.
        ends=(_FALLS, _tilts(90)),
        terminations=(terminates(fallen_or_tilted, limit=0.4, low=radians(90), high=radians(270), bonus=-3.0),),
    ),
    _course(
        ("GapJumper-v0", "B.5.7", "Cross floating platforms of one height with gaps between them.", "hard"),
        *_platforms(*[(20, 0, 5), (10, 25, 5), (10, 40, 5), (10, 55, 5), (10, 70, 5)]),
        cell=(1, 6),
        ends=(_FALLS,),
    ),
    _course(
        ("Traverser-v0", "B.5.8", "Cross a pit of loose rigid blocks without sinking into it.", "hard"),
        *(
            rows("ground", "19. 31F", *5 * ["19. F 29. F"], "19. F 29. 11F", "19. F", "20F"),
            *_blocks(),
        ),  # the pit first: the blocks lie within its bounding box, and are terrain, too
        cell=(1, 9),
        steps=600,
        ends=(_passes(5.9),),
        max_episode_steps=1000,
    ),
    TaskSpec(
        id="CaveCrawler-v0",
        section="B.5.9",
        summary="Squeeze through caves and below low-hanging obstacles.",
        difficulty="medium",
        objects=(
            rows(
                *["terrain", "70F", "46. 5S 18. F", *2 * ["69. F"], "25. 6S 28. F 9. F", "23. 10S 9. 10S 7. 2F 8. F"],
                *["21. 14S 4. 15S 4. 3F 8. F", "20. 2F 12. 36F", *2 * ["20. F 48. F"], *4 * ["20. F"]],
            ),
        ),
        robot_cell=(1, 2),  # as released: one voxel above the ground
        max_episode_steps=1000,
        observations=_sees_both(floor, ceiling),
        rewards=(rewards(displacement, axis="x"),),
        # As released: the line is the face of the wall that closes the cave, so that no robot gets the bonus.
        terminations=(_passes(6.9, bonus=1.0),),
        paper={"observations": _sees_both(elevation, overhang), "terminations": _arrives(limit=6.8, bonus=1.0)},
    ),
)
