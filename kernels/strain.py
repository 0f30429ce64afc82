"""Strain limiting (paper section A.4): moves points, leaves velocities alone.

First pass: all springs from one snapshot, beyond ``strain_limit`` (25 % of the rest length). Second pass: the sides of
rigid voxels one after another, in place, beyond ``rigid_strain_limit`` (3 %). Each end of a spring moves by the pass's
share of half the excess. Both passes work on displacements, after the integration.
"""

import warp as wp

from warpvox.kernels.kit import Kit, builder


@builder
def limit(kit: Kit):
    """Stage: both passes."""
    real, value = kit.real, kit.value
    array = wp.array3d(dtype=real)

    @kit.func
    def across(data, pack, row, a, b, lane):
        """One component of a displaced spring."""
        shift = kit.load(data.disp, pack, b, lane) - kit.load(data.disp, pack, a, lane)
        return kit.load(data.span, pack, row, lane) + shift

    @kit.func_native("native/next_strained.h")
    def next_strained(model, data, design, pack, lane, begin, rigid, bound: real) -> int:
        """The next spring, or side in the list of rigid ones, that is at or beyond the bound in some lane."""
        ...

    @kit.func
    def correction(model, data, design, pack, s, lane, bound: real, share: real):
        """How far the first end moves, toward the second where the spring is too long; 0 within the bound."""
        a, b = 2 * model.spring_ends[design, s][0], 2 * model.spring_ends[design, s][1]
        ex, ey = across(data, pack, 2 * s, a, b, lane), across(data, pack, 2 * s + 1, a + 1, b + 1, lane)
        length = kit.root(kit.mul(ex, ex) + kit.mul(ey, ey))
        longest = kit.splat(real(model.spring_rest[design, s]) * (real(1.0) + bound))
        shortest = kit.splat(real(model.spring_rest[design, s]) * (real(1.0) - bound))
        zero = kit.splat(real(0.0))
        excess = kit.upper(length - longest, zero) + kit.lower(length - shortest, zero)
        part = kit.div(excess * (real(0.5) * share), length)
        return kit.mul(ex, part), kit.mul(ey, part)

    @kit.func
    def shift(data, a: array, pack, p, lane, dx: value, dy: value):
        """Add to both components of a point."""
        kit.store(a, pack, 2 * p, lane, kit.load(a, pack, 2 * p, lane) + dx)
        kit.store(a, pack, 2 * p + 1, lane, kit.load(a, pack, 2 * p + 1, lane) + dy)

    @kit.func
    def clear(model, data, design, pack, lane):
        """No corrections yet: they are summed in ``force``, which is free after the integration."""
        for n in range(2 * model.actives[design]):
            kit.store(data.force, pack, model.active[design, n], lane, kit.splat(real(0.0)))

    @kit.func
    def take(model, data, design, pack, lane):
        """Add the corrections to the displacements of the sub-step."""
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            change = kit.widen(kit.load(data.force, pack, r, lane))
            kit.wide.store(data.move, pack, r, lane, kit.wide.load(data.move, pack, r, lane) + change)

    @kit.func
    def all_springs(model, data, design, pack, lane):
        """First pass."""
        s = next_strained(model, data, design, pack, lane, 0, 0, model.strain_limit)
        if s >= model.springs[design]:
            return
        clear(model, data, design, pack, lane)
        while s < model.springs[design]:
            dx, dy = correction(model, data, design, pack, s, lane, model.strain_limit, model.strain_share)
            ends = model.spring_ends[design, s]
            if model.fixed[design, ends[0]] == 0:
                shift(data, data.force, pack, ends[0], lane, dx, dy)
            if model.fixed[design, ends[1]] == 0:
                shift(data, data.force, pack, ends[1], lane, -dx, -dy)
            s = next_strained(model, data, design, pack, lane, s + 1, 0, model.strain_limit)
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            kit.store(
                data.disp, pack, r, lane, kit.load(data.disp, pack, r, lane) + kit.load(data.force, pack, r, lane)
            )
        take(model, data, design, pack, lane)

    @kit.func
    def rigid_sides(model, data, design, pack, lane):
        """Second pass."""
        n = next_strained(model, data, design, pack, lane, 0, 1, model.rigid_strain_limit)
        if n >= model.rigids[design]:
            return
        clear(model, data, design, pack, lane)
        while n < model.rigids[design]:
            s = model.rigid_spring[design, n]
            dx, dy = correction(model, data, design, pack, s, lane, model.rigid_strain_limit, model.rigid_strain_share)
            ends = model.spring_ends[design, s]
            if model.fixed[design, ends[0]] == 0:
                shift(data, data.disp, pack, ends[0], lane, dx, dy)
                shift(data, data.force, pack, ends[0], lane, dx, dy)
            if model.fixed[design, ends[1]] == 0:
                shift(data, data.disp, pack, ends[1], lane, -dx, -dy)
                shift(data, data.force, pack, ends[1], lane, -dx, -dy)
            n = next_strained(model, data, design, pack, lane, n + 1, 1, model.rigid_strain_limit)
        take(model, data, design, pack, lane)

    @kit.func
    def stage(model, data, design, pack, lane, unit, dt):
        all_springs(model, data, design, pack, lane)
        rigid_sides(model, data, design, pack, lane)

    return stage
