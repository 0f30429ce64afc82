"""Contact forces in float64, summed in the released simulator's order of contacts.

The release descends the box trees of two objects at once (:mod:`warpvox.contact_order` builds them), always into the
larger box, and adds to a point what it meets. Here contacts are found in any order and noted; then each gets as a key
the path of that descent, and they are taken in the order of the keys. Contacts inside one object are met twice.
"""

import warp as wp

from warpvox.kernels.contact import contact_forces, find
from warpvox.kernels.kit import Kit, builder
from warpvox.kernels.state import OVERFLOW

real = wp.float64
PATH = 40  # bits of a key for the path; below them 3 for way and corner, above them the pair of objects


@builder
def note_one(kit: Kit):
    """Build a function that stores one contact between a voxel's corner and another voxel's side."""

    @kit.func
    def add(data, pack, k, hit: wp.vec4i, ends: wp.vec2i, side: wp.vec3d):
        """Append a contact to the list of lane k, or set OVERFLOW if the list is full."""
        n = data.hits[pack, k]
        if n >= data.hit.shape[1]:
            data.status[pack, k] = data.status[pack, k] | OVERFLOW
            return
        data.hit[pack, n, k] = hit
        data.hit_ends[pack, n, k] = ends
        data.hit_side[pack, n, k] = side
        data.hits[pack, k] = n + 1

    return add


@builder
def note(kit: Kit):
    """Build a function that stores contacts for later, instead of adding their forces at once.

    A contact inside one object is stored for both orders of its two leaves.
    """
    add = note_one(kit)

    @kit.func
    def leaf(model, mesh, v):
        """Return the leaf of a surface voxel (v >= 0) or of terrain cell -1 - v in the box tree."""
        if v < 0:
            return model.cell_leaf[mesh, -1 - v]
        return model.leaf[mesh, v]

    @kit.func
    def act(model, data, mesh, pack, k, i, j, c, p, ends: wp.vec2i, side: wp.vec3d, times: real):
        """Store a contact of corner c (point p) of voxel i with a side of voxel j; within one object in both orders."""
        m, r = leaf(model, mesh, i), leaf(model, mesh, j)
        mine, other = model.node[mesh, m][2], model.node[mesh, r][2]
        if mine <= other:
            add(data, pack, k, wp.vec4i(m, r, c, p), ends, side)
        if mine >= other:
            add(data, pack, k, wp.vec4i(r, m, 4 + c, p), ends, side)

    return act


@builder
def path_key(kit: Kit):
    """Build a function that computes the sort key of a contact: its place in the descent through two box trees."""

    @kit.func
    def area(model, data, mesh, pack, k, n):
        """Return the area of tree node ``n``'s bounding box in lane ``k``."""
        if n >= model.nodes[mesh]:
            return model.node_area[mesh, n]
        wide = data.node_box[pack, 4 * n + 1, k] - data.node_box[pack, 4 * n, k]
        return wide * (data.node_box[pack, 4 * n + 3, k] - data.node_box[pack, 4 * n + 2, k])

    @kit.func
    def key(model, data, mesh, pack, k, first, second, last):
        """Compute the sort key of the contact between leaves ``first`` and ``second``; ``last`` is its lowest bits."""
        to_a, to_b = model.node[mesh, first], model.node[mesh, second]
        a, b = int(to_a[3]), int(to_b[3])  # the roots
        path = wp.int64(to_a[2] * model.objects[mesh] + to_b[2])
        for _ in range(int(PATH)):
            at_a, at_b = model.node[mesh, a], model.node[mesh, b]
            path = path << wp.int64(1)
            into_b = at_a[0] < 0
            if at_a[0] >= 0 and at_b[0] >= 0:
                into_b = area(model, data, mesh, pack, k, a) < area(model, data, mesh, pack, k, b)
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


@builder
def take(kit: Kit):
    """Build the stage that sums the forces of all stored contacts in the released order."""
    width = kit.width
    boxes = kit.stage("exact/tree_boxes.h")
    key = path_key(kit)
    forces = contact_forces(kit)

    @kit.func
    def sort(model, data, mesh, pack, k):
        """Sort the stored contacts of lane k by their keys."""
        for n in range(data.hits[pack, k]):
            hit = data.hit[pack, n, k]
            mine = key(model, data, mesh, pack, k, hit[0], hit[1], hit[2])
            at = int(n)
            while at > 0 and data.hit_key[pack, at - 1, k] > mine:
                data.hit_key[pack, at, k] = data.hit_key[pack, at - 1, k]
                data.hit_rank[pack, at, k] = data.hit_rank[pack, at - 1, k]
                at -= 1
            data.hit_key[pack, at, k] = mine
            data.hit_rank[pack, at, k] = n

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        """Sum the forces of the stored contacts in the order of their keys, for all lanes of the unit."""
        most = int(0)
        for k in range(lane, lane + int(width)):
            most = wp.max(most, data.hits[pack, k])
        if most == 0:
            return
        boxes(model, data, mesh, pack, lane, unit, dt)
        for k in range(lane, lane + int(width)):
            sort(model, data, mesh, pack, k)
            for n in range(data.hits[pack, k]):
                h = data.hit_rank[pack, n, k]
                ends = data.hit_ends[pack, h, k]
                forces(
                    model.contact, data.true_vel, data.contact, data.in_contact, pack, k,
                    data.hit[pack, h, k][3], ends[0], ends[1], data.hit_side[pack, h, k], real(1.0),
                )  # fmt: skip

    return stage


@builder
def contacts(kit: Kit):
    """Build the physics stage that finds all contacts and sums their forces in the order of released EvoGym."""
    width = kit.width
    search = find(kit, note(kit))
    in_order = take(kit)

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        for k in range(lane, lane + int(width)):
            data.hits[pack, k] = 0
        search(model, data, mesh, pack, lane, unit, dt)
        in_order(model, data, mesh, pack, lane, unit, dt)

    return stage
