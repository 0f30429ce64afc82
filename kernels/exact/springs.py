"""Springs and strain limits in float64, rounded as the released simulator rounds; the sub-step is in ``substep.h``.

Sums and products are taken in its order, so that runs are equal bit for bit, which neither chaos nor ties can tell
apart. The float32 way (``actuation.py``, ``integrate.py``, ``strain.py``) is the same physics on displacements.
``disp`` is the position after the sub-step here.
"""

import warp as wp

from warpvox.kernels.kit import Kit, builder

real = wp.float64


@builder
def vectors(kit: Kit):
    """Functions: the vector of a spring from its second to its first end in an array of points, and its length."""

    @kit.func
    def across(model, points: wp.array3d(dtype=real), mesh, pack, s, lane):
        a, b = 2 * model.spring_ends[mesh, s][0], 2 * model.spring_ends[mesh, s][1]
        ex = kit.load(points, pack, a, lane) - kit.load(points, pack, b, lane)
        ey = kit.load(points, pack, a + 1, lane) - kit.load(points, pack, b + 1, lane)
        return ex, ey, kit.root(kit.mul(ex, ex) + kit.mul(ey, ey))

    return across


@builder
def creep(kit: Kit):
    """Stage: equilibrium length of every spring for this sub-step, into ``pull``."""
    across = vectors(kit)

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        for s in range(model.springs[mesh]):
            _, _, length = across(model, data.pos, mesh, pack, s, lane)
            goal = kit.load(data.goal, pack, s, lane)
            kit.store(data.pull, pack, s, lane, length + (goal - length) * model.actuation_rate)

    return stage


@builder
def runge_kutta(kit: Kit):
    """Stage: position and new velocity of every free point after dt."""

    @kit.func_native("native/springs.h", "exact/substep.h")
    def substep(model, data, mesh, pack, lane, dt): ...

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        substep(model, data, mesh, pack, lane, dt)

    return stage


@builder
def limit(kit: Kit):
    """Stage: strain limits on the new positions in ``disp``."""
    across, value = vectors(kit), kit.value

    @kit.func
    def correction(model, data, mesh, pack, s, lane, bound: real, share: real):
        """How far the first end moves away from the second, and whether it does in any lane."""
        ex, ey, length = across(model, data.disp, mesh, pack, s, lane)
        rest, one = model.spring_rest[mesh, s], real(1.0)
        stress = kit.div(length, kit.splat(rest))
        strained = kit.at_most(kit.splat(one + bound), stress) | kit.at_most(stress, kit.splat(one - bound))
        if strained != 0:
            zero = kit.splat(real(0.0))  # a spring within its limits moves nothing
            too_long = kit.upper(length - kit.splat(rest * (one + bound)), zero)
            excess = too_long + kit.lower(length - kit.splat(rest * (one - bound)), zero)
            part = kit.div(excess, length * real(2.0))
            ex, ey = kit.mul(ex, part) * share, kit.mul(ey, part) * share
        return ex, ey, strained

    @kit.func
    def move(model, data, mesh, pack, p, lane, dx: value, dy: value):
        if model.free_lanes[mesh, p] != 0:
            kit.store(data.disp, pack, 2 * p, lane, kit.load(data.disp, pack, 2 * p, lane) + dx)
            kit.store(data.disp, pack, 2 * p + 1, lane, kit.load(data.disp, pack, 2 * p + 1, lane) + dy)

    @kit.func
    def all_springs(model, data, mesh, pack, lane):
        """Corrections from one snapshot: noted, then taken by all first ends, then by all second ends."""
        found = int(0)
        zero = kit.splat(real(0.0))
        for s in range(model.springs[mesh]):
            dx, dy, strained = correction(model, data, mesh, pack, s, lane, model.strain_limit, model.strain_share)
            if strained == 0:
                dx, dy = zero, zero
            found = found | strained
            kit.store(data.tension, pack, 2 * s, lane, dx)
            kit.store(data.tension, pack, 2 * s + 1, lane, dy)
        if found != 0:
            for s in range(model.springs[mesh]):
                dx, dy = kit.load(data.tension, pack, 2 * s, lane), kit.load(data.tension, pack, 2 * s + 1, lane)
                move(model, data, mesh, pack, model.spring_ends[mesh, s][0], lane, -dx, -dy)
            for s in range(model.springs[mesh]):
                dx, dy = kit.load(data.tension, pack, 2 * s, lane), kit.load(data.tension, pack, 2 * s + 1, lane)
                move(model, data, mesh, pack, model.spring_ends[mesh, s][1], lane, dx, dy)

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        all_springs(model, data, mesh, pack, lane)
        bound, share = model.rigid_strain_limit, model.rigid_strain_share
        for n in range(model.rigids[mesh]):
            s = model.rigid_spring[mesh, n]
            dx, dy, strained = correction(model, data, mesh, pack, s, lane, bound, share)
            if strained != 0:
                move(model, data, mesh, pack, model.spring_ends[mesh, s][0], lane, -dx, -dy)
                move(model, data, mesh, pack, model.spring_ends[mesh, s][1], lane, dx, dy)

    return stage


@builder
def advance(kit: Kit):
    """Stage: positions move; true velocity and drift follow."""

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        path = kit.splat(real(0.0))
        for n in range(2 * model.actives[mesh]):
            r = model.active[mesh, n]
            place = kit.load(data.disp, pack, r, lane)
            move = place - kit.load(data.pos, pack, r, lane)
            kit.store(data.pos, pack, r, lane, place)
            kit.store(data.true_vel, pack, r, lane, kit.div(move, kit.splat(dt)))
            path = kit.grow(path, move)
        data.drift[unit] = data.drift[unit] + kit.largest(path)

    return stage


STAGES = (creep, runge_kutta, limit, advance)
