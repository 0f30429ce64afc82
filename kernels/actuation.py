"""Delayed actuation: clip the actions, set each spring's goal, and let it creep toward that goal.

Every spring, actuated or not, has in each sub-step the equilibrium length l + rate (goal - l), where l is its
length at the sub-step's start (paper section A.4). This creep is also what damps the bodies.
"""

import functools

import warp as wp

from warpvox.kernels.lanes import casts, inline, lane_ops
from warpvox.kernels.state import structs


@functools.cache
def goals(precision: str, width: int):
    """Stage, once a control step: goal = rest length x mean of the actions that drive the spring."""
    ops, types = lane_ops("float64", width), structs(precision)
    load, store, splat = ops.load, ops.store, ops.splat

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        for s in range(model.springs[design]):
            rest = model.spring_rest[design, s]
            drive = model.spring_drive[design, s]
            goal = splat(rest)
            if drive[1] >= 0:
                both = load(data.action, pack, drive[0], lane) + load(data.action, pack, drive[1], lane)
                goal = both * (rest * wp.float64(0.5))
            elif drive[0] >= 0:
                goal = load(data.action, pack, drive[0], lane) * rest
            store(data.goal, pack, s, lane, goal)

    return stage


@functools.cache
def creep(precision: str, width: int):
    """Stage, every sub-step: spring vector, length and pull = equilibrium length - length at its start.

    Lengths are subtracted in float64: their rounding would act like another goal.
    """
    wide, types = lane_ops("float64", width), structs(precision)
    load, mul, root, store = wide.load, wide.mul, wide.root, lane_ops(precision, width).store
    narrow = casts(precision, width).narrow

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        for s in range(model.springs[design]):
            a, b = 2 * model.spring_ends[design, s][0], 2 * model.spring_ends[design, s][1]
            dx = load(data.pos, pack, b, lane) - load(data.pos, pack, a, lane)
            dy = load(data.pos, pack, b + 1, lane) - load(data.pos, pack, a + 1, lane)
            length = root(mul(dx, dx) + mul(dy, dy))
            pull = (load(data.goal, pack, s, lane) - length) * model.actuation_rate
            store(data.span, pack, 2 * s, lane, narrow(dx))
            store(data.span, pack, 2 * s + 1, lane, narrow(dy))
            store(data.length, pack, s, lane, narrow(length))
            store(data.pull, pack, s, lane, narrow(pull))

    return stage
