"""Contact and friction forces between surface voxels and with terrain (paper section A.3).

For a corner of one voxel inside another: the surface side of the other that one of the corner's own two edges
crosses and that is nearest gives normal and depth; the corner is pushed out, the side's ends take the reaction.
Vector code finds the few lanes where a corner is in a box; the rest is scalar work for those lanes.
"""

import functools

import warp as wp

from warpvox.kernels.broadphase import DISTANT, lattice_range
from warpvox.kernels.lanes import REALS, inline, lane_ops, native
from warpvox.kernels.state import structs

PARALLEL = 1.0e-4  # |det| of two edges below which they do not cross
DEGENERATE = 1.0e-6  # a side shorter than this is never the nearest


real = wp.float64
quad = wp.types.vector(length=8, dtype=real)


# A quad of the points c. Constant places: with a loop over them it would go through memory, twice.
FRAME = """
    const double* at = &wp::index(data.pos, pack, 0, lane);
    const size_t gap = data.pos.strides[1] / sizeof(double);
    wp::vec_t<8, double> q;
    q[0] = at[2 * c[0] * gap];
    q[1] = at[(2 * c[0] + 1) * gap];
    q[2] = at[2 * c[1] * gap];
    q[3] = at[(2 * c[1] + 1) * gap];
    q[4] = at[2 * c[2] * gap];
    q[5] = at[(2 * c[2] + 1) * gap];
    q[6] = at[2 * c[3] * gap];
    q[7] = at[(2 * c[3] + 1) * gap];
    return q;
"""

# The lanes in which point p is in one of the triangles TL-TR-BR and TL-BR-BL of the voxel with points r.
INSIDE = """
    const auto pos = wides(data.pos);
    const Wide x = pos[2 * p], y = pos[2 * p + 1];
    const Wide x0 = pos[2 * r[0]] - x, y0 = pos[2 * r[0] + 1] - y;
    const Wide x1 = pos[2 * r[1]] - x, y1 = pos[2 * r[1] + 1] - y;
    const Wide x2 = pos[2 * r[2]] - x, y2 = pos[2 * r[2] + 1] - y;
    const Wide x3 = pos[2 * r[3]] - x, y3 = pos[2 * r[3] + 1] - y;
    const Wide c = x2 * y0 - y2 * x0, a = x0 * y1 - y0 * x1, b = x1 * y2 - y1 * x2;
    const Wide d = x0 * y3 - y0 * x3, e = x3 * y2 - y3 * x2;
    return bits_of(((c * a >= 0.0) & (c * b >= 0.0)) | ((c * d >= 0.0) & (c * e >= 0.0)));
"""


@wp.func
def cross(ax: real, ay: real, bx: real, by: real):
    """Cross product of two vectors."""
    return ax * by - ay * bx


@wp.func
def inside(x: real, y: real, r: quad):
    """In one of the triangles TL-TR-BR and TL-BR-BL, boundary included."""
    c = cross(r[4] - x, r[5] - y, r[0] - x, r[1] - y)
    a = cross(r[0] - x, r[1] - y, r[2] - x, r[3] - y)
    b = cross(r[2] - x, r[3] - y, r[4] - x, r[5] - y)
    d = cross(r[0] - x, r[1] - y, r[6] - x, r[7] - y)
    e = cross(r[6] - x, r[7] - y, r[4] - x, r[5] - y)
    zero = real(0.0)
    return (c * a >= zero and c * b >= zero) or (c * d >= zero and c * e >= zero)


@wp.func
def crosses(ax: real, ay: real, bx: real, by: real, cx: real, cy: real, dx: real, dy: real):
    """Whether the segments a-b and c-d cross, ends included."""
    ux, uy, vx, vy = bx - ax, by - ay, dx - cx, dy - cy
    det = -ux * vy + vx * uy
    if wp.abs(det) < real(PARALLEL):
        return False
    wx, wy = cx - ax, cy - ay
    t = (-vy * wx + vx * wy) / det
    if t < real(0.0) or t > real(1.0):
        return False
    s = (-uy * wx + ux * wy) / det
    return real(0.0) <= s and s <= real(1.0)


@wp.func
def edge_crosses(m: quad, sides: int, e: int, cx: real, cy: real, dx: real, dy: real):
    """The same for edge e of a quad; inner bottom and left edges run against the clock, as they were made."""
    a, b = int(e), (e + 1) % 4
    if e >= 2 and ((sides >> e) & 1) == 0:
        a, b = (e + 1) % 4, int(e)
    return crosses(m[2 * a], m[2 * a + 1], m[2 * b], m[2 * b + 1], cx, cy, dx, dy)


