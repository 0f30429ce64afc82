"""Contact forces in float64, added in the order in which the released simulator meets the contacts.

It descends the box trees of two objects at once (:mod:`warpvox.contact_order` builds them), always into the
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
    """Build a function that stores one contact: of a corner of a voxel with a side of another."""

    @kit.func
    def add(data, pack, k, hit: wp.vec4i, ends: wp.vec2i, side: wp.vec3d):
        """Append the contact to the list of lane k, or set OVERFLOW if the list is full."""
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
    """Build a function that stores the contacts that :func:`warpvox.kernels.contact.apply` would add at once.

    A contact inside one object is stored for both orders of its two leaves.
    """
    add = note_one(kit)

    @kit.func
    def leaf(model, mesh, v):
        """Return the leaf (number of its node in the box tree) of surface voxel v; v < 0: of terrain cell -1 - v."""
        if v < 0:
            return model.cell_leaf[mesh, -1 - v]
        return model.leaf[mesh, v]

    @kit.func
    def act(model, data, mesh, pack, k, i, j, c, p, ends: wp.vec2i, side: wp.vec3d, times: real):
        """Store a contact of corner c (point p) of voxel i with a side of voxel j; in one object for both orders."""
        m, r = leaf(model, mesh, i), leaf(model, mesh, j)
        mine, other = model.node[mesh, m][2], model.node[mesh, r][2]
        if mine <= other:
            add(data, pack, k, wp.vec4i(m, r, c, p), ends, side)
        if mine >= other:
            add(data, pack, k, wp.vec4i(r, m, 4 + c, p), ends, side)

    return act


@builder
def path_key(kit: Kit):
    """Build a function that returns a sort key: where the release's descent through two box trees meets two leaves."""

    @kit.func
    def area(model, data, mesh, pack, k, n):
        """Return the area of the bounding box of node ``n`` of the tree, in the environment of lane ``k``."""
        if n >= model.nodes[mesh]:
            return model.node_area[mesh, n]
        wide = data.node_box[pack, 4 * n + 1, k] - data.node_box[pack, 4 * n, k]
        return wide * (data.node_box[pack, 4 * n + 3, k] - data.node_box[pack, 4 * n + 2, k])

    @kit.func
    def key(model, data, mesh, pack, k, first, second, last):
        """Return the sort key of the contact of leaves ``first`` and ``second``; ``last`` is its lowest bits."""
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
    """Build the stage that adds the forces of all stored contacts to ``contact``, in the released order."""
    width = kit.width
    boxes = kit.stage("exact/tree_boxes.h")
    key = path_key(kit)
    forces = contact_forces(kit)

    @kit.func
    def sort(model, data, mesh, pack, k):
        """Write the keys of all stored contacts of lane k in ascending order, and the contact of each key."""
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
        """Add the forces of the stored contacts of the unit's lanes in the order of their keys."""
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
    """Build the stage that finds all contacts and adds their forces in the released order."""
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
