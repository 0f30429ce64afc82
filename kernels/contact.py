"""Contact and friction forces between surface voxels and with terrain (paper section A.3).

For a corner of one voxel inside another: the surface side of the other that one of the corner's own two edges
crosses and that is nearest gives normal and depth; the corner is pushed out, the side's ends take the reaction.
Vector code finds the few lanes where a corner is in a voxel; the rest is scalar work for those lanes.
"""

import functools

import warp as wp

from warpvox.kernels.broadphase import boxes_meet, lattice_range
from warpvox.kernels.kit import Kit, builder
from warpvox.kernels.lanes import first_lane, text, without_first

PARALLEL = 1.0e-4  # |det| of two edges below which they do not cross
DEGENERATE = 1.0e-6  # a side shorter than this is never the nearest

real = wp.float64
quad = wp.types.vector(length=8, dtype=real)  # x, y of top left, top right, bottom right, bottom left
points3 = wp.array3d(dtype=real)


# ------------------------------------------------------------------------------- geometry of a corner in a quad
# Comparisons and their order of evaluation follow the released simulator: at time 0 they decide ties in the last bit.


@wp.func_native(text("native/triangles.h", "native/inside_quad.h"))
def inside_quad(x: real, y: real, r: quad) -> bool:
    """Whether a point is in a quad, boundary included."""
    ...


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
    """Of the surface sides of quad r that an edge at corner c of quad m crosses the nearest, or -1; depth."""
    best = int(-1)
    depth = real(0.0)
    four = int(4)
    for e in range(four):
        if ((r_sides >> e) & 1) == 1:
            f = (e + 1) % 4
            ax, ay, bx, by = r[2 * e], r[2 * e + 1], r[2 * f], r[2 * f + 1]
            if edge_crosses(m, m_sides, c, ax, ay, bx, by) or edge_crosses(m, m_sides, (c + 3) % 4, ax, ay, bx, by):
                d = depth_under(m[2 * c], m[2 * c + 1], ax, ay, bx, by)
                if best < 0 or d < depth:
                    best = int(e)
                    depth = d
    return best, depth


# ------------------------------------------------------------------------------------------------ contact law


@wp.func
def speed(velocity: points3, pack: int, k: int, p: int, x: real, y: real):
    """Velocity of a point along a direction; points of -1 stand still."""
    if p < 0:
        return real(0.0)
    return x * velocity[pack, 2 * p, k] + y * velocity[pack, 2 * p + 1, k]


@builder
def contact_forces(kit: Kit):
    """Function: add ``times`` the forces of one contact on the corner p and on the ends a, b of the side.

    ``normal`` holds the unit normal and the depth. Sums and products are in the order of the released simulator.
    """
    force = kit.real

    @wp.func
    def push(out: wp.array3d(dtype=force), pack: int, k: int, p: int, fx: real, fy: real):
        if p >= 0:
            out[pack, 2 * p, k] = out[pack, 2 * p, k] + force(fx)
            out[pack, 2 * p + 1, k] = out[pack, 2 * p + 1, k] + force(fy)

    @wp.func
    def forces(
        law: kit.Contact, velocity: points3, out: wp.array3d(dtype=force), pack: int, k: int, p: int, a: int, b: int,
        normal: wp.vec3d, times: real,
    ):  # fmt: skip
        nx, ny = normal[0], normal[1]
        fx, fy = nx * law.stiffness * (law.depth + normal[2]), ny * law.stiffness * (law.depth + normal[2])
        # The released simulator normalises the unit normal once more before damping and friction.
        length = wp.sqrt(nx * nx + ny * ny)
        ux, uy = nx / length, ny / length
        vp = speed(velocity, pack, k, p, ux, uy)
        va = speed(velocity, pack, k, a, ux, uy)
        vb = speed(velocity, pack, k, b, ux, uy)
        half, c = times * real(0.5), law.damping
        push(out, pack, k, p, times * (fx - ux * vp * c), times * (fy - uy * vp * c))
        push(out, pack, k, a, -(fx * half + ux * va * c * half), -(fy * half + uy * va * c * half))
        push(out, pack, k, b, -(fx * half + ux * vb * c * half), -(fy * half + uy * vb * c * half))
        # Friction: viscous at small slip, at most friction_multiplier * friction * normal force.
        tx, ty = -uy, ux
        slip = speed(velocity, pack, k, p, tx, ty)
        if slip < real(0.0):
            slip, tx, ty = -slip, -tx, -ty
        size = wp.sqrt(fx * fx + fy * fy)
        rub = real(0.0)
        if slip != real(0.0):  # without friction or stiffness the quotient would be 0/0
            rub = wp.tanh(slip / (law.friction * size))
        sx = -(law.friction_multiplier * tx) * law.friction * size * rub
        sy = -(law.friction_multiplier * ty) * law.friction * size * rub
        push(out, pack, k, p, times * sx, times * sy)
        push(out, pack, k, a, -sx * half, -sy * half)
        push(out, pack, k, b, -sx * half, -sy * half)

    return forces


