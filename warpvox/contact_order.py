"""Contact order of the released simulator: it descends a tree of bounding boxes over the surface voxels of an object.

Forces on a point are sums, and sums round by their order. The released simulator finds pairs of surface voxels by
descending two such trees at once; their shape follows from areas of boxes at the beginning, equal ones being told
apart by rounding and by the order of hash sets of its C++ library. Both are rebuilt here, for exact
arithmetic alone.
"""

import heapq
import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from warpvox.errors import SimulationError

DEEPEST = 40
"""Largest sum of the depths of two trees that fits a sort key (``PATH`` of ``kernels/exact/order.py``)."""
MOST_OBJECTS = 1024  # whose pairs fit into the 20 bits above the path

# Bucket counts of the library's hash tables, each the first of its prime list that at least doubles the last: enough
# for the cells of the largest world.
BUCKETS = (1, 13, 29, 59, 127, 257, 541, 1109, 2357, 5087, 10273, 20753, 42043, 85229, 172933, 351061, 712697, 1447153)
_SIDE = {(-1, 0): 1, (0, 1): 2, (1, 0): 4, (0, -1): 8}
"""Bit of ``Body.linked`` for the neighbour in each direction (row, column)."""


class HashSet:
    """A set of integers that iterates in the order of libstdc++'s ``unordered_set<int>``.

    A number comes to the front of its bucket (itself modulo the count of buckets), a new bucket to the front of all;
    a full table puts its numbers, in their order, into a larger one.
    """

    def __init__(self) -> None:
        self._count = 0
        self._size = 0  # the place in BUCKETS of ...
        self._modulus = 1  # ... how many buckets there are
        self._buckets: dict[int, dict[int, None]] = {}  # they, and the numbers in each, from the last to the first

    def __iter__(self):
        return itertools.chain.from_iterable(map(reversed, reversed(self._buckets.values())))

    def __len__(self) -> int:
        return self._count

    def __contains__(self, number: int) -> bool:
        return number in self._buckets.get(number % self._modulus, ())

    def add(self, number: int) -> None:
        """Add a number; a full table is rehashed into a larger one."""
        if number in self._buckets.get(number % self._modulus, ()):
            return
        if self._count == self._modulus or not self._size:  # full; the first bucket is never used
            before = list(self)
            self._size += 1
            self._modulus = BUCKETS[self._size]
            self._buckets = {}
            for other in before:
                self._buckets.setdefault(other % self._modulus, {})[other] = None
        self._count += 1
        self._buckets.setdefault(number % self._modulus, {})[number] = None

    def discard(self, number: int) -> None:
        """Remove a number if the set contains it."""
        place = number % self._modulus
        bucket = self._buckets.get(place)
        if bucket is not None and number in bucket:
            self._count -= 1
            del bucket[number]
            if not bucket:
                del self._buckets[place]


@dataclass
class _Tree:
    """A binary tree of bounding boxes: children come before their parents, and the root is the last node.

    ``cells``: (row, column) of a leaf, None for others; ``children``: the two of an inner node, None for a leaf;
    ``boxes``: left, bottom, right, top at the beginning.
    """

    cells: list[tuple[int, int] | None] = field(default_factory=list)
    children: list[tuple[int, int] | None] = field(default_factory=list)
    boxes: list[tuple[float, float, float, float]] = field(default_factory=list)

    def add(self, cell, children, box) -> int:
        self.cells.append(cell)
        self.children.append(children)
        self.boxes.append(box)
        return len(self.cells) - 1

    def ranks(self) -> tuple[list[int], list[int]]:
        """Count, for every node, the leaves before its first child and before its second child.

        Leaves are counted from first to second children.
        """
        count = [1] * len(self.cells)
        for node, pair in enumerate(self.children):
            if pair:
                count[node] = count[pair[0]] + count[pair[1]]
        begin = [0] * len(self.cells)
        for node in reversed(range(len(self.cells))):
            if pair := self.children[node]:
                first, second = pair
                begin[first], begin[second] = begin[node], begin[node] + count[first]
        middle = [b + count[pair[0]] if pair else b for b, pair in zip(begin, self.children, strict=True)]
        return begin, middle

    def depth(self) -> int:
        """Count the levels below the root."""
        level = [0] * len(self.cells)
        for node in reversed(range(len(self.cells))):
            for child in self.children[node] or ():
                level[child] = level[node] + 1
        return max(level, default=0)


