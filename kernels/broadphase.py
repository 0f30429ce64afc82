"""Broad phase: which surface voxels may touch each other or terrain during the next sub-steps.

Candidates are collected with a margin and stay valid until the fastest point has moved half of it, so this runs
every few dozen sub-steps. The list is common to the lanes of a unit, in ascending order, hence the order of
contact forces does not depend on who else is in the pack. Few movable voxels are compared all with all (vectorised
over the lanes, that is the fastest); many go through a hashed grid, lane by lane. Fixed voxels are looked
up on the lattice of the terrain. All ways give the same candidates: a bit each, then a list.
"""

import warp as wp

from warpvox.kernels.kit import Kit, builder
from warpvox.kernels.state import FARTHEST
from warpvox.types import VOXEL

GRID_FROM = 64  # movable voxels from which the grid is used ...
WIDE_GRID_FROM = 256  # ... where comparing boxes serves many lanes at once
SLOT = 0.2  # size of a grid cell: a voxel with its margin covers 1 to 4 cells
ENTRIES_PER_VOXEL = 9  # capacity; a voxel cannot be stretched over more cells than 3 x 3
WIDE_HULL = 2.0  # lanes that are further apart are looked at one by one
TOO_WIDE = 5.0  # a wider voxel has exploded: its environment is lost, and its cells are too many to visit


@builder
def boxes(kit: Kit):
    """Build the stage that computes the bounding boxes of all surface voxels that may have moved."""
    return kit.stage("native/voxel_boxes.h", precision="float64", movable=1)


@builder
def boxes_overlap(kit: Kit):
    """Build a function that compares two tables of boxes: in which lanes row i of one meets row j of the other."""

    @kit.func_native("native/boxes_overlap.h", precision="float64")
    def overlap(one: wp.array3d(dtype=wp.float64), i, other: wp.array3d(dtype=wp.float64), j, pack, lane) -> int: ...

    return overlap


