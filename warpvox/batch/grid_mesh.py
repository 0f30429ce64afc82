"""Meshes of robots that share a pack: one table of points and springs, with a mask of lanes for each entry.

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

from warpvox.types import ACTUATORS, VOXEL, Cell, Physics
from warpvox.world import WorldObject

ABOVE_LEFT, ABOVE_RIGHT, BELOW_LEFT, BELOW_RIGHT = range(4)
"""Indices of the four cells around a grid node, in meshing order."""
TWIN_PAIRS = ((1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2))
"""Pairs of point slots at a node, (twin, leader), that may hold the same point."""
NOBODY = -1
"""Index that stands for a missing cell, point or action."""


@dataclass
class RobotBodies:
    """The distinct bodies of one robot on their smallest common grid, aligned at the lower left corner.

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
        """Collect the bodies of these objects on one grid of at least ``grid`` (rows, columns)."""
        height = np.array([robot.height for robot in robots])
        rows = max(grid[0], height.max())
        columns = max(grid[1], *(robot.width for robot in robots))
        shape = (len(robots), rows, columns)
        cells = np.zeros(shape, np.int8)
        right = np.zeros(shape, bool)
        down = np.zeros(shape, bool)
        for n, robot in enumerate(robots):
            top = rows - robot.height
            cells[n, top:, : robot.width] = robot.grid

            # Connections: the second cell is the right neighbour of the first, or the one below it.
            first, second = robot.connections.T
            row, column = np.divmod(first, robot.width)
            beside = (second == first + 1) & (robot.width > 1)
            right[n, row[beside] + top, column[beside]] = True
            down[n, row[~beside] + top, column[~beside]] = True
        return cls(cells, right, down, height)

    def split_nodes(self) -> np.ndarray:
        """Find the inner grid nodes where two cells touch without being connected, bool ``[bodies, nodes]``."""
        # The four cells around each inner node, bool [bodies, rows - 1, columns - 1]
        filled = self.cells != 0
        above_left = filled[:, :-1, :-1]
        above_right = filled[:, :-1, 1:]
        below_left = filled[:, 1:, :-1]
        below_right = filled[:, 1:, 1:]

        # Two cells that touch at their corners only
        split = above_left & below_right & ~above_right & ~below_left
        split |= above_right & below_left & ~above_left & ~below_right

        # Two cells side by side, or one above the other, without a connection
        split |= above_left & above_right & ~self.right[:, :-1, :-1]
        split |= below_left & below_right & ~self.right[:, 1:, :-1]
        split |= above_left & below_left & ~self.down[:, :-1, :-1]
        split |= above_right & below_right & ~self.down[:, :-1, 1:]
        return split.reshape(len(filled), -1)

    def join(self, other: RobotBodies) -> RobotBodies:
        """Append bodies that lie on a grid of the same size."""
        return RobotBodies(
            np.concatenate([self.cells, other.cells]),
            np.concatenate([self.right, other.right]),
            np.concatenate([self.down, other.down]),
            np.concatenate([self.height, other.height]),
        )

    def take(self, kept: np.ndarray) -> RobotBodies:
        """Select the bodies where the mask ``kept``, bool ``[bodies]``, is True."""
        return RobotBodies(self.cells[kept], self.right[kept], self.down[kept], self.height[kept])


def most_points(rows: int, columns: int, cut: bool = False) -> int:
    """Return the largest number of points of a body on a grid; ``cut``: neighbours may be unconnected.

    An inner node then holds up to four points, else two.
    """
    if cut:
        return 4 * rows * columns
    return (rows + 1) * (columns + 1) + (rows - 1) * (columns - 1)


def pack_bits(lanes: np.ndarray) -> np.ndarray:
    """Pack bool ``[..., lanes]`` into bit masks, int32 ``[...]``: bit k is lane k; -1 where all lanes are True."""
    width = lanes.shape[-1]
    padded = np.zeros((*lanes.shape[:-1], 32), bool)
    padded[..., :width] = lanes
    padded[..., width:] = lanes.all(-1, keepdims=True)
    return np.packbits(padded, axis=-1, bitorder="little").view("<i4")[..., 0].astype(np.int32)


