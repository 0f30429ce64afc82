"""A list of goals along x that a robot has to reach one after the other (paper section B.2.3).

Memories: ``goals``, long ``[num_envs, LONGEST]``, their places in voxels, 0 behind the last; ``goal``, long
``[num_envs, 1]``, which of them is the present one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpvox.envs.about import about
from warpvox.envs.terms.arrays import double, library, replaced, taken
from warpvox.types import VOXEL

if TYPE_CHECKING:
    from torch import Tensor

    from warpvox.envs.random_stream import RandomStream
    from warpvox.envs.snapshot import Snapshot

LONGEST = 64  # goals that a list can hold; a way of 100 takes 10 on average, more than this practically never


def draw_goals(draws: RandomStream, low: int, high: int, start: int, way: int | None) -> Tensor:
    """Draw random goals in [low, high) voxels, long ``[num_envs, LONGEST]``; 0 after the last goal.

    Goals are drawn until the way from ``start`` past all of them has a length of ``way`` voxels.

    ``way=None``: the list does not end (within an episode).
    """
    goals = draws.integers(low, high, LONGEST)
    if way is None:
        return goals
    steps = goals.diff(prepend=goals.new_full((len(goals), 1), start)).abs()
    behind = steps.cumsum(1) - steps  # the way before each goal
    return goals.masked_fill(behind >= way, 0)


def first_goal(draws: RandomStream) -> Tensor:
    """Return the initial goal index 0, long ``[num_envs, 1]``."""
    return draws.zeros(1)


def next_goal(state: Snapshot, name: str, within: float) -> Tensor:
    """Return the index of the first goal, from the present one on, that is at least ``within`` away in x.

    If there is none, the index behind the list.
    """
    goals = state.memory("goals")
    count = goals.shape[1]
    xp = library(goals)
    number = xp.ones_like(goals[:1]).cumsum(1) - 1
    near = abs(double(goals) * VOXEL - state.com(name)[:, :1]) < within
    passed = (number < state.memory("goal")) | (near & (goals != 0))
    return xp.amin(replaced(number, passed, count), 1)[:, None]


def goal_x(state: Snapshot) -> Tensor:
    """Return the x of the present goal, float64 ``[num_envs, 1]``, or of the last one when all are reached."""
    goals = state.memory("goals")
    last = (goals > 0).sum(1)[:, None] - 1
    return double(taken(goals, library(goals).minimum(state.memory("goal"), last))) * VOXEL


@about("-Δ|x of the goal - x_{name}|")
def approach_goal(before: Snapshot, after: Snapshot, name: str) -> Tensor:
    """Return how much closer in x the object came to the present goal, taken after the step."""
    goal = goal_x(after)[:, 0]
    return abs(goal - before.com(name)[:, 0]) - abs(goal - after.com(name)[:, 0])


@about("all goals reached by {name}")
def all_goals_reached(state: Snapshot, name: str) -> Tensor:
    """Return whether all goals have been reached."""
    return state.memory("goal")[:, 0] >= (state.memory("goals") > 0).sum(1)
