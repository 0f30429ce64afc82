"""Strain limiting (paper section A.4): moves points, leaves velocities alone.

First pass: all springs from one snapshot, beyond 25 % of the rest length. Second pass: the sides of rigid voxels
one after another, in place, beyond 3 %. Both work on displacements, after the integration.
"""

import functools

import warp as wp

from warpvox.kernels import exact
from warpvox.kernels.lanes import casts, inline, lane_ops
from warpvox.kernels.launch import launch_stage
from warpvox.kernels.state import structs

SOFT_LIMIT, SOFT_SHARE = 0.25, 0.8  # limit on the strain; share of half the excess by which each end moves
RIGID_LIMIT, RIGID_SHARE = 0.03, 0.5


@functools.cache
def limit(precision: str, width: int):
    """Stage: both passes."""
    if precision == "float64":
        return exact.limit(width)
    ops, types, wide = lane_ops(precision, width), structs(precision), lane_ops("float64", width)
    real, load, store, mul, div, splat, root = (
        ops.real,
        ops.load,
        ops.store,
        ops.mul,
        ops.div,
        ops.splat,
        ops.root,
    )
    at_most, upper, lower = ops.at_most, ops.upper, ops.lower
    load_state, store_state, widen = wide.load, wide.store, casts(precision, width).widen

    @inline
    def across(data: types.Data, pack: int, row: int, a: int, b: int, lane: int):
        """One component of a displaced spring."""
        shift = load(data.disp, pack, b, lane) - load(data.disp, pack, a, lane)
        return load(data.span, pack, row, lane) + shift

    @inline
    def is_strained(model: types.Model, data: types.Data, design: int, pack: int, s: int, lane: int, bound: real):
        """Whether a spring is beyond the bound in any lane."""
        a, b = 2 * model.spring_ends[design, s][0], 2 * model.spring_ends[design, s][1]
        ex = across(data, pack, 2 * s, a, b, lane)
        ey = across(data, pack, 2 * s + 1, a + 1, b + 1, lane)
        square = mul(ex, ex) + mul(ey, ey)
        longest = real(model.spring_rest[design, s]) * (real(1.0) + bound)
        shortest = real(model.spring_rest[design, s]) * (real(1.0) - bound)
        return (at_most(splat(longest * longest), square) | at_most(square, splat(shortest * shortest))) != 0

    @inline
    def correction(
        model: types.Model,
        data: types.Data,
        design: int,
        pack: int,
        s: int,
        lane: int,
        bound: real,
        share: real,
    ):
        """How far the first end moves, toward the second where the spring is too long; 0 within the bound."""
        a, b = 2 * model.spring_ends[design, s][0], 2 * model.spring_ends[design, s][1]
        ex = across(data, pack, 2 * s, a, b, lane)
        ey = across(data, pack, 2 * s + 1, a + 1, b + 1, lane)
        length = root(mul(ex, ex) + mul(ey, ey))
        longest = splat(real(model.spring_rest[design, s]) * (real(1.0) + bound))
        shortest = splat(real(model.spring_rest[design, s]) * (real(1.0) - bound))
        zero = splat(real(0.0))
        excess = upper(length - longest, zero) + lower(length - shortest, zero)
        part = div(excess * (real(0.5) * share), length)
        return mul(ex, part), mul(ey, part)

    @inline
    def shift(
        data: types.Data,
        a: wp.array3d(dtype=real),
        pack: int,
        p: int,
        lane: int,
        dx: ops.value,
        dy: ops.value,
    ):
        store(a, pack, 2 * p, lane, load(a, pack, 2 * p, lane) + dx)
        store(a, pack, 2 * p + 1, lane, load(a, pack, 2 * p + 1, lane) + dy)

    @inline
    def collect(model: types.Model, data: types.Data, design: int, pack: int, lane: int, clear: bool):
        """Clear the corrections in ``force``, which is free after the integration, or take them into ``move``."""
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            if clear:
                store(data.force, pack, r, lane, splat(real(0.0)))
            else:
                change = widen(load(data.force, pack, r, lane))
                store_state(data.move, pack, r, lane, load_state(data.move, pack, r, lane) + change)

    @inline
    def all_springs(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        found = int(0)
        for s in range(model.springs[design]):
            if is_strained(model, data, design, pack, s, lane, real(SOFT_LIMIT)):
                if found == 0:
                    collect(model, data, design, pack, lane, True)
                    found = 1
                dx, dy = correction(model, data, design, pack, s, lane, real(SOFT_LIMIT), real(SOFT_SHARE))
                ends = model.spring_ends[design, s]
                if model.fixed[design, ends[0]] == 0:
                    shift(data, data.force, pack, ends[0], lane, dx, dy)
                if model.fixed[design, ends[1]] == 0:
                    shift(data, data.force, pack, ends[1], lane, -dx, -dy)
        if found == 1:
            for n in range(2 * model.actives[design]):
                r = model.active[design, n]
                store(data.disp, pack, r, lane, load(data.disp, pack, r, lane) + load(data.force, pack, r, lane))
            collect(model, data, design, pack, lane, False)

    @inline
    def rigid_sides(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        found = int(0)
        for n in range(model.rigids[design]):
            s = model.rigid_spring[design, n]
            if is_strained(model, data, design, pack, s, lane, real(RIGID_LIMIT)):
                if found == 0:
                    collect(model, data, design, pack, lane, True)
                    found = 1
                dx, dy = correction(model, data, design, pack, s, lane, real(RIGID_LIMIT), real(RIGID_SHARE))
                ends = model.spring_ends[design, s]
                if model.fixed[design, ends[0]] == 0:
                    shift(data, data.disp, pack, ends[0], lane, dx, dy)
                    shift(data, data.force, pack, ends[0], lane, dx, dy)
                if model.fixed[design, ends[1]] == 0:
                    shift(data, data.disp, pack, ends[1], lane, -dx, -dy)
                    shift(data, data.force, pack, ends[1], lane, -dx, -dy)
        if found == 1:
            collect(model, data, design, pack, lane, False)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        all_springs(model, data, design, pack, lane)
        rigid_sides(model, data, design, pack, lane)

    return stage


def launch(state):
    """Limit the strain of the displaced springs."""
    launch_stage(limit, state)
