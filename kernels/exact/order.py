"""Contact forces in float64, added in the order in which the released simulator meets the contacts.

It descends the box trees of two objects at once (``warpvox/contact_order.py`` builds them), always into the larger
box, and adds to a point what it meets. Here contacts are found in any order and noted; then each gets as a key the path
of that descent, and they are taken in the order of the keys. Contacts inside one object are met twice.
"""

import functools

import warp as wp

from warpvox.kernels.contact import find, nearest_side, quad
from warpvox.kernels.lanes import inline, lane_ops
from warpvox.kernels.state import OVERFLOW, structs

real = wp.float64
PATH = 40  # bits of a key for the path; below them 3 for way and corner, above them the pair of objects


@functools.cache
def note():
    """Function: remember a contact of a corner of the voxel at one leaf with a side of that at another."""
    types = structs("float64")

    @inline
    def add(data: types.Data, pack: int, k: int, hit: wp.vec4i, ends: wp.vec2i, normal: wp.vec3d):
        n = data.hits[pack, k]
        if n >= data.hit.shape[1]:
            data.status[pack, k] = data.status[pack, k] | OVERFLOW
            return
        data.hit[pack, n, k] = hit
        data.hit_ends[pack, n, k] = ends
        data.hit_normal[pack, n, k] = normal
        data.hits[pack, k] = n + 1

    @inline
    def remember(
        model: types.Model, data: types.Data, design: int, pack: int, k: int, m: int, r: int, c: int, p: int,
        ends: wp.vec2i, normal: wp.vec3d,
    ):  # fmt: skip
        mine, other = model.node[design, m][2], model.node[design, r][2]
        if mine <= other:
            add(data, pack, k, wp.vec4i(m, r, c, p), ends, normal)
        if mine >= other:
            add(data, pack, k, wp.vec4i(r, m, 4 + c, p), ends, normal)

    return remember


@functools.cache
def meeting(precision: str):
    """Function: note what :func:`warpvox.kernels.contact.apply` adds."""
    types, remember = structs(precision), note()

    @wp.func
    def leaf(model: types.Model, design: int, v: int):
        if v < 0:
            return model.cell_leaf[design, -1 - v]
        return model.leaf[design, v]

    @inline
    def meet(
        model: types.Model, data: types.Data, design: int, pack: int, k: int, unit: int, i: int, m: quad, m_sides: int,
        p: int, c: int, j: int, r: quad, r_sides: int, r_points: wp.vec4i, times: real,
    ):  # fmt: skip
        side, depth = nearest_side(m, m_sides, c, r, r_sides)
        if side >= 0:
            f = (side + 1) % 4
            ux, uy = r[2 * f] - r[2 * side], r[2 * f + 1] - r[2 * side + 1]
            length = wp.sqrt(ux * ux + uy * uy)
            normal = wp.vec3d(-uy / length, ux / length, depth)
            ends = wp.vec2i(r_points[side], r_points[f])
            mine, other = leaf(model, design, i), leaf(model, design, j)
            remember(model, data, design, pack, k, mine, other, c, p, ends, normal)

    return meet


