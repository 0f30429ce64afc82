"""Walking (paper section B.2)."""

from functools import partial

from warpvox.envs.spec import Memory, TaskSpec, observes, rewards, terminates
from warpvox.envs.terms.goals import all_goals_reached, approach_goal, draw_goals, first_goal, next_goal
from warpvox.envs.terms.observations import goal_number, goal_offset, goal_place, orientation, shape, velocity
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.terms.terminations import beyond
from warpvox.envs.worlds import block, rows

# As far as possible to the right.
_walk = partial(TaskSpec, max_episode_steps=500, rewards=(rewards(displacement, axis="x"),))


def _goals(way: int | None) -> tuple[Memory, ...]:
    """Declare the memories of a list of goals: positions from 20 to 49 voxels, and the index of the present goal."""
    start = partial(draw_goals, low=20, high=50, start=35, way=way)
    # As released: the observation still shows the goal that the step has reached, the reward the next one.
    return (Memory("goals", start), Memory("goal", first_goal, partial(next_goal, name="robot", within=0.2)))


TASKS = (
    _walk(
        *("Walker-v0", "B.2.1", "Walk as far as possible on flat terrain.", "easy"),
        objects=(block("ground", 100, 1),),
        robot_cell=(1, 1),
        observations=(observes(velocity), observes(shape)),
        terminations=(terminates(beyond, axis="x", limit=9.9, bonus=1.0),),
    ),
    _walk(
        *("BridgeWalker-v0", "B.2.2", "Walk as far as possible on a soft rope-bridge.", "easy"),
        objects=(
            rows(
                "new_object_2",
                "60F",
                "F 4. F 4. F 7. F 10. F 16. F 11. 2F",
                "F 4. F 4. F 7. F 10. F 16. F 11. 2F",
                "F 4S F 4S F 7S F 10S F 16S F 11S 2F",
                "F 4S F 4S F 7S F 10S F 16S F 11S 2F",
            ),
        ),
        robot_cell=(2, 5),
        observations=(observes(velocity), observes(orientation), observes(shape)),
        # As released: the line is the very edge of the bridge, so the centre of mass has to leave it.
        terminations=(terminates(beyond, axis="x", limit=6.0, bonus=1.0),),
    ),
    TaskSpec(
        *("BidirectionalWalker-v0", "B.2.3", "Walk to goals on either side, one after the other.", "medium"),
        objects=(block("new_object_1", 70, 1),),
        robot_cell=(33, 1),
        max_episode_steps=1000,
        observations=tuple(map(observes, (velocity, shape, goal_number, goal_place, goal_offset))),
        # As released: in the step that reaches a goal, the approach to the next one counts instead.
        rewards=(rewards(approach_goal),),
        terminations=(terminates(all_goals_reached, bonus=1.0),),
        memory=_goals(way=100),
        # The paper names no end of the list and no bonus for it.
        paper={"terminations": (), "memory": _goals(way=None)},
    ),
)