def tree_of(body) -> _Tree:
    """Build the tree of bounding boxes over a mesh (:class:`warpvox.compile.Body`), as the released simulator does."""
    number = {cell: n for n, cell in enumerate(body.corners)}
    surface = HashSet()
    for cell in body.surface:
        surface.add(number[cell])
    cells = list(body.corners)
    tree = _Tree()
    node_of = {}
    for n in surface:
        points = [body.points[p] for p in body.corners[cells[n]]]
        xs, ys = zip(*points, strict=True)
        node_of[cells[n]] = tree.add(cells[n], None, (min(xs), min(ys), max(xs), max(ys)))
    near = [_neighbours(body, cell, node_of) for cell in tree.cells]
    _merge(tree, near)
    return tree


def _neighbours(body, cell, node_of: dict) -> HashSet:
    """Return the tree nodes of the surface voxels connected to a cell, or diagonal ones if none is connected."""
    found = HashSet()
    cardinal = ((-1, 0), (1, 0), (0, -1), (0, 1))  # row and column: top, bottom, left, right
    diagonal = ((-1, -1), (-1, 1), (1, -1), (1, 1))
    for steps in (cardinal, diagonal):
        if not len(found):
            for dy, dx in steps:
                other = (cell[0] + dy, cell[1] + dx)
                if other in node_of and _connected(body, cell, dy, dx):
                    found.add(node_of[other])
    return found


def _connected(body, cell, dy: int, dx: int) -> bool:
    """Return whether the cell at offset (dy, dx) is connected to ``cell``, directly or through a cell beside both."""
    bits = body.linked
    if dy == 0 or dx == 0:
        return bool(bits[cell] & _SIDE[dy, dx])
    row, column = cell
    over_row = bits[cell] & _SIDE[dy, 0] and bits[row + dy, column] & _SIDE[0, dx]
    over_column = bits[cell] & _SIDE[0, dx] and bits[row, column + dx] & _SIDE[dy, 0]
    return bool(over_row or over_column)


def _merge(tree: _Tree, near: list[HashSet]) -> None:
    """Merge the pair of nodes with the smallest common box until one node is left; neighbouring voxels merge first.

    Of equals the first node is joined, with the first of its neighbours. A diagonal neighbour need not know of it, so
    sets may hold nodes that have been joined.
    """
    boxes = tree.boxes
    open_nodes = dict.fromkeys(range(len(tree.cells)))  # in ascending order
    have_neighbours = True
    # Sizes of the smallest common boxes, or less: a size grows, unseen here, when the other node is joined.
    queue: list[tuple[float, int]] = []

    def smallest(node: int) -> tuple[float, int]:
        """Return the area of the smallest box around ``node`` and another unmerged node, and that other node."""
        left, bottom, right, top = boxes[node]
        least = math.inf
        chosen = node
        for other in near[node] if have_neighbours else open_nodes:
            if other in open_nodes and other != node:
                # the area of the union, without a call: most of the time goes here
                box = boxes[other]
                width = (right if right > box[2] else box[2]) - (left if left < box[0] else box[0])
                height = (top if top > box[3] else box[3]) - (bottom if bottom < box[1] else box[1])
                if width * height < least:
                    least = width * height
                    chosen = other
        return least, chosen

    def enqueue(nodes: Iterable[int]) -> None:
        for node in nodes:
            heapq.heappush(queue, (smallest(node)[0], node))

    enqueue(open_nodes)
    while len(open_nodes) > 1:
        expected, a = heapq.heappop(queue)
        if a not in open_nodes:
            continue
        size, b = smallest(a)
        if size > expected:
            heapq.heappush(queue, (size, a))
            continue
        if size == math.inf:
            have_neighbours = False
            queue.clear()
            enqueue(open_nodes)
            continue
        first = boxes[a]
        second = boxes[b]
        low = min(first[0], second[0]), min(first[1], second[1])
        high = max(first[2], second[2]), max(first[3], second[3])
        merged = tree.add(None, (a, b), low + high)
        around = HashSet()
        for node in [*near[a], *near[b]]:
            around.add(node)
        around.discard(a)
        around.discard(b)
        for node in around:
            near[node].discard(a)
            near[node].discard(b)
            near[node].add(merged)
        near.append(around)
        del open_nodes[a], open_nodes[b]
        open_nodes[merged] = None
        enqueue([*around, merged])