@builder
def apply(kit: Kit):
    """Function: add the forces of a contact of corner c (point p) of voxel i with the side between ``ends`` of voxel j.

    A voxel below 0 stands for cell -1 - i of the terrain. What is done with a contact is an argument of :func:`find`.
    """
    forces = contact_forces(kit)

    @kit.func
    def act(
        model, data, mesh, pack, k, i, j, c, p, ends: wp.vec2i, normal: wp.vec3d, times: real
    ):  # fmt: skip
        forces(model.contact, data.true_vel, data.contact, pack, k, p, ends[0], ends[1], normal, times)

    return act


# ------------------------------------------------------------------------- one lane's view of the tables of a pack
# These take arrays, not the Model: called from several places they may not be inlined, and structs go by value.

masks, pairs = wp.array2d(dtype=int), wp.array2d(dtype=wp.vec2i)


@wp.func
def surface_sides(side_lanes: wp.array2d(dtype=wp.vec4i), mesh: int, v: int, k: int):
    """Bits of the surface sides of a voxel in lane k."""
    lanes = side_lanes[mesh, v]
    low = ((lanes[0] >> k) & 1) | (((lanes[1] >> k) & 1) << 1)
    return low | (((lanes[2] >> k) & 1) << 2) | (((lanes[3] >> k) & 1) << 3)


@wp.func
def leader(twin_range: pairs, twin: pairs, twin_lanes: masks, mesh: int, p: int, k: int):
    """The point that stands for point p (-1: none) in lane k."""
    found = int(p)
    if p >= 0:
        twins = twin_range[mesh, p]
        for e in range(twins[0], twins[1]):
            if twin[mesh, e][0] == p and ((twin_lanes[mesh, e] >> k) & 1) == 1:
                found = twin[mesh, e][1]
    return found


# -------------------------------------------------------------------------------------------------- narrow phase


@functools.cache
def corner_contact(kit: Kit, act):
    """Function: do what ``act`` does with the contact of corner c of quad m, which is in quad r, if it is one."""

    @kit.func
    def meet(
        model, data, mesh, pack, k, i, m: quad, m_sides, p, c, j, r: quad, r_sides, r_points: wp.vec4i, times: real,
    ):  # fmt: skip
        side, depth = nearest_side(m, m_sides, c, r, r_sides)
        if side >= 0:
            f = (side + 1) % 4
            ux, uy = r[2 * f] - r[2 * side], r[2 * f + 1] - r[2 * side + 1]
            length = wp.sqrt(ux * ux + uy * uy)
            ends, normal = wp.vec2i(r_points[side], r_points[f]), wp.vec3d(-uy / length, ux / length, depth)
            point = int(p)
            if model.twins[mesh] > 0:
                point = leader(model.twin_range, model.twin, model.twin_lanes, mesh, p, k)
                ends = wp.vec2i(
                    leader(model.twin_range, model.twin, model.twin_lanes, mesh, ends[0], k),
                    leader(model.twin_range, model.twin, model.twin_lanes, mesh, ends[1], k),
                )
            act(model, data, mesh, pack, k, i, j, c, point, ends, normal, times)

    return meet


