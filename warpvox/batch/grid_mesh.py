"""Meshes of robots that share a pack: one table of points and springs for all its lanes, with lane masks.

A pack advances its lanes by the same instructions, so they need the same indices even where their bodies differ. All
bodies of a pack lie on one grid of cells. Its tables hold every point, spring and voxel that some lane has; masks, an
int with a bit for each lane, say which lanes.

Cells around a grid node share one point where they are connected around it, else they have points of their own (two
cells that touch at a corner only). Lanes differ in this, too. So the cells around a node are spread over as many points
as some lane needs, and where a lane has fewer, its points there are *twins*: they have the same position and velocity,
and each feels the forces on all of them, in the same order, so that they never part.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpvox.types import VOXEL, Cell, Physics
from warpvox.world import WorldObject

# The cells around a node, in the order in which a mesh is made: above left, above right, below left, below right.
ABOVE_LEFT, ABOVE_RIGHT, BELOW_LEFT, BELOW_RIGHT = range(4)
# For the corners of a cell (top left, top right, bottom right, bottom left): its place among the cells around that
# node, and the node's row and column from the cell's.
CORNER_PLACE = (BELOW_RIGHT, BELOW_LEFT, ABOVE_LEFT, ABOVE_RIGHT)
CORNER_NODE = ((0, 0), (0, 1), (1, 1), (1, 0))
# The order in which a cell makes its corners, as ranks of top left, top right, bottom right, bottom left.
CREATION_RANK = (0, 1, 3, 2)
DIAGONAL = (VOXEL * VOXEL + VOXEL * VOXEL) ** 0.5
TWIN_PAIRS = ((1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2))
NOBODY = -1


@dataclass
class RobotBodies:
    """The bodies of one robot, an entry each, on the smallest common grid (lower left corners together).

    Attributes:
        cells: int8 ``[bodies, rows, columns]``; ``right``, ``down``: bool, same shape, connections with the right and
            the lower neighbour; ``height``: int ``[bodies]``, rows of each.
    """

    cells: np.ndarray
    right: np.ndarray
    down: np.ndarray
    height: np.ndarray

    @classmethod
    def of(cls, robots: Sequence[WorldObject], grid: tuple[int, int] = (1, 1)) -> RobotBodies:
        """Bodies of objects, on a grid of at least ``(rows, columns)``."""
        rows = max(grid[0], *(robot.height for robot in robots))
        columns = max(grid[1], *(robot.width for robot in robots))
        shape = (len(robots), rows, columns)
        cells, right, down = np.zeros(shape, np.int8), np.zeros(shape, bool), np.zeros(shape, bool)
        for n, robot in enumerate(robots):
            top = rows - robot.height
            cells[n, top:, : robot.width] = robot.grid
            a, b = robot.connections.T
            row, column = np.divmod(a, robot.width)
            beside = b - a == 1 if robot.width > 1 else np.zeros(len(a), bool)
            right[n, row[beside] + top, column[beside]] = True
            down[n, row[~beside] + top, column[~beside]] = True
        return cls(cells, right, down, np.array([robot.height for robot in robots]))

    def split_nodes(self) -> np.ndarray:
        """bool ``[bodies, nodes]``: inner grid nodes where two cells touch without being connected."""
        filled = self.cells != 0
        a, b, c, d = filled[:, :-1, :-1], filled[:, :-1, 1:], filled[:, 1:, :-1], filled[:, 1:, 1:]
        split = (a & d & ~b & ~c) | (b & c & ~a & ~d)
        cut = (a & b & ~self.right[:, :-1, :-1]) | (c & d & ~self.right[:, 1:, :-1])
        cut |= (a & c & ~self.down[:, :-1, :-1]) | (b & d & ~self.down[:, :-1, 1:])
        return (split | cut).reshape(len(filled), -1)

    def join(self, other: RobotBodies) -> RobotBodies:
        """These bodies and others on a grid of the same size."""
        pairs = [(getattr(self, name), getattr(other, name)) for name in ("cells", "right", "down", "height")]
        return RobotBodies(*(np.concatenate(pair) for pair in pairs))

    def take(self, kept: np.ndarray) -> RobotBodies:
        """Those of them that are ``kept``, bool ``[bodies]``."""
        return RobotBodies(self.cells[kept], self.right[kept], self.down[kept], self.height[kept])


def most_points(rows: int, columns: int, cut: bool = False) -> int:
    """The most points that a body on a grid may have: inner nodes may hold two; four where connections are ``cut``."""
    if cut:
        return 4 * rows * columns
    return (rows + 1) * (columns + 1) + (rows - 1) * (columns - 1)


def pack_bits(lanes: np.ndarray) -> np.ndarray:
    """int32 ``[...]`` from bool ``[..., lanes]``: bit k speaks of lane k; -1 where all lanes are set."""
    width = lanes.shape[-1]
    padded = np.zeros((*lanes.shape[:-1], 32), bool)
    padded[..., :width] = lanes
    padded[..., width:] = lanes.all(-1, keepdims=True)
    return np.packbits(padded, axis=-1, bitorder="little").view("<i4")[..., 0].astype(np.int32)


@dataclass(frozen=True)
class _Springs:
    """Every spring that some body on a grid may have, in a fixed order; index arrays of one entry a spring.

    A side between two cells stands twice: as ``first`` of the cell above (left of) it and as that of the cell below
    (right of) it. They are one where the cells share their corners, and two where they do not.
    """

    cell: np.ndarray  # the cell whose corners it runs between; -1: outside the grid
    other: np.ndarray  # the cell on the other side of a side, -1: none
    second: np.ndarray  # bool: the side as the lower (right) cell has it
    across: np.ndarray  # bool: a side that horizontal actuators drive (top or bottom)
    side: np.ndarray  # bool: a side, not a diagonal
    node: np.ndarray  # [springs, 2]
    place: np.ndarray  # [springs, 2]: the place of ``cell`` around those nodes
    rest: np.ndarray
    twin: np.ndarray  # the other entry of the same side; itself for diagonals
    at_node: np.ndarray  # [nodes, 12]: springs that may end at a node, ascending, then -1: none
    end_at_node: np.ndarray  # [nodes, 12]: 0 where it begins there, 1 where it ends there
    of_cell: np.ndarray  # [cells, 6]: sides of a cell: top (as first, second), right, bottom, left (as first, second)


@functools.lru_cache(maxsize=64)
def _springs(rows: int, columns: int) -> _Springs:
    def cell(r: int, c: int) -> int:
        return r * columns + c if 0 <= r < rows and 0 <= c < columns else NOBODY

    def node(r: int, c: int) -> int:
        return r * (columns + 1) + c

    made: list[tuple] = []
    index: dict[tuple, int] = {}
    for r in range(rows + 1):
        for c in range(columns + 1):  # node by node, the springs that begin there
            here = node(r, c)
            if c < columns:
                above, below, ends = cell(r - 1, c), cell(r, c), (here, node(r, c + 1))
                index["across", r, c] = len(made)
                made.append((above, below, False, True, True, ends, (ABOVE_RIGHT, ABOVE_LEFT), VOXEL))
                made.append((below, above, True, True, True, ends, (BELOW_RIGHT, BELOW_LEFT), VOXEL))
            if r == rows:
                continue
            left, right, ends = cell(r, c - 1), cell(r, c), (here, node(r + 1, c))
            index["upright", r, c] = len(made)
            made.append((left, right, False, False, True, ends, (BELOW_LEFT, ABOVE_LEFT), VOXEL))
            made.append((right, left, True, False, True, ends, (BELOW_RIGHT, ABOVE_RIGHT), VOXEL))
            falling, rising = (BELOW_RIGHT, ABOVE_LEFT), (BELOW_LEFT, ABOVE_RIGHT)
            for inside, to, places in ((right, c + 1, falling), (left, c - 1, rising)):
                if inside != NOBODY:
                    made.append((inside, NOBODY, False, False, False, (here, node(r + 1, to)), places, DIAGONAL))
    fields = [np.array(column) for column in zip(*made, strict=True)]
    twin = np.arange(len(made))
    for first in index.values():
        twin[first], twin[first + 1] = first + 1, first
    at_node = np.full(((rows + 1) * (columns + 1), 12), NOBODY)
    end_at = np.zeros_like(at_node)
    taken = np.zeros(len(at_node), int)
    for s, ends in enumerate(fields[5]):
        for end, n in enumerate(ends):
            at_node[n, taken[n]], end_at[n, taken[n]] = s, end
            taken[n] += 1
    of_cell = np.array(
        [
            [
                index["across", r, c], index["across", r, c] + 1, index["upright", r, c + 1],
                index["across", r + 1, c], index["upright", r, c], index["upright", r, c] + 1,
            ]
            for r in range(rows)
            for c in range(columns)
        ]
    )  # fmt: skip
    return _Springs(*fields, twin=twin, at_node=at_node, end_at_node=end_at, of_cell=of_cell)


class GridMesh:
    """The mesh of one robot in all lanes of packs: what some lane may have, with bool arrays over lanes.

    The rows of arrays number what the grid may have at most: ``node * 4 + slot`` for points, the springs of
    :func:`_springs`, cells row by row. :mod:`warpvox.batch.packs` leaves out what no lane of a pack has.

    Args:
        index: numbers of the bodies that packs hold, ``[packs, lanes]``.
        place: cell of the lower left corner of their common grid.

    Attributes (P packs, L lanes, S points, E springs, V cells):
        grid: int8 ``[P, rows, columns, L]``, row 0 on top; ``right``, ``down``: as of :class:`RobotBodies`, same shape.
        point: bool ``[P, S, L]``, points there are; ``free``: that can move; ``leader``: int8 ``[P, S, L]``, the slot
            that stands for a point's twins (its own where it is that).
        position: float64 ``[P, nodes, 2, L]``.
        spring, ends, rest, stiffness, drive: bool ``[P, E, L]``; ``[P, E, 2]``; ``[E]``; ``[P, E, L]``; int
            ``[P, E, 2, L]``: the one or two actions that drive a spring, else -1.
        link: bool ``[P, S, 12, L]``: springs ``springs.at_node`` that pull at a point.
        rigid: bool ``[P, V, 6, L]``: sides ``springs.of_cell`` of rigid cells.
        corner: int ``[P, V, 4]``: points of a cell: top left, top right, bottom right, bottom left.
        side: bool ``[P, V, 4, L]``: surface sides: top, right, bottom, left.
        order: int ``[P, L, S]``: points in the order in which an observation lists them, then -1; ``count``: how many.
        actions: int ``[P, L]``.
    """

    def __init__(self, bodies: RobotBodies, index: np.ndarray, place: tuple[int, int], physics: Physics) -> None:
        parts = (bodies.cells, bodies.right, bodies.down)
        self.grid, self.right, self.down = (np.moveaxis(part[index], 1, -1) for part in parts)
        self.height, self.place, self.physics = bodies.height[index], place, physics
        packs, self.rows, self.columns, lanes = self.grid.shape
        self.springs = _springs(self.rows, self.columns)
        self.cells = self.grid.reshape(packs, -1, lanes)
        self.filled = self.cells != Cell.EMPTY
        self._share_points()
        self._number_points()
        self._place_springs()
        self._link_springs()
        self._mark_surface()

    def _around(self, values: np.ndarray) -> list[np.ndarray]:
        """``[P, nodes, L]`` of the four cells around every node, from ``[P, rows, columns, L]``."""
        padded = np.pad(values, ((0, 0), (1, 1), (1, 1), (0, 0)))
        parts = padded[:, :-1, :-1], padded[:, :-1, 1:], padded[:, 1:, :-1], padded[:, 1:, 1:]
        return [part.reshape(len(part), -1, part.shape[-1]) for part in parts]

    def _share_points(self) -> None:
        """``owner`` [4, P, nodes, L]: which of the cells around a node has made the point that a cell has there."""
        there = self._around(self.grid != Cell.EMPTY)
        right, down = self._around(self.right), self._around(self.down)
        top, bottom = right[ABOVE_LEFT], right[BELOW_LEFT]  # connections between the cells around a node
        left, side = down[ABOVE_LEFT], down[ABOVE_RIGHT]
        a = np.zeros(top.shape, np.int8)
        b = np.where(top, a, ABOVE_RIGHT)
        # The rule of paper section A.1 as released: of several connected cells the last one looked at counts.
        c = np.where((left & top) | (bottom & side), b, np.where(left, a, BELOW_LEFT))
        d = np.where((side & top) | (bottom & left), a, np.where(bottom, c, np.where(side, b, BELOW_RIGHT)))
        self.owner = np.stack([np.where(t, made, NOBODY) for t, made in zip(there, (a, b, c, d), strict=True)])
        self.slot = _spread(self.owner)

    def _number_points(self) -> None:
        owner, slot = self.owner, self.slot
        packs, nodes, lanes = owner.shape[1:]
        used = np.full((packs, nodes, 4, lanes), NOBODY, np.int8)  # whose point a slot holds
        for place in range(4):
            for s in range(4):
                mine = (slot[place] == s)[..., None] & (owner[place] >= 0)
                used[:, :, s] = np.where(mine, owner[place], used[:, :, s])
        self.used = used
        leader = np.broadcast_to(np.arange(4, dtype=np.int8)[:, None], used.shape).copy()
        for s, t in reversed(TWIN_PAIRS):  # the lowest slot of a point is looked at last
            same = (used[:, :, s] == used[:, :, t]) & (used[:, :, s] >= 0)
            leader[:, :, s] = np.where(same, t, leader[:, :, s])
        fixed_cell = self._around(self.grid == Cell.FIXED)
        fixed = np.zeros(used.shape, bool)
        for place in range(4):
            fixed |= (fixed_cell[place][:, :, None] & (owner[place][:, :, None] == used)) & (used >= 0)
        shape = (packs, nodes * 4, lanes)
        self.leader = leader.reshape(shape)
        self.point: np.ndarray = (used >= 0).reshape(shape)
        self.fixed = fixed.reshape(shape)
        row, column = np.divmod(np.arange(nodes), self.columns + 1)
        x = self.place[0] * VOXEL + column * VOXEL
        # Exactly these expressions: the last bit of a coordinate decides which touching voxels are in contact.
        own_row = row[None, :, None] - (self.rows - self.height[:, None, :])
        y = (self.place[1] * VOXEL + self.height[:, None, :] * VOXEL) - own_row * VOXEL
        self.position = np.stack([np.broadcast_to(x[None, :, None], y.shape), y], axis=2)
        self._order_points(used, row, column)

    def _order_points(self, used: np.ndarray, row: np.ndarray, column: np.ndarray) -> None:
        """Points by the cell that made them and its corner; a point counts once, as its leader."""
        packs, nodes, _, lanes = used.shape
        # The cell at a place around a node, and the rank of that corner among those it makes.
        rank = np.array([CREATION_RANK[CORNER_PLACE.index(place)] for place in range(4)])
        above = np.array([1, 1, 0, 0])
        leftward = np.array([1, 0, 1, 0])
        key = 4 * ((row[:, None] - above) * (self.columns + 1) + column[:, None] - leftward) + rank
        key = key + 4 * (self.columns + 3)  # so that none is negative
        chosen = (used >= 0) & (self.leader.reshape(used.shape) == np.arange(4)[:, None])
        keys = np.where(chosen, np.take_along_axis(key[None, :, :, None], np.maximum(used, 0), axis=2), 1 << 30)
        keys = keys.reshape(packs, nodes * 4, lanes).transpose(0, 2, 1)
        self.count = (keys < 1 << 30).sum(-1)
        most = int(self.count.max())
        order = np.argsort(keys, axis=-1, kind="stable")[..., :most]
        self.order = np.where(np.arange(most) < self.count[..., None], order, NOBODY)

    def _of(self, values: np.ndarray, cells: np.ndarray, empty: int) -> np.ndarray:
        """Values [P, V, L] of the cells of springs; ``empty`` where there is none."""
        out = values[:, np.maximum(cells, 0)]
        return np.where((cells >= 0)[None, :, None], out, empty)

    def _place_springs(self) -> None:
        springs = self.springs
        has = self._of(self.filled, springs.cell, False)
        met = self._of(self.filled, springs.other, False)
        joined = np.where(springs.across[:, None], *(self._joined(axis) for axis in ("down", "right")))
        slots = self.slot[springs.place, :, springs.node]  # [E, 2, P]
        slots = slots.transpose(2, 0, 1)
        self.ends = springs.node * 4 + np.maximum(slots, 0)
        # Both entries of a side run between the same points in this pack.
        same = ((slots == slots[:, springs.twin]) & (slots >= 0)).all(-1)[..., None]
        second, side = springs.second[:, None], springs.side[:, None]
        as_second = has & ~joined & (met | ~same)
        as_first = has | (met & same)
        self.spring = np.where(side, np.where(second, as_second, as_first), has)
        # The cells that have a part in a spring: its own, and the other where the side is common to both.
        other = np.where(second | ~side, False, met & (joined | ~has))
        kinds = self._of(self.cells, springs.cell, Cell.EMPTY), self._of(self.cells, springs.other, Cell.EMPTY)
        self.stiffness = self._stiffness(kinds, has, other)
        driven = np.where(springs.across, int(Cell.H_ACT), int(Cell.V_ACT))[:, None]
        number = np.cumsum(np.isin(self.cells, (int(Cell.H_ACT), int(Cell.V_ACT))), axis=1) - 1
        self.actions = number[:, -1] + 1
        numbers = self._of(number, springs.cell, NOBODY), self._of(number, springs.other, NOBODY)
        one, two = (
            np.where(part & side & (kind == driven) & self.spring, n, NOBODY)
            for part, kind, n in zip((has, other), kinds, numbers, strict=True)
        )
        self.drive = np.stack([np.where(one >= 0, one, two), np.where(one >= 0, two, NOBODY)], axis=2)
        # Whose point a spring holds at each end.
        owners = self.owner.transpose(1, 2, 0, 3)  # [P, nodes, 4, L]
        mine = owners[:, springs.node, springs.place]  # [P, E, 2, L]
        others = mine[:, springs.twin]
        self.held = np.where(has[:, :, None], mine, np.where(side[:, None], others, NOBODY))
        rigid = self.cells == Cell.RIGID
        take_first = joined | (~met & same)  # for the lower (right) cell of a side
        parts = []
        for k, spring in enumerate(springs.of_cell.T):
            if k in (0, 4):  # top and left, as the upper (left) cell has them
                parts.append(rigid & take_first[:, spring + 1])
            elif k in (1, 5):
                parts.append(rigid & ~take_first[:, spring])
            else:
                parts.append(rigid)
        self.rigid = np.stack(parts, axis=2)
        self._drop_fixed()

    def _joined(self, axis: str) -> np.ndarray:
        """bool [P, E, L]: the two cells of a side are connected."""
        springs = self.springs
        first = np.where(springs.second, springs.other, springs.cell)  # the upper or left one
        links = getattr(self, axis).reshape(self.cells.shape)
        return self._of(links, first, False)

    def _stiffness(self, kinds, has: np.ndarray, other: np.ndarray) -> np.ndarray:
        physics, springs = self.physics, self.springs
        table = np.array([physics.stiffness(cell) for cell in range(len(Cell))])
        main = [table[kind, 0] for kind in kinds]
        upper = np.where(springs.second[:, None], False, True)
        if physics.shared_edge == "stiffest":
            k = np.maximum(np.where(has, main[0], 0.0), np.where(other, main[1], 0.0))
        else:  # the last soft or actuator voxel sets it; rigid ones never do
            k = np.full(has.shape, physics.rigid_main)
            for kind, value, part in ((kinds[0], main[0], has), (kinds[1], main[1], other & upper)):
                k = np.where(part & (kind != Cell.RIGID) & (kind != Cell.FIXED), value, k)
        k = np.where(springs.side[:, None], k, table[kinds[0], 1])
        return np.where(self.spring, k, 0.0)

    def _drop_fixed(self) -> None:
        """Springs between two fixed points are always at rest, unless they are driven: no force, no strain."""
        fixed = [np.take_along_axis(self.fixed, self.ends[:, :, end, None], axis=1) for end in (0, 1)]
        at_rest = self.spring & fixed[0] & fixed[1] & (self.drive == NOBODY).all(axis=2)
        self.free = self.point & ~self.fixed
        if at_rest.any():
            self.spring = self.spring & ~at_rest
            self.stiffness = np.where(at_rest, 0.0, self.stiffness)
            self.rigid = self.rigid & ~at_rest[:, self.springs.of_cell]

    def _link_springs(self) -> None:
        springs = self.springs
        packs, _, lanes = self.point.shape
        at, end = springs.at_node, springs.end_at_node
        there = (self.spring[:, at] & (at >= 0)[None, :, :, None])[:, :, None]  # [P, nodes, 1, 12, L]
        held = self.held[:, at, end][:, :, None]
        used = self.used[:, :, :, None]  # [P, nodes, 4, 1, L]
        link = there & (held == used) & (used >= 0)
        self.link = link.reshape(packs, -1, at.shape[1], lanes)

    def _mark_surface(self) -> None:
        right, down = self.right, self.down
        top = np.zeros_like(down)
        top[:, 1:] = down[:, :-1]
        left = np.zeros_like(right)
        left[:, :, 1:] = right[:, :, :-1]
        sides = np.stack([~top, ~right, ~down, ~left], axis=3)  # [P, rows, columns, 4, L]
        packs, lanes = len(right), right.shape[-1]
        self.side = sides.reshape(packs, -1, 4, lanes) & self.filled[:, :, None]
        row, column = np.divmod(np.arange(self.cells.shape[1]), self.columns)
        node = np.stack([(row + r) * (self.columns + 1) + column + c for r, c in CORNER_NODE], axis=-1)
        slots = self.slot[list(CORNER_PLACE), :, node].transpose(2, 0, 1)  # [P, V, 4]
        self.corner = node * 4 + np.maximum(slots, 0)


def _spread(owner: np.ndarray) -> np.ndarray:
    """int8 [4, P, nodes]: on which of a node's points each of the cells around it lies; -1: no lane has that cell.

    Cells that have different points in some lane lie on different ones. Two rows of cells on a point each are tried
    first, as this doubles the fewest springs, then two columns.
    """

    def apart(a: int, b: int) -> np.ndarray:
        return ((owner[a] != owner[b]) & (owner[a] >= 0) & (owner[b] >= 0)).any(-1)

    a, b, c, d = range(4)
    conflict = {pair: apart(*pair) for pair in ((a, b), (c, d), (a, c), (b, d), (a, d), (b, c))}
    one = ~np.any(list(conflict.values()), axis=0)
    by_rows = ~one & ~conflict[a, b] & ~conflict[c, d]
    by_columns = ~one & ~by_rows & ~conflict[a, c] & ~conflict[b, d]
    each = ~one & ~by_rows & ~by_columns
    slots = []
    for place in range(4):
        slot = np.zeros(one.shape, np.int8)
        slot[by_rows] = place // 2
        slot[by_columns] = place % 2
        slot[each] = place
        slot[~(owner[place] >= 0).any(-1)] = NOBODY
        slots.append(slot)
    return np.stack(slots)