def order_arrays(design) -> dict[str, np.ndarray]:
    """Make the Model's arrays of box trees for a compiled world: movable objects, then terrain.

    Raises:
        SimulationError: the world has more objects, or objects of deeper trees, than a contact's place in the order
            can tell apart.
    """
    objects = design.bodies + design.statics
    tables = [body.table(_tree_table) for body in objects]
    _check_places(design, {body.name: table.depth for body, table in zip(objects, tables, strict=True)})
    ordered = sorted((body.source for body in objects), key=lambda source: (not source.is_robot, source.name))
    place = {source.name: number for number, source in enumerate(ordered)}

    nodes = []
    leaf = []
    cell_leaf = np.zeros(design.width * design.height, dtype=np.int32)
    base = voxel = moving = 0
    for number, (body, table) in enumerate(zip(objects, tables, strict=True)):
        # Nodes count on from those of the objects before.
        node = table.node.copy()
        node[table.inner, :2] += base
        node[~table.inner, 2] = place[body.name]
        node[~table.inner, 3] += base
        leaves = table.leaves
        if number < len(design.bodies):
            node[leaves, 0] = -1 - np.arange(voxel, voxel + len(leaves))
            leaf.append(leaves + base)
            voxel += len(leaves)
            moving = base + len(node)
        else:
            source = body.source
            rows, columns = table.cells.T
            at = (source.y + source.height - 1 - rows) * design.width + source.x + columns
            cell_leaf[at] = leaves + base
        nodes.append(node)
        base += len(node)
    return dict(
        objects=np.array(len(objects), np.int32),
        nodes=np.array(moving, np.int32),
        node=np.concatenate(nodes),
        node_area=np.concatenate([table.area for table in tables]),
        leaf=np.concatenate(leaf, dtype=np.int32, casting="same_kind"),
        cell_leaf=cell_leaf,
    )


class _TreeTable(NamedTuple):
    """The box tree of one object as arrays; indices begin at 0.

    Attributes:
        node: int32 ``[nodes, 4]`` as in the Model; of leaves the first entry is -1 and the object 0.
        inner: bool ``[nodes]``: nodes that are no leaves.
        area: ``[nodes]``: of their boxes.
        leaves: int32 ``[voxels]``: the nodes of the surface voxels.
        cells: int ``[voxels, 2]``: row and column of these.
        depth: levels below the root.
    """

    node: np.ndarray
    inner: np.ndarray
    area: np.ndarray
    leaves: np.ndarray
    cells: np.ndarray
    depth: int


def _tree_table(body) -> _TreeTable:
    """Build the tree of bounding boxes over a mesh, as arrays."""
    tree = tree_of(body)
    rank, middle = tree.ranks()
    root = len(tree.cells) - 1
    rows = []
    leaf_of = {}
    for n, pair in enumerate(tree.children):
        if pair:
            rows.append((*pair, middle[n], 0))
        else:
            rows.append((-1, rank[n], 0, root))
            leaf_of[tree.cells[n]] = n
    return _TreeTable(
        node=np.array(rows, np.int32),
        inner=np.array([pair is not None for pair in tree.children]),
        area=np.array([(right - left) * (top - bottom) for left, bottom, right, top in tree.boxes]),
        leaves=np.array([leaf_of[cell] for cell in body.surface], np.int32),
        cells=np.array(list(body.surface)),
        depth=tree.depth(),
    )


def _check_places(design, depth: dict[str, int]) -> None:
    """Raise SimulationError if the sort keys have too few bits for these objects or tree depths."""
    remedy = "arithmetic='fast' does not keep this order and has no such limit."
    if len(depth) > MOST_OBJECTS:
        raise SimulationError(
            f"Exact arithmetic keeps the released order of contacts for up to {MOST_OBJECTS} objects; this world has"
            f" {len(depth)}. {remedy}"
        )
    body = max((b.name for b in design.bodies), key=depth.__getitem__)  # one of the two objects of a contact can move
    other = max(depth, key=depth.__getitem__)
    if depth[body] + depth[other] > DEEPEST:
        raise SimulationError(
            f"Exact arithmetic keeps the released order of contacts for box trees of up to {DEEPEST} levels together;"
            f" those of {body!r:.80} ({depth[body]}) and {other!r:.80} ({depth[other]}) are deeper. {remedy}"
        )


def no_order() -> dict[str, np.ndarray]:
    """Return empty box trees (size 1), for simulations that do not reproduce the contact order."""
    one = np.zeros(1, dtype=np.int32)
    return dict(objects=one[0], nodes=one[0], node=one.reshape(1, 1).repeat(4, 1), node_area=np.zeros(1),
                leaf=one, cell_leaf=one)  # fmt: skip