@wp.func
def depth_under(x: real, y: real, ax: real, ay: real, bx: real, by: real):
    """Distance of a point from the line through a and b."""
    ux, uy = bx - ax, by - ay
    length = wp.sqrt(ux * ux + uy * uy)
    if length < real(DEGENERATE):
        return real(1000.0)
    return wp.abs(ux * (y - ay) - (x - ax) * uy) / length


@wp.func
def nearest_side(m: quad, m_sides: int, c: int, r: quad, r_sides: int):
    """The nearest crossed side of quad r under corner c of quad m, and its depth; side -1: no contact.

    A quad holds x, y of top left, top right, bottom right, bottom left. Comparisons and their order of evaluation
    follow the released simulator: at time 0 they decide ties in the last bit.
    """
    best = int(-1)
    depth = real(0.0)
    x, y = m[2 * c], m[2 * c + 1]
    if inside(x, y, r):
        four = int(4)
        for e in range(four):
            if ((r_sides >> e) & 1) == 1:
                f = (e + 1) % 4
                ax, ay, bx, by = r[2 * e], r[2 * e + 1], r[2 * f], r[2 * f + 1]
                if edge_crosses(m, m_sides, c, ax, ay, bx, by) or edge_crosses(m, m_sides, (c + 3) % 4, ax, ay, bx, by):
                    d = depth_under(x, y, ax, ay, bx, by)
                    if best < 0 or d < depth:
                        best = int(e)
                        depth = d
    return best, depth


@functools.cache
def resolve(precision: str):
    """Function: contact of corner c of quad m with quad r, if any; points of -1 stand still and feel nothing."""
    types, force = structs(precision), REALS[precision]

    @wp.func
    def push(out: wp.array3d(dtype=force), pack: int, k: int, p: int, fx: real, fy: real):
        if p >= 0:
            out[pack, 2 * p, k] = out[pack, 2 * p, k] + force(fx)
            out[pack, 2 * p + 1, k] = out[pack, 2 * p + 1, k] + force(fy)

    @wp.func
    def speed(true_vel: wp.array3d(dtype=real), pack: int, k: int, p: int, nx: real, ny: real):
        """True velocity of a point along a direction."""
        if p < 0:
            return real(0.0)
        return nx * true_vel[pack, 2 * p, k] + ny * true_vel[pack, 2 * p + 1, k]

    @wp.func
    def contact(
        law: types.Contact, true_vel: wp.array3d(dtype=real), out: wp.array3d(dtype=force), pack: int, k: int,
        m: quad, m_sides: int, p: int, c: int, r: quad, r_sides: int, r_points: wp.vec4i, times: real,
    ):  # fmt: skip
        side, depth = nearest_side(m, m_sides, c, r, r_sides)
        if side < 0:
            return
        f = (side + 1) % 4
        ux, uy = r[2 * f] - r[2 * side], r[2 * f + 1] - r[2 * side + 1]
        length = wp.sqrt(ux * ux + uy * uy)
        nx, ny = -uy / length, ux / length
        normal = law.stiffness * (law.depth + depth)
        half = real(0.5)
        a, b = r_points[side], r_points[f]
        # Friction along t = (-ny, nx): viscous at small slip, at most friction_multiplier * friction * normal.
        slip = speed(true_vel, pack, k, p, -ny, nx)
        grip = law.friction * normal
        drag = real(0.0)
        if slip != real(0.0):
            drag = -law.friction_multiplier * grip * wp.tanh(slip / grip)
        fx, fy = times * (nx * normal - ny * drag), times * (ny * normal + nx * drag)
        damp = times * law.damping
        dp = damp * speed(true_vel, pack, k, p, nx, ny)
        da = damp * speed(true_vel, pack, k, a, nx, ny)
        db = damp * speed(true_vel, pack, k, b, nx, ny)
        push(out, pack, k, p, fx - nx * dp, fy - ny * dp)
        push(out, pack, k, a, -(fx + nx * da) * half, -(fy + ny * da) * half)
        push(out, pack, k, b, -(fx + nx * db) * half, -(fy + ny * db) * half)

    return contact