@builder
def voxel_quad(kit: Kit):
    """Function: a voxel of one lane as a quad."""

    @wp.func_native(text("native/quad.h"))
    def of(places: points3, pack: int, k: int, c: wp.vec4i) -> quad: ...

    return of


@functools.cache
def voxel_contacts(kit: Kit, act):
    """Function: contacts of the candidate pairs."""

    meet, quad_of = corner_contact(kit, act), voxel_quad(kit)

    @kit.func_native("native/triangles.h", "native/next_touch.h", precision="float64")
    def next_touch(
        pairs: wp.array2d(dtype=wp.vec4i), corners: wp.array2d(dtype=wp.vec4i), side_lanes: wp.array2d(dtype=wp.vec4i),
        twin_range: wp.array2d(dtype=wp.vec2i), twin: wp.array2d(dtype=wp.vec2i), twin_lanes: wp.array2d(dtype=int),
        places: points3, boxes: points3, touching: wp.array(dtype=int), mesh, pack, lane, unit, count, active, begin,
    ) -> int:  # fmt: skip
        """The next corner of a candidate that is in the other voxel in some lane; these go into ``touching``."""
        ...

    @kit.func
    def touch_from(model, data, mesh, pack, lane, unit, active, begin):
        return next_touch(
            data.pairs, model.corner, model.side_lanes, model.twin_range, model.twin, model.twin_lanes, data.pos,
            data.box, data.touching, mesh, pack, lane, unit, data.pair_count[unit], active, begin,
        )  # fmt: skip

    @kit.func
    def touch(model, data, mesh, pack, k, i, j, c, times: real):
        """One lane in which corner c of voxel i is in voxel j."""
        m, r = quad_of(data.pos, pack, k, model.corner[mesh, i]), quad_of(data.pos, pack, k, model.corner[mesh, j])
        p, ends = int(model.pushed[mesh, i][c]), model.pushed[mesh, j]
        r_points = wp.vec4i(ends[0], ends[1], ends[2], ends[3])
        m_sides = surface_sides(model.side_lanes, mesh, i, k)
        r_sides = surface_sides(model.side_lanes, mesh, j, k)
        meet(model, data, mesh, pack, k, i, m, m_sides, p, c, j, r, r_sides, r_points, times)

    @kit.func
    def all_pairs(model, data, mesh, pack, lane, unit, active):
        at = touch_from(model, data, mesh, pack, lane, unit, active, 0)
        while at < 8 * data.pair_count[unit]:
            pair = data.pairs[unit, at >> 3]
            way = (at >> 2) & 1
            i, j = pair[way], pair[1 - way]
            # Inside one object each pair is met twice.
            times = wp.where(model.body[mesh, i] == model.body[mesh, j], real(2.0), real(1.0))
            lanes = data.touching[unit]
            while lanes != 0:
                touch(model, data, mesh, pack, lane + first_lane(lanes), i, j, at & 3, times)
                lanes = without_first(lanes)
            at = touch_from(model, data, mesh, pack, lane, unit, active, at + 1)

    return all_pairs


@wp.func
def holds(x0: real, x1: real, y0: real, y1: real, x: real, y: real):
    """Whether a point is in a box."""
    return x0 <= x and x <= x1 and y0 <= y and y <= y1