@functools.cache
def tree_boxes(width: int):
    """Function: boxes of the nodes over surface voxels, children before parents."""
    ops, types = lane_ops("float64", width), structs("float64")
    load, store, lower, upper = ops.load, ops.store, ops.lower, ops.upper

    @inline
    def boxes(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        for n in range(model.nodes[design]):
            node = model.node[design, n]
            for axis in range(int(2)):
                low = 2 * axis
                if node[0] < 0:
                    v = 4 * (-1 - node[0]) + low
                    store(data.node_box, pack, 4 * n + low, lane, load(data.box, pack, v, lane))
                    store(data.node_box, pack, 4 * n + low + 1, lane, load(data.box, pack, v + 1, lane))
                else:
                    a, b = 4 * node[0] + low, 4 * node[1] + low
                    least = lower(load(data.node_box, pack, a, lane), load(data.node_box, pack, b, lane))
                    most = upper(load(data.node_box, pack, a + 1, lane), load(data.node_box, pack, b + 1, lane))
                    store(data.node_box, pack, 4 * n + low, lane, least)
                    store(data.node_box, pack, 4 * n + low + 1, lane, most)

    return boxes


@functools.cache
def path_key():
    """Function: a number for the place of two leaves in the descent."""
    types = structs("float64")

    @inline
    def area(model: types.Model, data: types.Data, design: int, pack: int, k: int, n: int):
        if n >= model.nodes[design]:
            return model.node_area[design, n]
        wide = data.node_box[pack, 4 * n + 1, k] - data.node_box[pack, 4 * n, k]
        return wide * (data.node_box[pack, 4 * n + 3, k] - data.node_box[pack, 4 * n + 2, k])

    @inline
    def key(model: types.Model, data: types.Data, design: int, pack: int, k: int, first: int, second: int, last: int):
        to_a, to_b = model.node[design, first], model.node[design, second]
        a, b = int(to_a[3]), int(to_b[3])  # the roots
        path = wp.int64(to_a[2] * model.objects[design] + to_b[2])
        for _ in range(int(PATH)):
            at_a, at_b = model.node[design, a], model.node[design, b]
            path = path << wp.int64(1)
            into_b = at_a[0] < 0
            if at_a[0] >= 0 and at_b[0] >= 0:
                into_b = area(model, data, design, pack, k, a) < area(model, data, design, pack, k, b)
            if into_b:
                if at_b[0] >= 0:
                    b = at_b[0]
                    if to_b[1] >= at_b[2]:
                        b = at_b[1]
                        path = path | wp.int64(1)
            else:
                a = at_a[0]
                if to_a[1] >= at_a[2]:
                    a = at_a[1]
                    path = path | wp.int64(1)
        return (path << wp.int64(3)) | wp.int64(last)

    return key


@functools.cache
def push():
    """Function: the forces of one contact on the corner p and the ends a, b of the side (paper section A.3)."""
    types = structs("float64")

    @wp.func
    def add(out: wp.array3d(dtype=real), pack: int, k: int, p: int, fx: real, fy: real):
        if p >= 0:
            out[pack, 2 * p, k] = out[pack, 2 * p, k] + fx
            out[pack, 2 * p + 1, k] = out[pack, 2 * p + 1, k] + fy

    @wp.func
    def along(velocity: wp.array3d(dtype=real), pack: int, k: int, p: int, x: real, y: real):
        if p < 0:
            return real(0.0)
        return x * velocity[pack, 2 * p, k] + y * velocity[pack, 2 * p + 1, k]

    @wp.func
    def forces(
        law: types.Contact, velocity: wp.array3d(dtype=real), out: wp.array3d(dtype=real), pack: int, k: int,
        p: int, a: int, b: int, normal: wp.vec3d,
    ):  # fmt: skip
        nx, ny = normal[0], normal[1]
        fx, fy = nx * law.stiffness * (law.depth + normal[2]), ny * law.stiffness * (law.depth + normal[2])
        # The released simulator normalises the unit normal once more before it damps and rubs.
        length = wp.sqrt(nx * nx + ny * ny)
        ux, uy = nx / length, ny / length
        vp = along(velocity, pack, k, p, ux, uy)
        va = along(velocity, pack, k, a, ux, uy)
        vb = along(velocity, pack, k, b, ux, uy)
        half, c = real(0.5), law.damping
        add(out, pack, k, p, fx - ux * vp * c, fy - uy * vp * c)
        add(out, pack, k, a, -(fx * half + ux * va * c * half), -(fy * half + uy * va * c * half))
        add(out, pack, k, b, -(fx * half + ux * vb * c * half), -(fy * half + uy * vb * c * half))
        # Friction: viscous at small slip, at most friction_multiplier * friction * normal force.
        tx, ty = -uy, ux
        slip = along(velocity, pack, k, p, tx, ty)
        if slip < real(0.0):
            slip, tx, ty = -slip, -tx, -ty
        size = wp.sqrt(fx * fx + fy * fy)
        rub = real(0.0)
        if slip != real(0.0):  # without friction or stiffness the quotient would be 0/0
            rub = wp.tanh(slip / (law.friction * size))
        sx = -(law.friction_multiplier * tx) * law.friction * size * rub
        sy = -(law.friction_multiplier * ty) * law.friction * size * rub
        add(out, pack, k, p, sx, sy)
        add(out, pack, k, a, -sx * half, -sy * half)
        add(out, pack, k, b, -sx * half, -sy * half)

    return forces


@functools.cache
def take(width: int):
    """Function: the forces of all contacts noted, into ``contact``."""
    types = structs("float64")
    boxes, key, forces = tree_boxes(width), path_key(), push()

    @inline
    def sort(model: types.Model, data: types.Data, design: int, pack: int, k: int):
        """Keys in ascending order, and which contact each is of."""
        for n in range(data.hits[pack, k]):
            hit = data.hit[pack, n, k]
            mine = key(model, data, design, pack, k, hit[0], hit[1], hit[2])
            at = int(n)
            while at > 0 and data.hit_key[pack, at - 1, k] > mine:
                data.hit_key[pack, at, k] = data.hit_key[pack, at - 1, k]
                data.hit_rank[pack, at, k] = data.hit_rank[pack, at - 1, k]
                at -= 1
            data.hit_key[pack, at, k] = mine
            data.hit_rank[pack, at, k] = n

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        most = int(0)
        for k in range(lane, lane + int(width)):
            most = wp.max(most, data.hits[pack, k])
        if most == 0:
            return
        boxes(model, data, design, pack, lane)
        for k in range(lane, lane + int(width)):
            sort(model, data, design, pack, k)
            for n in range(data.hits[pack, k]):
                h = data.hit_rank[pack, n, k]
                ends = data.hit_ends[pack, h, k]
                forces(
                    model.contact, data.true_vel, data.contact, pack, k,
                    data.hit[pack, h, k][3], ends[0], ends[1], data.hit_normal[pack, h, k],
                )  # fmt: skip

    return stage


@functools.cache
def contacts(precision: str, width: int):
    """Stage: all contact forces, in the released order."""
    types, search, in_order = structs(precision), find(precision, width, meeting), take(width)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        for k in range(lane, lane + int(width)):
            data.hits[pack, k] = 0
        search(model, data, design, pack, lane, unit, dt)
        in_order(model, data, design, pack, lane)

    return stage
