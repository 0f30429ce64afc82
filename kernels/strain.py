"""Strain limiting (paper section A.4): moves points, leaves velocities alone.

First pass: all springs from one snapshot, beyond 25 % of the rest length. Second pass: the sides of rigid voxels
one after another, in place, beyond 3 %. Both work on displacements, after the integration.
"""

import functools

import warp as wp

from warpvox.kernels.lanes import lane_ops
from warpvox.kernels.launch import launch_stage
from warpvox.kernels.state import structs

SOFT_LIMIT, SOFT_SHARE = 0.25, 0.8  # limit on the strain; share of half the excess by which each end moves
RIGID_LIMIT, RIGID_SHARE = 0.03, 0.5


@functools.cache
def limit(precision: str, width: int):
    """Stage: both passes."""
    ops, types = lane_ops(precision, width), structs(precision)
    real, load, store, mul, splat = ops.real, ops.load, ops.store, ops.mul, ops.splat
    at_most, first, drop = ops.at_most, ops.first, ops.drop

    @wp.func
    def strained(model: types.Model, data: types.Data, design: int, pack: int, s: int, lane: int, bound: real):
        """Lanes in which a spring is beyond the bound."""
        ends = model.spring_ends[design, s]
        ex = load(data.span, pack, 2 * s, lane) + (
            load(data.disp, pack, 2 * ends[1], lane) - load(data.disp, pack, 2 * ends[0], lane)
        )
        ey = load(data.span, pack, 2 * s + 1, lane) + (
            load(data.disp, pack, 2 * ends[1] + 1, lane) - load(data.disp, pack, 2 * ends[0] + 1, lane)
        )
        square = mul(ex, ex) + mul(ey, ey)
        rest = model.spring_rest[design, s]
        longest = rest * (real(1.0) + bound)
        shortest = rest * (real(1.0) - bound)
        return at_most(splat(longest * longest), square) | at_most(square, splat(shortest * shortest))

    @wp.func
    def correction(
        model: types.Model, data: types.Data, design: int, pack: int, s: int, k: int, bound: real, share: real
    ):
        """How far the first end moves, toward the second where the spring is too long."""
        ends = model.spring_ends[design, s]
        ex = data.span[pack, 2 * s, k] + (data.disp[pack, 2 * ends[1], k] - data.disp[pack, 2 * ends[0], k])
        ey = data.span[pack, 2 * s + 1, k] + (
            data.disp[pack, 2 * ends[1] + 1, k] - data.disp[pack, 2 * ends[0] + 1, k]
        )
        length = wp.sqrt(ex * ex + ey * ey)
        rest = model.spring_rest[design, s]
        excess = wp.max(length - rest * (real(1.0) + bound), real(0.0))
        excess = excess + wp.min(length - rest * (real(1.0) - bound), real(0.0))
        part = share * excess / (real(2.0) * length)
        return ex * part, ey * part

    @wp.func
    def shift(
        model: types.Model, a: wp.array3d(dtype=real), design: int, pack: int, p: int, k: int, dx: real, dy: real
    ):
        if model.fixed[design, p] == 0:
            a[pack, 2 * p, k] = a[pack, 2 * p, k] + dx
            a[pack, 2 * p + 1, k] = a[pack, 2 * p + 1, k] + dy

    @wp.func
    def clear(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        for r in range(2 * model.points[design]):
            store(data.force, pack, r, lane, splat(real(0.0)))

    @wp.func
    def all_springs(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        found = int(0)
        for s in range(model.springs[design]):
            lanes = strained(model, data, design, pack, s, lane, real(SOFT_LIMIT))
            if lanes != 0 and found == 0:
                clear(model, data, design, pack, lane)  # `force` is free now and collects the corrections
                found = 1
            while lanes != 0:
                k = lane + first(lanes)
                dx, dy = correction(model, data, design, pack, s, k, real(SOFT_LIMIT), real(SOFT_SHARE))
                ends = model.spring_ends[design, s]
                shift(model, data.force, design, pack, ends[0], k, dx, dy)
                shift(model, data.force, design, pack, ends[1], k, -dx, -dy)
                lanes = drop(lanes)
        if found == 1:
            for r in range(2 * model.points[design]):
                store(data.disp, pack, r, lane, load(data.disp, pack, r, lane) + load(data.force, pack, r, lane))

    @wp.func
    def rigid_sides(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        for n in range(model.rigids[design]):
            s = model.rigid_spring[design, n]
            lanes = strained(model, data, design, pack, s, lane, real(RIGID_LIMIT))
            while lanes != 0:
                k = lane + first(lanes)
                dx, dy = correction(model, data, design, pack, s, k, real(RIGID_LIMIT), real(RIGID_SHARE))
                ends = model.spring_ends[design, s]
                shift(model, data.disp, design, pack, ends[0], k, dx, dy)
                shift(model, data.disp, design, pack, ends[1], k, -dx, -dy)
                lanes = drop(lanes)

    @wp.func
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: real):
        all_springs(model, data, design, pack, lane)
        rigid_sides(model, data, design, pack, lane)

    return stage


def launch(state):
    """Limit the strain of the displaced springs."""
    launch_stage(limit, state)