@functools.cache
def apply(precision: str):
    """Function: add the forces of corner c (point p) of quad m of voxel i perhaps being in quad r of voxel j.

    A voxel below 0 stands for cell -1 - i of the terrain.
    """
    types, contact = structs(precision), resolve(precision)

    @inline
    def meet(
        model: types.Model, data: types.Data, design: int, pack: int, k: int, unit: int, i: int, m: quad, m_sides: int,
        p: int, c: int, j: int, r: quad, r_sides: int, r_points: wp.vec4i, times: real,
    ):  # fmt: skip
        contact(model.contact, data.true_vel, data.contact, pack, k, m, m_sides, p, c, r, r_sides, r_points, times)

    return meet


@functools.cache
def voxel_frame(precision: str):
    """Function: a voxel as a quad."""
    types = structs(precision)

    @wp.func_native(FRAME)
    def frame(data: types.Data, pack: int, lane: int, c: wp.vec4i) -> quad: ...

    return frame


@functools.cache
def lanes_inside(precision: str, width: int):
    """Function: the lanes in which a point is in a voxel, as :func:`inside` has it for one."""
    types = structs(precision)

    @wp.func_native(native("float64", width) + INSIDE)
    def inside(data: types.Data, pack: int, lane: int, p: int, r: wp.vec4i) -> int: ...

    return inside


@functools.cache
def voxel_contacts(precision: str, width: int, meeting):
    """Stage: contacts of the candidate pairs."""
    ops, types = lane_ops("float64", width), structs(precision)
    load, at_most, first, drop = ops.load, ops.at_most, ops.first, ops.drop
    meet, frame, inside = meeting(precision), voxel_frame(precision), lanes_inside(precision, width)

    @inline
    def corner_hits(data: types.Data, pack: int, lane: int, p: int, r: int):
        """Lanes in which point p is in the box of voxel r."""
        x, y = load(data.pos, pack, 2 * p, lane), load(data.pos, pack, 2 * p + 1, lane)
        lanes = at_most(load(data.box, pack, 4 * r, lane), x) & at_most(x, load(data.box, pack, 4 * r + 1, lane))
        if lanes == 0:
            return 0
        lanes = lanes & at_most(load(data.box, pack, 4 * r + 2, lane), y)
        return lanes & at_most(y, load(data.box, pack, 4 * r + 3, lane))

    @inline
    def touch(
        model: types.Model, data: types.Data, design: int, pack: int, k: int, unit: int,
        i: int, j: int, c: int, times: real,
    ):  # fmt: skip
        mc, rc = model.corner[design, i], model.corner[design, j]
        m, r = frame(data, pack, k, mc), frame(data, pack, k, rc)
        meet(
            model, data, design, pack, k, unit, i, m, model.side[design, i],
            model.pushed[design, i][c], c, j, r, model.side[design, j], model.pushed[design, j], times,
        )  # fmt: skip

    @inline
    def one_way(
        model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int,
        i: int, j: int, corners: int, times: real, active: int,
    ):  # fmt: skip
        """Corners of voxel i in voxel j."""
        four = int(4)
        for c in range(four):
            if ((corners >> c) & 1) == 1:
                p = model.corner[design, i][c]
                lanes = active & corner_hits(data, pack, lane, p, j)
                if lanes != 0:
                    lanes = lanes & inside(data, pack, lane, p, model.corner[design, j])
                while lanes != 0:
                    touch(model, data, design, pack, lane + first(lanes), unit, i, j, c, times)
                    lanes = drop(lanes)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, active: int):
        for n in range(data.pair_count[unit]):
            pair = data.pairs[unit, n]
            i, j = pair[0], pair[1]
            # Inside one object each pair is met twice.
            times = wp.where(model.body[design, i] == model.body[design, j], real(2.0), real(1.0))
            corners = pair[2] & (DISTANT - 1)
            ways = int(2)
            for way in range(ways):
                one_way(model, data, design, pack, lane, unit, i, j, corners, times, active)
                i, j, corners = pair[1], pair[0], pair[3]

    return stage