@builder
def mark_pair(kit: Kit):
    """Build a function that marks two voxels as a pair that may touch, unless both are fixed."""

    @kit.func
    def mark(model, data, mesh, unit, v, w):
        if model.fixed_voxel[mesh, v] == 1 and model.fixed_voxel[mesh, w] == 1:
            return
        i, j = wp.min(v, w), wp.max(v, w)
        word = i * ((model.voxels[mesh] + 31) // 32) + j // 32
        data.pair_bit[unit, word] = data.pair_bit[unit, word] | (1 << (j % 32))

    return mark


@builder
def hulls(kit: Kit):
    """Build the stage that computes one bounding box per movable voxel, around its boxes in all lanes."""
    return kit.stage("native/hulls.h", precision="float64")


@builder
def mark_all(kit: Kit):
    """Build the stage that marks pairs of movable voxels that may touch, by comparing all bounding boxes."""
    return kit.stage("native/mark_all.h", precision="float64")


@builder
def near_in_lane(kit: Kit):
    """Build a function that tests whether the boxes of voxels i and j are at most ``m`` apart per axis in lane k."""

    @kit.func
    def near(data, pack, k, i, j, m: wp.float64):
        """Return whether the boxes of voxels i and j are at most ``m`` apart on both axes in lane k."""
        return (
            data.box[pack, 4 * i, k] <= data.box[pack, 4 * j + 1, k] + m
            and data.box[pack, 4 * j, k] <= data.box[pack, 4 * i + 1, k] + m
            and data.box[pack, 4 * i + 2, k] <= data.box[pack, 4 * j + 3, k] + m
            and data.box[pack, 4 * j + 2, k] <= data.box[pack, 4 * i + 3, k] + m
        )

    return near


@wp.func
def on_lattice(x0: wp.float64, x1: wp.float64, y0: wp.float64, y1: wp.float64):
    """Return whether bounds are finite and small enough to have cell numbers; False for NaN."""
    far = wp.float64(FARTHEST)
    return x0 > -far and x1 < far and y0 > -far and y1 < far


@builder
def mark_grid(kit: Kit):
    """Build the stage that marks pairs of movable voxels that may touch, by a hashed grid, one lane after another."""
    width = kit.width
    mark = mark_pair(kit)
    near = near_in_lane(kit)

    @kit.func
    def slot_of(data, x, y):
        """Return the slot of grid cell (x, y) in the hash table."""
        return ((x * 73856093) ^ (y * 19349663)) & (data.grid_head.shape[1] - 1)

    @kit.func
    def cells(data, pack, k, v, margin):
        """Return first and last column, first and last row of the grid cells under a voxel's box.

        The box is half the margin wider on every side. No cells (0, -1, 0, -1) if it is not finite or too wide.
        """
        half = margin * wp.float64(0.5)
        x0, x1 = data.box[pack, 4 * v, k] - half, data.box[pack, 4 * v + 1, k] + half
        y0, y1 = data.box[pack, 4 * v + 2, k] - half, data.box[pack, 4 * v + 3, k] + half
        whole = x1 - x0 < wp.float64(TOO_WIDE) and y1 - y0 < wp.float64(TOO_WIDE)
        if whole and on_lattice(x0, x1, y0, y1):
            s = wp.float64(1.0 / SLOT)
            return int(wp.floor(x0 * s)), int(wp.floor(x1 * s)), int(wp.floor(y0 * s)), int(wp.floor(y1 * s))
        return 0, -1, 0, -1

    @kit.func
    def insert(model, data, mesh, pack, k, unit, v, entries):
        """Mark voxel v as near all voxels in its grid cells, then add v to these cells; return the entry count."""
        n = int(entries)
        x0, x1, y0, y1 = cells(data, pack, k, v, model.margin)
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                slot = slot_of(data, x, y)
                e = data.grid_head[unit, slot]
                while e >= 0:
                    w = data.grid_voxel[unit, e]
                    if w != v and near(data, pack, k, w, v, model.margin):
                        mark(model, data, mesh, unit, w, v)
                    e = data.grid_next[unit, e]
                if n >= data.grid_next.shape[1]:
                    data.overflow[unit] = 1
                    return n
                data.grid_voxel[unit, n] = v
                data.grid_next[unit, n] = data.grid_head[unit, slot]
                data.grid_head[unit, slot] = n
                n += 1
        return n

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        """Empty the hash table, then insert all movable voxels, for each lane of the unit."""
        lanes = int(width)
        for k in range(lane, lane + lanes):
            for slot in range(data.grid_head.shape[1]):
                data.grid_head[unit, slot] = -1
            entries = int(0)
            for n in range(model.movables[mesh]):
                entries = insert(model, data, mesh, pack, k, unit, model.movable[mesh, n], entries)

    return stage


@wp.func
def lattice_cells(size: wp.vec2i, x0: wp.float64, x1: wp.float64, y0: wp.float64, y1: wp.float64):
    """Return first and last column, first and last row of terrain cells within bounds; none if not finite."""
    if on_lattice(x0, x1, y0, y1):
        s = wp.float64(1.0 / VOXEL)
        slack = wp.float64(1.0e-3)  # in cells: coordinates carry rounding, the lattice does not
        return (
            wp.max(int(wp.floor(x0 * s - slack)), 0),
            wp.min(int(wp.floor(x1 * s + slack)), size[0] - 1),
            wp.max(int(wp.floor(y0 * s - slack)), 0),
            wp.min(int(wp.floor(y1 * s + slack)), size[1] - 1),
        )
    return 0, -1, 0, -1


@builder
def lattice_range(kit: Kit):
    """Build a function that returns the columns and rows of the terrain lattice under a voxel's box.

    The box is ``margin`` wider on every side.
    """

    @kit.func
    def span(model, data, mesh, pack, k, v, margin):
        x0, x1 = data.box[pack, 4 * v, k] - margin, data.box[pack, 4 * v + 1, k] + margin
        y0, y1 = data.box[pack, 4 * v + 2, k] - margin, data.box[pack, 4 * v + 3, k] + margin
        return lattice_cells(model.terrain[model.frame[mesh]], x0, x1, y0, y1)

    return span


@builder
def lattice_content(kit: Kit):
    """Build a function that returns whether terrain or fixed voxels are near the n-th movable voxel.

    Bit 1: the surface of terrain; bit 2: fixed voxels.

    Both are said to be where the hull is large (its lanes are far apart) or not finite.
    """

    @kit.func
    def content(model, data, mesh, unit, n):
        """Return bit 1 if terrain is near the n-th movable voxel, plus bit 2 if fixed voxels are."""
        frame, margin = model.frame[mesh], model.margin
        size = model.terrain[frame]
        x0, x1, y0, y1 = lattice_cells(
            size, data.hull[unit, 4 * n] - margin, data.hull[unit, 4 * n + 1] + margin,
            data.hull[unit, 4 * n + 2] - margin, data.hull[unit, 4 * n + 3] + margin,
        )  # fmt: skip
        found = int(0)
        if not data.hull[unit, 4 * n + 1] - data.hull[unit, 4 * n] < wp.float64(WIDE_HULL) or y1 < y0:
            found = 3
        else:
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    if model.terrain_side[frame, y * size[0] + x] != 0:
                        found = found | 1
                    if model.fixed_at[frame, y * size[0] + x] >= 0:
                        found = found | 2
        return found

    return content


@builder
def mark_fixed(kit: Kit):
    """Build the stage that marks pairs of a movable and a fixed voxel that may touch, by the terrain lattice."""
    width = kit.width
    mark = mark_pair(kit)
    near = near_in_lane(kit)
    span = lattice_range(kit)
    content = lattice_content(kit)

    @kit.func
    def mark_lane(model, data, mesh, pack, k, unit, v):
        """Mark the fixed voxels near voxel v in lane k."""
        x0, x1, y0, y1 = span(model, data, mesh, pack, k, v, model.margin)
        frame, first = model.frame[mesh], model.first_other[mesh]
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                w = model.fixed_at[frame, y * model.terrain[frame][0] + x]
                if w >= 0 and near(data, pack, k, first + w, v, model.margin):
                    mark(model, data, mesh, unit, v, first + w)

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        """Mark the fixed voxels near each movable voxel, in all lanes of the unit."""
        if model.movables[mesh] == model.voxels[mesh]:
            return
        lanes = int(width)
        for n in range(model.movables[mesh]):
            if (content(model, data, mesh, unit, n) & 2) == 0:
                continue
            for k in range(lane, lane + lanes):
                mark_lane(model, data, mesh, pack, k, unit, model.movable[mesh, n])

    return stage


@builder
def list_pairs(kit: Kit):
    """Build the stage that lists the marked pairs in ascending order in ``pairs``, with the corners that may touch."""
    return kit.stage("native/list_pairs.h", precision="float64")


@builder
def collect_near(kit: Kit):
    """Build the stage that lists the voxels close to terrain in some lane, in ``near``."""
    width = kit.width
    span = lattice_range(kit)
    content = lattice_content(kit)

    @kit.func
    def store_near_box(model, data, mesh, pack, k, v):
        """Store the bounds of surface terrain near voxel v in lane k; return 1 if there is any, else 0.

        Without such cells the stored bounds are inverted: left > right.
        """
        x0, x1, y0, y1 = span(model, data, mesh, pack, k, v, model.margin)
        frame = model.frame[mesh]
        left, bottom = wp.float64(FARTHEST), wp.float64(FARTHEST)
        right, top = -left, -bottom
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                cell = y * model.terrain[frame][0] + x
                if model.terrain_side[frame, cell] != 0:
                    left = wp.min(left, model.terrain_box[frame, cell, 0])
                    right = wp.max(right, model.terrain_box[frame, cell, 1])
                    bottom = wp.min(bottom, model.terrain_box[frame, cell, 2])
                    top = wp.max(top, model.terrain_box[frame, cell, 3])
        data.near_box[pack, 4 * v, k] = left
        data.near_box[pack, 4 * v + 1, k] = right
        data.near_box[pack, 4 * v + 2, k] = bottom
        data.near_box[pack, 4 * v + 3, k] = top
        return wp.where(left <= right, 1, 0)

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        """List the unit's voxels close to terrain in some lane."""
        lanes = int(width)
        n = int(0)
        for m in range(model.movables[mesh]):
            if (content(model, data, mesh, unit, m) & 1) == 0:
                continue
            v = model.movable[mesh, m]
            found = int(0)
            for k in range(lane, lane + lanes):
                found = found | store_near_box(model, data, mesh, pack, k, v)
            if found == 1:
                data.near[unit, n] = v
                n += 1
        data.near_count[unit] = n

    return stage


@builder
def collect_pairs(kit: Kit):
    """Build the stage that searches again for all pairs of voxels that may touch."""
    grid_from = GRID_FROM if kit.width == 1 else WIDE_GRID_FROM
    all_boxes = kit.stage("native/voxel_boxes.h", precision="float64", movable=0)
    around = hulls(kit)
    by_grid = mark_grid(kit)
    by_all = mark_all(kit)
    by_lattice = mark_fixed(kit)
    listed = list_pairs(kit)

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        """Find the pairs of voxels that may touch: movable with movable, then movable with fixed ones."""
        if model.movables[mesh] < model.voxels[mesh]:
            all_boxes(model, data, mesh, pack, lane, unit, dt)
        around(model, data, mesh, pack, lane, unit, dt)
        if model.movables[mesh] >= grid_from:
            by_grid(model, data, mesh, pack, lane, unit, dt)
        else:
            by_all(model, data, mesh, pack, lane, unit, dt)
        by_lattice(model, data, mesh, pack, lane, unit, dt)
        listed(model, data, mesh, pack, lane, unit, dt)

    return stage


@builder
def collect(kit: Kit):
    """Build the stage that repeats the broad phase once points may have moved by half the margin."""
    pairs = collect_pairs(kit)
    near = collect_near(kit)

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        if data.drift[unit] + data.drift[unit] >= model.margin:
            data.overflow[unit] = 0
            pairs(model, data, mesh, pack, lane, unit, dt)
            near(model, data, mesh, pack, lane, unit, dt)
            data.drift[unit] = wp.float64(0.0)

    return stage
