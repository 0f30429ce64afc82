"""Springs and strain limits in float64, rounded as the released simulator rounds; the sub-step is in ``substep.h``.

Sums and products are taken in its order, so that runs are equal bit for bit, which neither chaos nor ties can tell
apart. The float32 way (``actuation.py``, ``integrate.py``, ``strain.py``) is the same physics on displacements.
``disp`` is the position after the sub-step here.
"""

import functools
from pathlib import Path

import warp as wp

from warpvox.kernels.lanes import inline, lane_ops, native
from warpvox.kernels.state import structs

real = wp.float64
SUBSTEP = Path(__file__).with_name("substep.h").read_text(encoding="utf-8")


@functools.cache
def vectors(width: int):
    """Functions: the vector of a spring from its second to its first end in an array of points, and its length."""
    ops, types = lane_ops("float64", width), structs("float64")
    load, mul, root = ops.load, ops.mul, ops.root

    @inline
    def across(model: types.Model, points: wp.array3d(dtype=real), design: int, pack: int, s: int, lane: int):
        a, b = 2 * model.spring_ends[design, s][0], 2 * model.spring_ends[design, s][1]
        ex = load(points, pack, a, lane) - load(points, pack, b, lane)
        ey = load(points, pack, a + 1, lane) - load(points, pack, b + 1, lane)
        return ex, ey, root(mul(ex, ex) + mul(ey, ey))

    return across


@functools.cache
def creep(precision: str, width: int):
    """Stage: equilibrium length of every spring for this sub-step, into ``pull``."""
    ops, types = lane_ops("float64", width), structs("float64")
    load, store, across = ops.load, ops.store, vectors(width)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: real):
        for s in range(model.springs[design]):
            _, _, length = across(model, data.pos, design, pack, s, lane)
            goal = load(data.goal, pack, s, lane)
            store(data.pull, pack, s, lane, length + (goal - length) * model.actuation_rate)

    return stage


@functools.cache
def runge_kutta(precision: str, width: int):
    """Stage: position and new velocity of every free point after dt."""
    types = structs(precision)

    @wp.func_native(native(precision, width) + SUBSTEP)
    def substep(model: types.Model, data: types.Data, design: int, pack: int, lane: int, dt: wp.float64): ...

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        substep(model, data, design, pack, lane, dt)

    return stage


@functools.cache
def limit(precision: str, width: int):
    """Stage: strain limits on the new positions in ``disp``."""
    ops, types = lane_ops("float64", width), structs("float64")
    load, store, mul, div, splat = ops.load, ops.store, ops.mul, ops.div, ops.splat
    at_most, upper, lower, across = ops.at_most, ops.upper, ops.lower, vectors(width)

    @inline
    def correction(
        model: types.Model, data: types.Data, design: int, pack: int, s: int, lane: int, bound: real, share: real
    ):
        """How far the first end moves away from the second, and whether it does in any lane."""
        ex, ey, length = across(model, data.disp, design, pack, s, lane)
        rest, one = model.spring_rest[design, s], real(1.0)
        stress = div(length, splat(rest))
        strained = at_most(splat(one + bound), stress) | at_most(stress, splat(one - bound))
        if strained != 0:
            zero = splat(real(0.0))  # a spring within its limits moves nothing
            too_long = upper(length - splat(rest * (one + bound)), zero)
            excess = too_long + lower(length - splat(rest * (one - bound)), zero)
            part = div(excess, length * real(2.0))
            ex, ey = mul(ex, part) * share, mul(ey, part) * share
        return ex, ey, strained

    @inline
    def move(
        model: types.Model, data: types.Data, design: int, pack: int, p: int, lane: int, dx: ops.value, dy: ops.value
    ):
        if model.fixed[design, p] == 0:
            store(data.disp, pack, 2 * p, lane, load(data.disp, pack, 2 * p, lane) + dx)
            store(data.disp, pack, 2 * p + 1, lane, load(data.disp, pack, 2 * p + 1, lane) + dy)

    @inline
    def all_springs(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        """Corrections from one snapshot: noted, then taken by all first ends, then by all second ends."""
        found = int(0)
        zero = splat(real(0.0))
        for s in range(model.springs[design]):
            dx, dy, strained = correction(model, data, design, pack, s, lane, model.strain_limit, model.strain_share)
            if strained == 0:
                dx, dy = zero, zero
            found = found | strained
            store(data.tension, pack, 2 * s, lane, dx)
            store(data.tension, pack, 2 * s + 1, lane, dy)
        if found != 0:
            for s in range(model.springs[design]):
                dx, dy = load(data.tension, pack, 2 * s, lane), load(data.tension, pack, 2 * s + 1, lane)
                move(model, data, design, pack, model.spring_ends[design, s][0], lane, -dx, -dy)
            for s in range(model.springs[design]):
                dx, dy = load(data.tension, pack, 2 * s, lane), load(data.tension, pack, 2 * s + 1, lane)
                move(model, data, design, pack, model.spring_ends[design, s][1], lane, dx, dy)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: real):
        all_springs(model, data, design, pack, lane)
        bound, share = model.rigid_strain_limit, model.rigid_strain_share
        for n in range(model.rigids[design]):
            s = model.rigid_spring[design, n]
            dx, dy, strained = correction(model, data, design, pack, s, lane, bound, share)
            if strained != 0:
                move(model, data, design, pack, model.spring_ends[design, s][0], lane, -dx, -dy)
                move(model, data, design, pack, model.spring_ends[design, s][1], lane, dx, dy)

    return stage


@functools.cache
def advance(precision: str, width: int):
    """Stage: positions move; true velocity and drift follow."""
    ops, types = lane_ops("float64", width), structs("float64")
    load, store, splat = ops.load, ops.store, ops.splat

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: real):
        path = splat(real(0.0))
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            place = load(data.disp, pack, r, lane)
            move = place - load(data.pos, pack, r, lane)
            store(data.pos, pack, r, lane, place)
            store(data.true_vel, pack, r, lane, ops.div(move, splat(dt)))
            path = ops.grow(path, move)
        data.drift[unit] = data.drift[unit] + ops.largest(path)

    return stage


STAGES = (creep, runge_kutta, limit, advance)