@functools.cache
def terrain_contacts(precision: str, width: int, meeting):
    """Stage: contacts of the near voxels with the cells of the terrain lattice."""
    ops, types = lane_ops("float64", width), structs(precision)
    load, at_most, first, drop = ops.load, ops.at_most, ops.first, ops.drop
    meet, frame, span = meeting(precision), voxel_frame(precision), lattice_range(precision)

    @inline
    def cell_quad(model: types.Model, design: int, cell: int):
        x0, x1 = model.terrain_box[design, cell, 0], model.terrain_box[design, cell, 1]
        y0, y1 = model.terrain_box[design, cell, 2], model.terrain_box[design, cell, 3]
        return quad(x0, y1, x1, y1, x1, y0, x0, y0)

    @wp.func
    def holds(x0: real, x1: real, y0: real, y1: real, x: real, y: real):
        return x0 <= x and x <= x1 and y0 <= y and y <= y1

    @inline
    def with_cell(
        model: types.Model, data: types.Data, design: int, pack: int, k: int, unit: int,
        v: int, m: quad, mc: wp.vec4i, cell: int, r: quad,
    ):  # fmt: skip
        """Corners of the voxel in the cell and of the cell in the voxel; each behind a test of boxes."""
        none = wp.vec4i(-1, -1, -1, -1)
        x0, x1 = (
            wp.min(wp.min(m[0], m[2]), wp.min(m[4], m[6])),
            wp.max(wp.max(m[0], m[2]), wp.max(m[4], m[6])),
        )
        y0, y1 = (
            wp.min(wp.min(m[1], m[3]), wp.min(m[5], m[7])),
            wp.max(wp.max(m[1], m[3]), wp.max(m[5], m[7])),
        )
        if x1 < r[0] or r[2] < x0 or y1 < r[5] or r[1] < y0:
            return
        m_sides, r_sides, one = model.side[design, v], model.terrain_side[design, cell], real(1.0)
        four = int(4)
        for c in range(four):
            if holds(r[0], r[2], r[5], r[1], m[2 * c], m[2 * c + 1]):
                meet(model, data, design, pack, k, unit, v, m, m_sides, mc[c], c, -1 - cell, r, r_sides, none, one)
        for c in range(four):
            if holds(x0, x1, y0, y1, r[2 * c], r[2 * c + 1]):
                meet(model, data, design, pack, k, unit, -1 - cell, r, r_sides, -1, c, v, m, m_sides, mc, one)

    @inline
    def with_terrain(model: types.Model, data: types.Data, design: int, pack: int, k: int, unit: int, v: int):
        cx0, cx1, cy0, cy1 = span(model, data, design, pack, k, v, real(0.0))
        loaded = int(0)
        mc = model.corner[design, v]
        m = quad()
        for cy in range(cy0, cy1 + 1):
            for cx in range(cx0, cx1 + 1):
                cell = cy * model.terrain[design][0] + cx
                if model.terrain_side[design, cell] != 0:
                    if loaded == 0:
                        m = frame(data, pack, k, mc)
                        loaded = 1
                    with_cell(model, data, design, pack, k, unit, v, m, mc, cell, cell_quad(model, design, cell))

    @inline
    def in_reach(data: types.Data, pack: int, lane: int, v: int):
        """Lanes in which a voxel's box overlaps the bounds of the cells near it."""
        x, y = 4 * v, 4 * v + 2
        lanes = at_most(load(data.box, pack, y, lane), load(data.near_box, pack, y + 1, lane))
        if lanes != 0:
            lanes = lanes & at_most(load(data.near_box, pack, y, lane), load(data.box, pack, y + 1, lane))
            lanes = lanes & at_most(load(data.box, pack, x, lane), load(data.near_box, pack, x + 1, lane))
            lanes = lanes & at_most(load(data.near_box, pack, x, lane), load(data.box, pack, x + 1, lane))
        return lanes

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, active: int):
        for n in range(data.near_count[unit]):
            v = data.near[unit, n]
            lanes = active & in_reach(data, pack, lane, v)
            while lanes != 0:
                with_terrain(model, data, design, pack, lane + first(lanes), unit, v)
                lanes = drop(lanes)

    return stage


@functools.cache
def find(precision: str, width: int, meeting):
    """Stage: set ``contact`` to 0 and look for contacts; ``meeting`` says what is done with one."""
    ops, types = lane_ops(precision, width), structs(precision)
    zero, store, splat = ops.real, ops.store, ops.splat
    with_voxels, with_terrain = voxel_contacts(precision, width, meeting), terrain_contacts(precision, width, meeting)

    @inline
    def active_lanes(data: types.Data, pack: int, lane: int):
        mask = int(0)
        for k in range(int(width)):
            if data.frozen[pack, lane + k] == 0:
                mask = mask | (1 << k)
        return mask

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            store(data.contact, pack, r, lane, splat(zero(0.0)))
        active = active_lanes(data, pack, lane)
        with_voxels(model, data, design, pack, lane, unit, active)
        with_terrain(model, data, design, pack, lane, unit, active)

    return stage


def contacts(precision: str, width: int):
    """Stage: all contact forces, added as contacts are found."""
    return find(precision, width, apply)