@functools.cache
def terrain_contacts(kit: Kit, act):
    """Function: contacts of the near voxels with the cells of the terrain lattice."""
    meet, quad_of, span = corner_contact(kit, act), voxel_quad(kit), lattice_range(kit)
    overlap = boxes_meet(kit)

    @kit.func
    def cell_quad(model, frame, cell):
        """A cell of the terrain as a quad."""
        x0, x1 = model.terrain_box[frame, cell, 0], model.terrain_box[frame, cell, 1]
        y0, y1 = model.terrain_box[frame, cell, 2], model.terrain_box[frame, cell, 3]
        return quad(x0, y1, x1, y1, x1, y0, x0, y0)

    @kit.func
    def with_cell(model, data, mesh, pack, k, v, m: quad, mc: wp.vec4i, cell, r: quad):
        """Corners of the voxel in the cell and of the cell in the voxel; each behind a test of boxes."""
        none = wp.vec4i(-1, -1, -1, -1)
        x0, x1 = wp.min(wp.min(m[0], m[2]), wp.min(m[4], m[6])), wp.max(wp.max(m[0], m[2]), wp.max(m[4], m[6]))
        y0, y1 = wp.min(wp.min(m[1], m[3]), wp.min(m[5], m[7])), wp.max(wp.max(m[1], m[3]), wp.max(m[5], m[7]))
        if x1 < r[0] or r[2] < x0 or y1 < r[5] or r[1] < y0:
            return
        m_sides, r_sides, one = (
            surface_sides(model.side_lanes, mesh, v, k),
            model.terrain_side[model.frame[mesh], cell],
            real(1.0),
        )
        four = int(4)
        for c in range(four):
            x, y = m[2 * c], m[2 * c + 1]
            if holds(r[0], r[2], r[5], r[1], x, y) and inside_quad(x, y, r):
                meet(model, data, mesh, pack, k, v, m, m_sides, mc[c], c, -1 - cell, r, r_sides, none, one)
        for c in range(four):
            x, y = r[2 * c], r[2 * c + 1]
            if holds(x0, x1, y0, y1, x, y) and inside_quad(x, y, m):
                meet(model, data, mesh, pack, k, -1 - cell, r, r_sides, -1, c, v, m, m_sides, mc, one)

    @kit.func
    def with_terrain(model, data, mesh, pack, k, v):
        """Contacts of one voxel in one lane."""
        cx0, cx1, cy0, cy1 = span(model, data, mesh, pack, k, v, real(0.0))
        loaded, frame = int(0), model.frame[mesh]
        corners = model.corner[mesh, v]
        mc = wp.vec4i(corners[0], corners[1], corners[2], corners[3])
        m = quad()
        for cy in range(cy0, cy1 + 1):
            for cx in range(cx0, cx1 + 1):
                cell = cy * model.terrain[frame][0] + cx
                if model.terrain_side[frame, cell] != 0:
                    if loaded == 0:
                        m = quad_of(data.pos, pack, k, mc)
                        loaded = 1
                    with_cell(model, data, mesh, pack, k, v, m, mc, cell, cell_quad(model, frame, cell))

    @kit.func
    def all_near(model, data, mesh, pack, lane, unit, active):
        for n in range(data.near_count[unit]):
            v = data.near[unit, n]
            lanes = active & overlap(data.box, v, data.near_box, v, pack, lane)
            while lanes != 0:
                with_terrain(model, data, mesh, pack, lane + first_lane(lanes), v)
                lanes = without_first(lanes)

    return all_near


@functools.cache
def find(kit: Kit, act):
    """Stage: set ``contact`` to 0 and look for contacts; ``act`` is called with each."""
    width = kit.width
    with_voxels, with_terrain = voxel_contacts(kit, act), terrain_contacts(kit, act)
    clear = kit.stage("native/springs.h", "native/clear_contact.h")

    @kit.func
    def active_lanes(data, pack, lane):
        """The lanes that are not frozen."""
        mask = int(0)
        for k in range(int(width)):
            if data.frozen[pack, lane + k] == 0:
                mask = mask | (1 << k)
        return mask

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        clear(model, data, mesh, pack, lane, unit, dt)
        active = active_lanes(data, pack, lane)
        with_voxels(model, data, mesh, pack, lane, unit, active)
        with_terrain(model, data, mesh, pack, lane, unit, active)

    return stage


@builder
def contacts(kit: Kit):
    """Stage: all contact forces, added as contacts are found."""
    return find(kit, apply(kit))
