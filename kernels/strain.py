"""Strain limiting (paper section A.4): moves points, leaves velocities alone.

First pass: all springs from one snapshot, beyond ``strain_limit`` (25 % of the rest length). Second pass: the sides of
rigid voxels one after another, in place, beyond ``rigid_strain_limit`` (3 %). Each end of a spring moves by the pass's
share of half the excess. Both passes work on displacements, after the integration.
"""

import functools

import warp as wp

from warpvox.kernels.lanes import casts, inline, lane_ops, native
from warpvox.kernels.state import structs

# The first spring from ``begin`` on (of those of rigid sides: the first place in their list) that is at or beyond the
# bound in some lane, or one past the last.
NEXT_STRAINED = """
    const int count = rigid ? wp::index(model.rigids, design) : wp::index(model.springs, design);
    const int* listed = &wp::index(model.rigid_spring, design, 0);
    const wp::vec_t<2, int>* spring_ends = &wp::index(model.spring_ends, design, 0);
    const double* spring_rest = &wp::index(model.spring_rest, design, 0);
    const auto disp = values(data.disp);
    const auto span = values(data.span);
    for (int n = begin; n < count; ++n) {
        const int s = rigid ? listed[n] : n;
        const unsigned a = 2 * spring_ends[s][0], b = 2 * spring_ends[s][1];
        const Value ex = span[2 * s] + (disp[b] - disp[a]), ey = span[2 * s + 1] + (disp[b + 1] - disp[a + 1]);
        const Value square = ex * ex + ey * ey;
        const Real rest = static_cast<Real>(spring_rest[s]);
        const Real longest = rest * (Real(1) + bound), shortest = rest * (Real(1) - bound);
        if (bits_of((square >= longest * longest) | (square <= shortest * shortest))) return n;
    }
    return count;
"""


@functools.cache
def limit(precision: str, width: int):
    """Stage: both passes."""
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
    upper, lower = ops.upper, ops.lower
    load_state, store_state, widen = wide.load, wide.store, casts(precision, width).widen

    @inline
    def across(data: types.Data, pack: int, row: int, a: int, b: int, lane: int):
        """One component of a displaced spring."""
        shift = load(data.disp, pack, b, lane) - load(data.disp, pack, a, lane)
        return load(data.span, pack, row, lane) + shift

    @wp.func_native(native(precision, width) + NEXT_STRAINED)
    def next_strained(
        model: types.Model, data: types.Data, design: int, pack: int, lane: int, begin: int, rigid: int, bound: real
    ) -> int: ...

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
        s = next_strained(model, data, design, pack, lane, 0, 0, model.strain_limit)
        while s < model.springs[design]:
            if found == 0:
                collect(model, data, design, pack, lane, True)
                found = 1
            dx, dy = correction(model, data, design, pack, s, lane, model.strain_limit, model.strain_share)
            ends = model.spring_ends[design, s]
            if model.fixed[design, ends[0]] == 0:
                shift(data, data.force, pack, ends[0], lane, dx, dy)
            if model.fixed[design, ends[1]] == 0:
                shift(data, data.force, pack, ends[1], lane, -dx, -dy)
            s = next_strained(model, data, design, pack, lane, s + 1, 0, model.strain_limit)
        if found == 1:
            for n in range(2 * model.actives[design]):
                r = model.active[design, n]
                store(data.disp, pack, r, lane, load(data.disp, pack, r, lane) + load(data.force, pack, r, lane))
            collect(model, data, design, pack, lane, False)

    @inline
    def rigid_sides(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        found = int(0)
        n = next_strained(model, data, design, pack, lane, 0, 1, model.rigid_strain_limit)
        while n < model.rigids[design]:
            s = model.rigid_spring[design, n]
            if found == 0:
                collect(model, data, design, pack, lane, True)
                found = 1
            dx, dy = correction(model, data, design, pack, s, lane, model.rigid_strain_limit, model.rigid_strain_share)
            ends = model.spring_ends[design, s]
            if model.fixed[design, ends[0]] == 0:
                shift(data, data.disp, pack, ends[0], lane, dx, dy)
                shift(data, data.force, pack, ends[0], lane, dx, dy)
            if model.fixed[design, ends[1]] == 0:
                shift(data, data.disp, pack, ends[1], lane, -dx, -dy)
                shift(data, data.force, pack, ends[1], lane, -dx, -dy)
            n = next_strained(model, data, design, pack, lane, n + 1, 1, model.rigid_strain_limit)
        if found == 1:
            collect(model, data, design, pack, lane, False)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        all_springs(model, data, design, pack, lane)
        rigid_sides(model, data, design, pack, lane)

    return stage
