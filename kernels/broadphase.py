"""Broad phase: which surface voxels may touch each other or terrain during the next sub-steps.

Candidates are collected with a margin and stay valid until the fastest point has moved half of it, so this runs
every few dozen sub-steps. The list is common to the lanes of a unit, in ascending order, hence the order of
contact forces does not depend on who else is in the pack. Few mobile voxels are compared all with all (vectorised
over the lanes, that is the fastest); many go through a hashed grid, lane by lane. Voxels that stand still are looked
up on the lattice of the terrain. All ways give the same candidates: a bit each, then a list.
"""

import functools

import warp as wp

from warpvox.kernels.lanes import inline, lane_ops, native
from warpvox.kernels.state import structs

GRID_FROM = 64  # mobile voxels from which the grid is used ...
WIDE_GRID_FROM = 256  # ... where comparing boxes serves many lanes at once
SLOT = 0.2  # size of a grid cell: a voxel with its margin covers 1 to 4 cells
ENTRIES_PER_VOXEL = 9  # capacity; a voxel cannot be stretched over more cells than 3 x 3
DISTANT = wp.constant(16)  # bit in pairs[2]: voxels of one robot that are no neighbours in its grid
CELL = 0.1
TORN = 5.0  # a voxel wider than this has exploded: its environment is lost, and its cells are too many to visit
FAR = 1.0e6  # a coordinate beyond this is not on any lattice (also stops NaN before it becomes an int)


ENCLOSE = """
    const auto pos = wides(data.pos);
    const auto box = wides(data.box);
    const wp::vec_t<4, int> c = wp::index(model.corner, design, v);
    for (int axis = 0; axis < 2; ++axis) {
        Wide low = pos[2 * c[0] + axis], high = low;
        for (int k = 1; k < 4; ++k) {
            const Wide p = pos[2 * c[k] + axis];
            low = p < low ? p : low;
            high = p > high ? p : high;
        }
        box[4 * v + 2 * axis] = low;
        box[4 * v + 2 * axis + 1] = high;
    }
"""


@functools.cache
def voxel_box(precision: str, width: int):
    """Function: axis-aligned bounds of a voxel, into ``box``."""
    types = structs(precision)

    @wp.func_native(native("float64", width) + ENCLOSE)
    def enclose(model: types.Model, data: types.Data, design: int, pack: int, lane: int, v: int): ...

    return enclose


@functools.cache
def boxes(precision: str, width: int):
    """Stage: bounds of the surface voxels that may have moved."""
    types, enclose = structs(precision), voxel_box(precision, width)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        for n in range(model.mobiles[design]):
            enclose(model, data, design, pack, lane, model.mobile[design, n])

    return stage


@functools.cache
def box_overlap(precision: str, width: int):
    """Function: the lanes in which the boxes of two voxels, together ``margin`` wider, overlap or touch."""
    ops, types = lane_ops("float64", width), structs(precision)
    load, splat, at_most = ops.load, ops.splat, ops.at_most

    @inline
    def overlap(data: types.Data, pack: int, lane: int, i: int, j: int, margin: wp.float64):
        m = splat(margin)
        lanes = at_most(load(data.box, pack, 4 * i, lane), load(data.box, pack, 4 * j + 1, lane) + m)
        lanes = lanes & at_most(load(data.box, pack, 4 * j, lane), load(data.box, pack, 4 * i + 1, lane) + m)
        lanes = lanes & at_most(load(data.box, pack, 4 * i + 2, lane), load(data.box, pack, 4 * j + 3, lane) + m)
        return lanes & at_most(load(data.box, pack, 4 * j + 2, lane), load(data.box, pack, 4 * i + 3, lane) + m)

    return overlap


