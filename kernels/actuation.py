"""Delayed actuation: clip the actions, set each spring's goal, and let it creep toward that goal.

Every spring, actuated or not, has in each sub-step the equilibrium length l + rate (goal - l), where l is its
length at the sub-step's start (paper section A.4). This creep is also what damps the bodies.
"""

import functools

import warp as wp

from warpvox.kernels.lanes import lane_ops
from warpvox.kernels.launch import launch_stage
from warpvox.kernels.state import structs


@functools.cache
def goals(precision: str, width: int):
    """Stage, once a control step: goal = rest length x mean of the actions that drive the spring."""
    ops, types = lane_ops(precision, width), structs(precision)
    real, load, store, splat = ops.real, ops.load, ops.store, ops.splat

    @wp.func
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: real):
        for s in range(model.springs[design]):
            rest = model.spring_rest[design, s]
            drive = model.spring_drive[design, s]
            goal = splat(rest)
            if drive[1] >= 0:
                mean = (load(data.action, pack, drive[0], lane) + load(data.action, pack, drive[1], lane)) * real(0.5)
                goal = mean * rest
            elif drive[0] >= 0:
                goal = load(data.action, pack, drive[0], lane) * rest
            store(data.goal, pack, s, lane, goal)

    return stage


@functools.cache
def creep(precision: str, width: int):
    """Stage, every sub-step: spring vector, length and pull = equilibrium length - length at its start."""
    ops, types = lane_ops(precision, width), structs(precision)
    real, load, store, mul, root = ops.real, ops.load, ops.store, ops.mul, ops.root

    if precision == "float32":

        @wp.func
        def difference(data: types.Data, pack: int, a: int, b: int, lane: int):
            # Exact for neighbours: high parts cancel without rounding wherever the robot is.
            high = load(data.pos, pack, b, lane) - load(data.pos, pack, a, lane)
            return high + (load(data.pos_lo, pack, b, lane) - load(data.pos_lo, pack, a, lane))
    else:

        @wp.func
        def difference(data: types.Data, pack: int, a: int, b: int, lane: int):
            return load(data.pos, pack, b, lane) - load(data.pos, pack, a, lane)

    @wp.func
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: real):
        for s in range(model.springs[design]):
            ends = model.spring_ends[design, s]
            dx = difference(data, pack, 2 * ends[0], 2 * ends[1], lane)
            dy = difference(data, pack, 2 * ends[0] + 1, 2 * ends[1] + 1, lane)
            length = root(mul(dx, dx) + mul(dy, dy))
            store(data.span, pack, 2 * s, lane, dx)
            store(data.span, pack, 2 * s + 1, lane, dy)
            store(data.length, pack, s, lane, length)
            store(data.pull, pack, s, lane, (load(data.goal, pack, s, lane) - length) * model.actuation_rate)

    return stage


def launch(state):
    """Set the goals from the actions and the pulls from the positions."""
    launch_stage(goals, state)
    launch_stage(creep, state)