@dataclass(frozen=True)
class _Springs:
    """All springs that a body on a grid may have, in a fixed order, as arrays with an entry for each.

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
    """List the springs of a grid of cells."""

    def cell(row: int, column: int) -> int:
        inside = 0 <= row < rows and 0 <= column < columns
        return row * columns + column if inside else NOBODY

    def node(row: int, column: int) -> int:
        return row * (columns + 1) + column

    # Node by node, the springs that begin there: cell, other, second, across, side, ends, places of the cell, rest
    made: list[tuple] = []
    across: dict[tuple[int, int], int] = {}  # node -> the first spring of the side to the right
    upright: dict[tuple[int, int], int] = {}  # node -> the first spring of the side downwards
    diagonal = (VOXEL * VOXEL + VOXEL * VOXEL) ** 0.5
    for r in range(rows + 1):
        for c in range(columns + 1):
            begin = node(r, c)
            below_right = cell(r, c)
            if c < columns:
                above = cell(r - 1, c)
                ends = (begin, node(r, c + 1))
                across[r, c] = len(made)
                made.append((above, below_right, False, True, True, ends, (ABOVE_RIGHT, ABOVE_LEFT), VOXEL))
                made.append((below_right, above, True, True, True, ends, (BELOW_RIGHT, BELOW_LEFT), VOXEL))
            if r < rows:
                left = cell(r, c - 1)
                ends = (begin, node(r + 1, c))
                upright[r, c] = len(made)
                made.append((left, below_right, False, False, True, ends, (BELOW_LEFT, ABOVE_LEFT), VOXEL))
                made.append((below_right, left, True, False, True, ends, (BELOW_RIGHT, ABOVE_RIGHT), VOXEL))
                if below_right != NOBODY:
                    ends = (begin, node(r + 1, c + 1))
                    places = (BELOW_RIGHT, ABOVE_LEFT)
                    made.append((below_right, NOBODY, False, False, False, ends, places, diagonal))
                if left != NOBODY:
                    ends = (begin, node(r + 1, c - 1))
                    places = (BELOW_LEFT, ABOVE_RIGHT)
                    made.append((left, NOBODY, False, False, False, ends, places, diagonal))
    fields = [np.array(column) for column in zip(*made, strict=True)]

    # The two entries of a side
    twin = np.arange(len(made))
    for first in [*across.values(), *upright.values()]:
        twin[first] = first + 1
        twin[first + 1] = first

    # Node by node, the springs that end there, and with which end
    at_node = np.full(((rows + 1) * (columns + 1), 12), NOBODY)
    end_at_node = np.zeros_like(at_node)
    taken = np.zeros(len(at_node), int)
    for spring, ends in enumerate(fields[5]):
        for end, n in enumerate(ends):
            at_node[n, taken[n]] = spring
            end_at_node[n, taken[n]] = end
            taken[n] += 1

    # Cell by cell, its sides
    of_cell = []
    for r in range(rows):
        for c in range(columns):
            top = across[r, c]
            left = upright[r, c]
            of_cell.append([top, top + 1, upright[r, c + 1], across[r + 1, c], left, left + 1])
    return _Springs(*fields, twin=twin, at_node=at_node, end_at_node=end_at_node, of_cell=np.array(of_cell))


class GridMesh:
    """The mesh of one robot in all lanes of the packs: all points and springs of the grid, with masks of lanes.

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
        self.grid = np.moveaxis(bodies.cells[index], 1, -1)
        self.right = np.moveaxis(bodies.right[index], 1, -1)
        self.down = np.moveaxis(bodies.down[index], 1, -1)
        self.height = bodies.height[index]
        self.place = place
        self.physics = physics
        packs, self.rows, self.columns, lanes = self.grid.shape
        self.springs = _springs(self.rows, self.columns)
        self.cells = self.grid.reshape(packs, -1, lanes)
        self.filled = self.cells != Cell.EMPTY
        self._share_points()
        self._number_points()
        self._place_springs()
        self._link_springs()
        self._mark_surface()

    def _four_cells_around(self, values: np.ndarray) -> list[np.ndarray]:
        """Return the values of the four cells around every node, ``[P, nodes, L]`` each."""
        padded = np.pad(values, ((0, 0), (1, 1), (1, 1), (0, 0)))
        parts = padded[:, :-1, :-1], padded[:, :-1, 1:], padded[:, 1:, :-1], padded[:, 1:, 1:]
        return [part.reshape(len(part), -1, part.shape[-1]) for part in parts]

    def _share_points(self) -> None:
        """Find the cell that creates each cell's corner point: ``owner`` ``[4, P, nodes, L]``."""
        filled = self._four_cells_around(self.grid != Cell.EMPTY)

        # Connections between the four cells
        right = self._four_cells_around(self.right)
        down = self._four_cells_around(self.down)
        above = right[ABOVE_LEFT]  # of the two above
        below = right[BELOW_LEFT]
        left = down[ABOVE_LEFT]
        beside = down[ABOVE_RIGHT]  # of the two on the right

        # The rule of paper section A.1 as released: of several connected cells the last one looked at counts.
        first = np.full(above.shape, ABOVE_LEFT, np.int8)
        second = np.where(above, first, ABOVE_RIGHT)
        third = np.where(left, first, BELOW_LEFT)
        third = np.where((left & above) | (below & beside), second, third)
        fourth = np.where(beside, second, BELOW_RIGHT)
        fourth = np.where(below, third, fourth)
        fourth = np.where((beside & above) | (below & left), first, fourth)

        owners = []
        for is_filled, owner in zip(filled, (first, second, third, fourth), strict=True):
            owners.append(np.where(is_filled, owner, NOBODY))
        self.owner = np.stack(owners)
        self.slot = _choose_slots(self.owner)

    def _number_points(self) -> None:
        """Decide which points exist, which lead and which are fixed, and set their positions."""
        packs, nodes, lanes = self.owner.shape[1:]

        # Whose point each slot of a node holds
        used = np.full((packs, nodes, 4, lanes), NOBODY, np.int8)
        for slot, owner in zip(self.slot, self.owner, strict=True):
            for s in range(4):
                here = (slot == s)[..., None] & (owner >= 0)
                used[:, :, s] = np.where(here, owner, used[:, :, s])
        self.used = used

        # Slots that hold one point follow the lowest of them, which is looked at last.
        leader = np.broadcast_to(np.arange(4, dtype=np.int8)[:, None], used.shape).copy()
        for twin, lower in reversed(TWIN_PAIRS):
            same = (used[:, :, twin] == used[:, :, lower]) & (used[:, :, twin] >= 0)
            leader[:, :, twin] = np.where(same, lower, leader[:, :, twin])

        # Points of fixed cells
        fixed = np.zeros(used.shape, bool)
        for is_fixed, owner in zip(self._four_cells_around(self.grid == Cell.FIXED), self.owner, strict=True):
            fixed |= is_fixed[:, :, None] & (owner[:, :, None] == used) & (used >= 0)

        shape = (packs, nodes * 4, lanes)
        self.leader = leader.reshape(shape)
        self.point: np.ndarray = (used >= 0).reshape(shape)
        self.fixed = fixed.reshape(shape)

        # Where the nodes lie
        row, column = np.divmod(np.arange(nodes), self.columns + 1)
        x = self.place[0] * VOXEL + column * VOXEL
        # Exactly these expressions: the last bit of a coordinate decides which touching voxels are in contact.
        own_row = row[None, :, None] - (self.rows - self.height[:, None, :])
        y = (self.place[1] * VOXEL + self.height[:, None, :] * VOXEL) - own_row * VOXEL
        self.position = np.stack([np.broadcast_to(x[None, :, None], y.shape), y], axis=2)
        self._order_points(used, row, column)

    def _order_points(self, used: np.ndarray, row: np.ndarray, column: np.ndarray) -> None:
        """Sort the points by the cell and corner that created them into ``order`` and ``count``."""
        packs, nodes, _, lanes = used.shape

        # The key of the four cells around each node, int [nodes, 4]: the cell's number on a grid with a border, and
        # when it makes this corner: top left, top right, bottom left, bottom right.
        above = np.array([1, 1, 0, 0])
        leftward = np.array([1, 0, 1, 0])
        rank = np.array([3, 2, 1, 0])
        cell = (row[:, None] + 1 - above) * (self.columns + 1) + column[:, None] + 2 - leftward
        key = 4 * cell + rank

        # The keys of points; the largest number where there is none
        none = 1 << 30
        chosen = (used >= 0) & (self.leader.reshape(used.shape) == np.arange(4)[:, None])
        keys = np.take_along_axis(key[None, :, :, None], np.maximum(used, 0), axis=2)
        keys = np.where(chosen, keys, none)
        keys = keys.reshape(packs, nodes * 4, lanes).transpose(0, 2, 1)

        self.count = (keys < none).sum(-1)
        most = int(self.count.max())
        order = np.argsort(keys, axis=-1, kind="stable")[..., :most]
        self.order = np.where(np.arange(most) < self.count[..., None], order, NOBODY)

    def _gather(self, values: np.ndarray, cells: np.ndarray, empty: int) -> np.ndarray:
        """Look up the values of ``cells`` in ``values`` [P, V, L]; ``empty`` where the cell index is -1."""
        out = values[:, np.maximum(cells, 0)]
        return np.where((cells >= 0)[None, :, None], out, empty)

    def _place_springs(self) -> None:
        """Decide which springs exist; set ends, stiffness, actions, pulled points and rigid sides."""
        springs = self.springs

        # Bool [P, E, L]: whether the spring's own cell exists, whether the cell beside it does, and both are connected
        has_cell = self._gather(self.filled, springs.cell, False)
        has_other = self._gather(self.filled, springs.other, False)
        joined = np.where(springs.across[:, None], self._connected_sides(self.down), self._connected_sides(self.right))

        # The points it runs between; whether both entries of a side run between the same ones in this pack
        slots = self.slot[springs.place, :, springs.node]  # [E, 2, P]
        slots = slots.transpose(2, 0, 1)
        self.ends = springs.node * 4 + np.maximum(slots, 0)
        same = ((slots == slots[:, springs.twin]) & (slots >= 0)).all(-1)[..., None]

        # Whether there is this spring
        second = springs.second[:, None]
        side = springs.side[:, None]
        as_second = has_cell & ~joined & (has_other | ~same)
        as_first = has_cell | (has_other & same)
        self.spring = np.where(side, np.where(second, as_second, as_first), has_cell)

        # The cells that determine the stiffness: the own one, and the other one if both share this side
        shared = np.where(second | ~side, False, has_other & (joined | ~has_cell))
        kind = self._gather(self.cells, springs.cell, Cell.EMPTY)
        other_kind = self._gather(self.cells, springs.other, Cell.EMPTY)
        self.stiffness = self._stiffness(kind, other_kind, has_cell, shared)

        # The actions that drive a spring: those of its cells that are actuators along it
        number = np.cumsum(np.isin(self.cells, ACTUATORS), axis=1) - 1
        self.actions = number[:, -1] + 1
        actuator = np.where(springs.across, int(Cell.H_ACT), int(Cell.V_ACT))[:, None]
        drives = has_cell & side & (kind == actuator) & self.spring
        other_drives = shared & side & (other_kind == actuator) & self.spring
        action = np.where(drives, self._gather(number, springs.cell, NOBODY), NOBODY)
        other_action = np.where(other_drives, self._gather(number, springs.other, NOBODY), NOBODY)
        one = np.where(action >= 0, action, other_action)
        two = np.where(action >= 0, other_action, NOBODY)
        self.drive = np.stack([one, two], axis=2)

        # Whose point it holds at each end
        owners = self.owner.transpose(1, 2, 0, 3)  # [P, nodes, 4, L]
        own = owners[:, springs.node, springs.place]  # [P, E, 2, L]
        others = own[:, springs.twin]
        self.held = np.where(has_cell[:, :, None], own, np.where(side[:, None], others, NOBODY))

        # The sides of rigid cells. Top and left, which may stand twice: where the lower (right) cell of a side shares
        # it, it has the first entry.
        rigid = self.cells == Cell.RIGID
        takes_first = joined | (~has_other & same)
        takes_top = takes_first[:, springs.of_cell[:, 1]]
        takes_left = takes_first[:, springs.of_cell[:, 5]]
        parts = [rigid & takes_top, rigid & ~takes_top, rigid, rigid, rigid & takes_left, rigid & ~takes_left]
        self.rigid = np.stack(parts, axis=2)
        self._drop_fixed()

    def _connected_sides(self, connections: np.ndarray) -> np.ndarray:
        """Return a mask of the sides between two connected cells, bool [P, E, L]."""
        springs = self.springs
        first = np.where(springs.second, springs.other, springs.cell)  # the upper or left one
        return self._gather(connections.reshape(self.cells.shape), first, False)

    def _stiffness(
        self, kind: np.ndarray, other_kind: np.ndarray, has_cell: np.ndarray, shared: np.ndarray
    ) -> np.ndarray:
        """Compute spring stiffness [P, E, L] by the preset's rule for shared sides; 0 where no spring exists."""
        table = np.array([self.physics.stiffness(cell) for cell in Cell])  # of sides, of diagonals
        own = table[kind, 0]
        other = table[other_kind, 0]
        if self.physics.shared_edge == "stiffest":
            stiffness = np.maximum(np.where(has_cell, own, 0.0), np.where(shared, other, 0.0))
        else:  # the last soft or actuator voxel sets it; rigid ones never do
            hard = (Cell.RIGID, Cell.FIXED)
            last = shared & ~self.springs.second[:, None]
            stiffness = np.full(has_cell.shape, self.physics.rigid_main)
            stiffness = np.where(has_cell & ~np.isin(kind, hard), own, stiffness)
            stiffness = np.where(last & ~np.isin(other_kind, hard), other, stiffness)
        stiffness = np.where(self.springs.side[:, None], stiffness, table[kind, 1])
        return np.where(self.spring, stiffness, 0.0)

    def _drop_fixed(self) -> None:
        """Remove springs between two fixed points that no action drives, as they exert no force."""
        begins_fixed = np.take_along_axis(self.fixed, self.ends[:, :, 0, None], axis=1)
        ends_fixed = np.take_along_axis(self.fixed, self.ends[:, :, 1, None], axis=1)
        at_rest = self.spring & begins_fixed & ends_fixed & (self.drive == NOBODY).all(axis=2)
        self.free = self.point & ~self.fixed
        if at_rest.any():
            self.spring = self.spring & ~at_rest
            self.stiffness = np.where(at_rest, 0.0, self.stiffness)
            self.rigid = self.rigid & ~at_rest[:, self.springs.of_cell]

    def _link_springs(self) -> None:
        """List the springs at each point in ``link``."""
        packs, _, lanes = self.point.shape
        at_node = self.springs.at_node
        has_spring = self.spring[:, at_node] & (at_node >= 0)[None, :, :, None]  # [P, nodes, 12, L]
        held = self.held[:, at_node, self.springs.end_at_node]
        used = self.used[:, :, :, None]  # [P, nodes, 4, 1, L]
        link = has_spring[:, :, None] & (held[:, :, None] == used) & (used >= 0)
        self.link = link.reshape(packs, -1, 12, lanes)

    def _mark_surface(self) -> None:
        """Find the surface sides and the corner points of each cell: ``side`` and ``corner``."""
        packs, _, lanes = self.cells.shape

        # Sides at which a cell is not connected
        top = np.zeros_like(self.down)
        top[:, 1:] = self.down[:, :-1]
        left = np.zeros_like(self.right)
        left[:, :, 1:] = self.right[:, :, :-1]
        sides = np.stack([~top, ~self.right, ~self.down, ~left], axis=3)  # [P, rows, columns, 4, L]
        self.side = sides.reshape(packs, -1, 4, lanes) & self.filled[:, :, None]

        # The nodes at the corners, and the place of the cell around each
        row, column = np.divmod(np.arange(self.cells.shape[1]), self.columns)
        top_left = row * (self.columns + 1) + column
        bottom_left = top_left + self.columns + 1
        node = np.stack([top_left, top_left + 1, bottom_left + 1, bottom_left], axis=-1)  # [V, 4]
        places = [BELOW_RIGHT, BELOW_LEFT, ABOVE_LEFT, ABOVE_RIGHT]
        slots = self.slot[places, :, node].transpose(2, 0, 1)  # [P, V, 4]
        self.corner = node * 4 + np.maximum(slots, 0)


def _choose_slots(owner: np.ndarray) -> np.ndarray:
    """Choose the point slot of each cell around a node, int8 [4, P, nodes]; -1 where no lane has the cell.

    Cells that have different points in some lane lie on different ones. Two rows of cells on a point each are tried
    first, as this doubles the fewest springs, then two columns.
    """

    def apart(a: int, b: int) -> np.ndarray:
        """Return the nodes at which cells a and b have different points in some lane."""
        return ((owner[a] != owner[b]) & (owner[a] >= 0) & (owner[b] >= 0)).any(-1)

    # Which neighbours need points of their own, bool [P, nodes]
    beside = apart(ABOVE_LEFT, ABOVE_RIGHT) | apart(BELOW_LEFT, BELOW_RIGHT)
    stacked = apart(ABOVE_LEFT, BELOW_LEFT) | apart(ABOVE_RIGHT, BELOW_RIGHT)
    across = apart(ABOVE_LEFT, BELOW_RIGHT) | apart(ABOVE_RIGHT, BELOW_LEFT)

    one = ~(beside | stacked | across)
    by_rows = ~one & ~beside
    by_columns = ~one & ~by_rows & ~stacked
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