@functools.cache
def mark_pair(precision: str):
    """Function: note that two voxels are candidates, in one bit for both orders; still ones never meet."""
    types = structs(precision)

    @inline
    def mark(model: types.Model, data: types.Data, design: int, unit: int, v: int, w: int):
        if model.still[design, v] == 1 and model.still[design, w] == 1:
            return
        i, j = wp.min(v, w), wp.max(v, w)
        word = i * ((model.voxels[design] + 31) // 32) + j // 32
        data.pair_bit[unit, word] = data.pair_bit[unit, word] | (1 << (j % 32))

    return mark


# The candidates among mobile voxels, by boxes around all lanes first: while lanes are alike that is nearly enough.
MARK_ALL = """
    const auto box = wides(data.box);
    const int n = wp::index(model.mobiles, design), words = (wp::index(model.voxels, design) + 31) / 32;
    const int* mobile = &wp::index(model.mobile, design, 0);
    const int* still = &wp::index(model.still, design, 0);
    double* hull = &wp::index(data.hull, unit, 0);
    int* bits = &wp::index(data.pair_bit, unit, 0);
    for (int a = 0; a < n; ++a) {
        for (int side = 0; side < 4; ++side) {
            hull[4 * a + side] = side % 2 ? largest(box[4 * mobile[a] + side]) : least(box[4 * mobile[a] + side]);
        }
    }
    for (int a = 0; a < n; ++a) {
        const int i = mobile[a];
        const double slack = 1.001 * margin;
        const double left = hull[4 * a] - slack, right = hull[4 * a + 1] + slack;
        const double low = hull[4 * a + 2] - slack, high = hull[4 * a + 3] + slack;
        const Wide x0 = box[4 * i], x1 = box[4 * i + 1] + margin, y0 = box[4 * i + 2], y1 = box[4 * i + 3] + margin;
        for (int b = a + 1; b < n; ++b) {
            const double* h = hull + 4 * b;
            if (h[0] > right || h[1] < left || h[2] > high || h[3] < low) continue;
            const int j = mobile[b];
            if (still[i] && still[j]) continue;
            const auto meet = (x0 <= box[4 * j + 1] + margin) & (box[4 * j] <= x1) & (y0 <= box[4 * j + 3] + margin)
                & (box[4 * j + 2] <= y1);
            if (bits_of(meet)) bits[i * words + j / 32] |= 1 << (j % 32);
        }
    }
"""


@functools.cache
def mark_all(precision: str, width: int):
    """Stage: candidates among mobile voxels by comparing all boxes with all."""
    types = structs(precision)

    @wp.func_native(native("float64", width) + MARK_ALL)
    def mark(
        model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, margin: wp.float64
    ): ...

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        mark(model, data, design, pack, lane, unit, model.margin)

    return stage


@functools.cache
def meets(precision: str):
    """Function: :func:`box_overlap` for one lane."""
    types = structs(precision)

    @inline
    def meet(data: types.Data, pack: int, k: int, i: int, j: int, m: wp.float64):
        return (
            data.box[pack, 4 * i, k] <= data.box[pack, 4 * j + 1, k] + m
            and data.box[pack, 4 * j, k] <= data.box[pack, 4 * i + 1, k] + m
            and data.box[pack, 4 * i + 2, k] <= data.box[pack, 4 * j + 3, k] + m
            and data.box[pack, 4 * j + 2, k] <= data.box[pack, 4 * i + 3, k] + m
        )

    return meet


@functools.cache
def mark_grid(precision: str, width: int):
    """Stage: candidates among mobile voxels through a hashed grid, one lane after another."""
    types = structs(precision)
    mark, meet = mark_pair(precision), meets(precision)

    @inline
    def slot_of(data: types.Data, x: int, y: int):
        return ((x * 73856093) ^ (y * 19349663)) & (data.grid_head.shape[1] - 1)

    @inline
    def cells(data: types.Data, pack: int, k: int, v: int, margin: wp.float64):
        """First and last grid column and row of a voxel's box, half the margin wider; empty if not finite."""
        half = margin * wp.float64(0.5)
        x0, x1 = data.box[pack, 4 * v, k] - half, data.box[pack, 4 * v + 1, k] + half
        y0, y1 = data.box[pack, 4 * v + 2, k] - half, data.box[pack, 4 * v + 3, k] + half
        whole = x1 - x0 < wp.float64(TORN) and y1 - y0 < wp.float64(TORN)
        if whole and x0 > -wp.float64(FAR) and x1 < wp.float64(FAR) and y0 > -wp.float64(FAR) and y1 < wp.float64(FAR):
            s = wp.float64(1.0 / SLOT)
            return int(wp.floor(x0 * s)), int(wp.floor(x1 * s)), int(wp.floor(y0 * s)), int(wp.floor(y1 * s))
        return 0, -1, 0, -1

    @inline
    def enter(model: types.Model, data: types.Data, design: int, pack: int, k: int, unit: int, v: int, entries: int):
        """Meet the voxels that have entered the cells of voxel v, then enter it; the number of entries after that."""
        n = int(entries)
        x0, x1, y0, y1 = cells(data, pack, k, v, model.margin)
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                slot = slot_of(data, x, y)
                e = data.grid_head[unit, slot]
                while e >= 0:
                    w = data.grid_voxel[unit, e]
                    if w != v and meet(data, pack, k, w, v, model.margin):
                        mark(model, data, design, unit, w, v)
                    e = data.grid_next[unit, e]
                if n >= data.grid_next.shape[1]:
                    data.overflow[unit] = 1
                    return n
                data.grid_voxel[unit, n] = v
                data.grid_next[unit, n] = data.grid_head[unit, slot]
                data.grid_head[unit, slot] = n
                n += 1
        return n

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        lanes = int(width)
        for k in range(lane, lane + lanes):
            for slot in range(data.grid_head.shape[1]):
                data.grid_head[unit, slot] = -1
            entries = int(0)
            for n in range(model.mobiles[design]):
                entries = enter(model, data, design, pack, k, unit, model.mobile[design, n], entries)

    return stage


@functools.cache
def lattice_range(precision: str):
    """Function: columns and rows of the terrain lattice under a box that is ``margin`` wider on every side."""
    types = structs(precision)

    @inline
    def span(model: types.Model, data: types.Data, design: int, pack: int, k: int, v: int, margin: wp.float64):
        size = model.terrain[design]
        x0, x1 = data.box[pack, 4 * v, k] - margin, data.box[pack, 4 * v + 1, k] + margin
        y0, y1 = data.box[pack, 4 * v + 2, k] - margin, data.box[pack, 4 * v + 3, k] + margin
        if x0 > -wp.float64(FAR) and x1 < wp.float64(FAR) and y0 > -wp.float64(FAR) and y1 < wp.float64(FAR):
            s = wp.float64(1.0 / CELL)
            slack = wp.float64(1.0e-3)  # in cells: coordinates carry rounding, the lattice does not
            return (
                wp.max(int(wp.floor(x0 * s - slack)), 0),
                wp.min(int(wp.floor(x1 * s + slack)), size[0] - 1),
                wp.max(int(wp.floor(y0 * s - slack)), 0),
                wp.min(int(wp.floor(y1 * s + slack)), size[1] - 1),
            )
        return 0, -1, 0, -1

    return span


@functools.cache
def mark_still(precision: str, width: int):
    """Stage: candidates of mobile voxels and those that stand still, which the terrain lattice finds."""
    types = structs(precision)
    mark, meet, span = mark_pair(precision), meets(precision), lattice_range(precision)

    @inline
    def look(model: types.Model, data: types.Data, design: int, pack: int, k: int, unit: int, v: int):
        x0, x1, y0, y1 = span(model, data, design, pack, k, v, model.margin)
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                w = model.still_at[design, y * model.terrain[design][0] + x]
                if w >= 0 and meet(data, pack, k, w, v, model.margin):
                    mark(model, data, design, unit, v, w)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        if model.mobiles[design] == model.voxels[design]:
            return
        lanes = int(width)
        for n in range(model.mobiles[design]):
            for k in range(lane, lane + lanes):
                look(model, data, design, pack, k, unit, model.mobile[design, n])

    return stage


@functools.cache
def list_pairs(precision: str, width: int):
    """Stage: the marked candidates in ascending order, into ``pairs``."""
    types, first, drop = structs(precision), lane_ops(precision, width).first, lane_ops(precision, width).drop

    @wp.func
    def shares(corners: wp.vec4i, p: int):
        return corners[0] == p or corners[1] == p or corners[2] == p or corners[3] == p

    @wp.func
    def own_corners(mine: wp.vec4i, other: wp.vec4i):
        """Bits of the corners that are not corners of the other voxel too."""
        bits = int(0)
        four = int(4)
        for c in range(four):
            if not shares(other, mine[c]):
                bits = bits | (1 << c)
        return bits

    @inline
    def add(model: types.Model, data: types.Data, design: int, unit: int, i: int, j: int):
        n = data.pair_count[unit]
        if n >= data.pairs.shape[1]:
            data.overflow[unit] = 1
            return
        ci = model.corner[design, i]
        cj = model.corner[design, j]
        bits = own_corners(ci, cj)
        if model.robot[design, i] >= 0 and model.body[design, i] == model.body[design, j]:
            away = model.grid[design, i] - model.grid[design, j]
            if wp.abs(away[0]) > 1 or wp.abs(away[1]) > 1:
                bits = bits | DISTANT
        data.pairs[unit, n] = wp.vec4i(i, j, bits, own_corners(cj, ci))
        data.pair_count[unit] = n + 1

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        data.pair_count[unit] = 0
        words = (model.voxels[design] + 31) // 32
        for word in range(model.voxels[design] * words):
            bits = data.pair_bit[unit, word]
            data.pair_bit[unit, word] = 0
            while bits != 0:
                add(model, data, design, unit, word // words, 32 * (word % words) + first(bits))
                bits = drop(bits)

    return stage


@functools.cache
def collect_near(precision: str, width: int):
    """Stage: voxels that may touch terrain in some lane."""
    types = structs(precision)
    span = lattice_range(precision)

    @inline
    def touches(model: types.Model, data: types.Data, design: int, pack: int, k: int, v: int):
        x0, x1, y0, y1 = span(model, data, design, pack, k, v, model.margin)
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                if model.terrain_side[design, y * model.terrain[design][0] + x] != 0:
                    return 1
        return 0

    @inline
    def bound(model: types.Model, data: types.Data, design: int, pack: int, k: int, v: int):
        """Bounds of the surface cells in reach, inside out where there are none."""
        x0, x1, y0, y1 = span(model, data, design, pack, k, v, model.margin)
        left, right, bottom, top = wp.float64(FAR), wp.float64(-FAR), wp.float64(FAR), wp.float64(-FAR)
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                cell = y * model.terrain[design][0] + x
                if model.terrain_side[design, cell] != 0:
                    left = wp.min(left, model.terrain_box[design, cell, 0])
                    right = wp.max(right, model.terrain_box[design, cell, 1])
                    bottom = wp.min(bottom, model.terrain_box[design, cell, 2])
                    top = wp.max(top, model.terrain_box[design, cell, 3])
        data.near_box[pack, 4 * v, k] = left
        data.near_box[pack, 4 * v + 1, k] = right
        data.near_box[pack, 4 * v + 2, k] = bottom
        data.near_box[pack, 4 * v + 3, k] = top

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        n = int(0)
        for m in range(model.mobiles[design]):
            v = model.mobile[design, m]
            found = int(0)
            k = int(lane)
            while found == 0 and k < lane + width:
                found = touches(model, data, design, pack, k, v)
                k += 1
            if found == 1:
                data.near[unit, n] = v
                n += 1
                for e in range(lane, lane + int(width)):
                    bound(model, data, design, pack, e, v)
        data.near_count[unit] = n

    return stage


@functools.cache
def collect_pairs(precision: str, width: int):
    """Stage: the candidate pairs anew."""
    types, enclose = structs(precision), voxel_box(precision, width)
    grid_from = GRID_FROM if width == 1 else WIDE_GRID_FROM
    by_grid, by_all, by_lattice, listed = (
        build(precision, width) for build in (mark_grid, mark_all, mark_still, list_pairs)
    )

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        if model.mobiles[design] < model.voxels[design]:
            for v in range(model.voxels[design]):
                enclose(model, data, design, pack, lane, v)
        if model.mobiles[design] >= grid_from:
            by_grid(model, data, design, pack, lane, unit, dt)
        else:
            by_all(model, data, design, pack, lane, unit, dt)
        by_lattice(model, data, design, pack, lane, unit, dt)
        listed(model, data, design, pack, lane, unit, dt)

    return stage


@functools.cache
def collect(precision: str, width: int):
    """Stage: all candidates anew, once the old ones are worn out."""
    types = structs(precision)
    pairs, near = collect_pairs(precision, width), collect_near(precision, width)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        if data.drift[unit] + data.drift[unit] >= model.margin:
            data.overflow[unit] = 0
            pairs(model, data, design, pack, lane, unit, dt)
            near(model, data, design, pack, lane, unit, dt)
            data.drift[unit] = wp.float64(0.0)

    return stage
