"""Contact and friction forces between surface voxels and with terrain (paper section A.3).

For a corner of one voxel inside another: the surface side of the other that one of the corner's own two edges
crosses and that is nearest gives normal and depth; the corner is pushed out, the side's ends take the reaction.
Vector code finds the few lanes where a corner is in a voxel; the rest is scalar work for those lanes.
"""

import functools

import warp as wp

from warpvox.kernels.broadphase import boxes_overlap, lattice_range
from warpvox.kernels.kit import Kit, builder
from warpvox.kernels.lanes import constants, first_lane, text, without_first

PARALLEL = 1.0e-4  # |det| of two edges below which they do not cross
DEGENERATE = 1.0e-6  # a side shorter than this is never the nearest

real = wp.float64
quad = wp.types.vector(length=8, dtype=real)  # x, y of top left, top right, bottom right, bottom left
points3 = wp.array3d(dtype=real)
masks, pairs = wp.array2d(dtype=int), wp.array2d(dtype=wp.vec2i)


@wp.func_native(text("native/triangles.h", "native/inside_quad.h"))
def inside_quad(x: real, y: real, r: quad) -> bool:
    """Return whether point (x, y) is in quad r, boundary included."""
    ...


@wp.func_native(
    constants(PARALLEL=PARALLEL, DEGENERATE=DEGENERATE) + text("native/crossing.h", "native/nearest_side.h")
)
def nearest_side(m: quad, m_sides: int, c: int, r: quad, r_sides: int) -> wp.vec4d:
    """Return the surface side of quad r that corner c of quad m crossed: number, vector, depth.

    The number is -1 if there is none.
    """
    ...


@builder
def contact_forces(kit: Kit):
    """Build a function that adds one contact's forces, scaled by ``times``, to corner p and side ends a and b.

    ``side`` holds its vector and the depth of the corner under it.
    """

    @kit.func_native("native/tanh.h", "native/pairs.h", "native/contact_law.h", "native/add_contact.h")
    def forces(
        law: kit.Contact, velocity: points3, out: wp.array3d(dtype=kit.real), in_contact: masks, pack, lane, p, a, b,
        side: wp.vec3d, times: real,
    ): ...  # fmt: skip

    return forces


@builder
def apply(kit: Kit):
    """Build a function that adds the forces of a contact between a corner of one voxel and a side of another.

    A voxel below 0 stands for cell -1 - i of the terrain. What is done with a contact is an argument of :func:`find`.
    """
    forces = contact_forces(kit)

    @kit.func
    def act(model, data, mesh, pack, k, i, j, c, p, ends: wp.vec2i, side: wp.vec3d, times: real):
        forces(model.contact, data.true_vel, data.contact, data.in_contact, pack, k, p, ends[0], ends[1], side, times)

    return act


# ------------------------------------------------------------------------- one lane's view of the tables of a pack
# These take arrays, not the Model: called from several places they may not be inlined, and structs go by value.


@wp.func
def surface_sides(side_lanes: wp.array2d(dtype=wp.vec4i), mesh: int, v: int, k: int):
    """Return the surface sides of voxel v in lane k as bits."""
    lanes = side_lanes[mesh, v]
    low = ((lanes[0] >> k) & 1) | (((lanes[1] >> k) & 1) << 1)
    return low | (((lanes[2] >> k) & 1) << 2) | (((lanes[3] >> k) & 1) << 3)


@wp.func
def leader(twin_range: pairs, twin: pairs, twin_lanes: masks, mesh: int, p: int, k: int):
    """Return the leader of point p in lane k: where points coincide, one of them holds the state; -1 for p = -1."""
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
    """Build a function that finds the side of a voxel that a corner of another voxel crossed, and calls ``act``."""

    @kit.func
    def contact(
        model, data, mesh, pack, k, i, m: quad, m_sides, p, c, j, r: quad, r_sides, r_points: wp.vec4i, times: real,
    ):  # fmt: skip
        """Find the side of quad r that corner c of quad m crossed, and pass it to ``act``."""
        found = nearest_side(m, m_sides, c, r, r_sides)
        first = int(found[0])
        if first >= 0:
            point, ends = int(p), wp.vec2i(r_points[first], r_points[(first + 1) % 4])
            if model.twins[mesh] > 0:
                point = leader(model.twin_range, model.twin, model.twin_lanes, mesh, p, k)
                ends = wp.vec2i(
                    leader(model.twin_range, model.twin, model.twin_lanes, mesh, ends[0], k),
                    leader(model.twin_range, model.twin, model.twin_lanes, mesh, ends[1], k),
                )
            act(model, data, mesh, pack, k, i, j, c, point, ends, wp.vec3d(found[1], found[2], found[3]), times)

    return contact


@wp.func_native(text("native/quad.h"))
def quad_of(places: points3, pack: int, k: int, c: wp.vec4i) -> quad:
    """Return the corners ``c`` of a voxel in lane k as a quad."""
    ...


@functools.cache
def voxel_contacts(kit: Kit, act):
    """Build a function that finds all contacts between two voxels and passes each to the function ``act``."""

    contact = corner_contact(kit, act)

    @kit.func_native("native/triangles.h", "native/next_corner.h", precision="float64")
    def next_corner(
        pairs: wp.array2d(dtype=wp.vec4i), corners: wp.array2d(dtype=wp.vec4i), side_lanes: wp.array2d(dtype=wp.vec4i),
        twin_range: wp.array2d(dtype=wp.vec2i), twin: wp.array2d(dtype=wp.vec2i), twin_lanes: wp.array2d(dtype=int),
        places: points3, boxes: points3, touching: wp.array(dtype=int), mesh, pack, lane, unit, count, active, begin,
    ) -> int:  # fmt: skip
        """Return the next corner, from ``begin`` on, that lies in the other voxel of its pair in some lane.

        The mask of these lanes is written to ``touching``.
        """
        ...

    @kit.func
    def corner_from(model, data, mesh, pack, lane, unit, active, begin):
        return next_corner(
            data.pairs, model.corner, model.side_lanes, model.twin_range, model.twin, model.twin_lanes, data.pos,
            data.box, data.touching, mesh, pack, lane, unit, data.pair_count[unit], active, begin,
        )  # fmt: skip

    @kit.func
    def corner_in_voxel(model, data, mesh, pack, k, i, j, c, times: real):
        """Handle the contact of corner c of voxel i with voxel j in lane k."""
        m, r = quad_of(data.pos, pack, k, model.corner[mesh, i]), quad_of(data.pos, pack, k, model.corner[mesh, j])
        p, ends = int(model.pushed[mesh, i][c]), model.pushed[mesh, j]
        r_points = wp.vec4i(ends[0], ends[1], ends[2], ends[3])
        m_sides = surface_sides(model.side_lanes, mesh, i, k)
        r_sides = surface_sides(model.side_lanes, mesh, j, k)
        contact(model, data, mesh, pack, k, i, m, m_sides, p, c, j, r, r_sides, r_points, times)

    @kit.func
    def all_pairs(model, data, mesh, pack, lane, unit, active):
        """Handle every corner that lies in the other voxel of its pair, lane by lane."""
        at = corner_from(model, data, mesh, pack, lane, unit, active, 0)
        while at < 8 * data.pair_count[unit]:
            pair = data.pairs[unit, at >> 3]
            way = (at >> 2) & 1
            i, j = pair[way], pair[1 - way]
            # Inside one object each pair is met twice.
            times = wp.where(model.body[mesh, i] == model.body[mesh, j], real(2.0), real(1.0))
            lanes = data.touching[unit]
            while lanes != 0:
                corner_in_voxel(model, data, mesh, pack, lane + first_lane(lanes), i, j, at & 3, times)
                lanes = without_first(lanes)
            at = corner_from(model, data, mesh, pack, lane, unit, active, at + 1)

    return all_pairs


@wp.func
def in_box(x0: real, x1: real, y0: real, y1: real, x: real, y: real):
    """Return whether point (x, y) is in a box, boundary included."""
    return x0 <= x and x <= x1 and y0 <= y and y <= y1


@functools.cache
def terrain_contacts(kit: Kit, act):
    """Build a function that finds all contacts between voxels and terrain and passes each to ``act``."""
    contact = corner_contact(kit, act)
    span = lattice_range(kit)
    overlap = boxes_overlap(kit)

    @kit.func
    def cell_quad(model, frame, cell):
        """Return a cell of the terrain as a quad."""
        x0, x1 = model.terrain_box[frame, cell, 0], model.terrain_box[frame, cell, 1]
        y0, y1 = model.terrain_box[frame, cell, 2], model.terrain_box[frame, cell, 3]
        return quad(x0, y1, x1, y1, x1, y0, x0, y0)

    @kit.func
    def with_cell(model, data, mesh, pack, k, v, m: quad, mc: wp.vec4i, cell, r: quad):
        """Handle corners of the voxel inside the terrain cell, then corners of the cell inside the voxel."""
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
            if in_box(r[0], r[2], r[5], r[1], x, y) and inside_quad(x, y, r):
                contact(model, data, mesh, pack, k, v, m, m_sides, mc[c], c, -1 - cell, r, r_sides, none, one)
        for c in range(four):
            x, y = r[2 * c], r[2 * c + 1]
            if in_box(x0, x1, y0, y1, x, y) and inside_quad(x, y, m):
                contact(model, data, mesh, pack, k, -1 - cell, r, r_sides, -1, c, v, m, m_sides, mc, one)

    @kit.func
    def with_terrain(model, data, mesh, pack, k, v):
        """Handle the contacts of voxel v with all terrain cells under its box, in lane k."""
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
        """Handle the contacts of every voxel near terrain, lane by lane."""
        for n in range(data.near_count[unit]):
            v = data.near[unit, n]
            lanes = active & overlap(data.box, v, data.near_box, v, pack, lane)
            while lanes != 0:
                with_terrain(model, data, mesh, pack, lane + first_lane(lanes), v)
                lanes = without_first(lanes)

    return all_near


@functools.cache
def find(kit: Kit, act):
    """Build the stage that clears ``contact``, then finds all contacts and passes each to ``act``."""
    width = kit.width
    with_voxels = voxel_contacts(kit, act)
    with_terrain = terrain_contacts(kit, act)
    clear = kit.stage("native/springs.h", "native/clear_contact.h")

    @kit.func
    def active_lanes(data, pack, lane):
        """Return the mask of lanes that are not frozen."""
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
    """Build the stage that finds all contacts and adds their forces to ``contact``."""
    return find(kit, apply(kit))
