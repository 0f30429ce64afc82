"""The arrays of the kernels: Model (bodies and worlds), Data (state, per environment) and Tape
(gradients, and the values needed to compute them).

The tables below say every array's type, shape and meaning once; structs and allocations follow from them. Shape
symbols: a ``mesh`` is what one pack holds, or several alike; ``point, active, joint, spring, link, rigid, twin,
twin_end, voxel, movable, robot, row, object, cell, action`` are capacities over the meshes of a model; a ``frame`` is a
terrain; ``pack, lane`` number environments (see :mod:`warpvox.kernels.lanes`); ``unit`` is one thread's share of a
pack; ``pair, entry, slot, word`` are capacities of the broad phase; ``pulled`` are points, in exact arithmetic springs.
``2*`` rows hold x and y alternately.
``node, leaf, plot, hit`` are capacities of what keeps the released order of contacts, in exact arithmetic only.

Lanes of a pack may hold different bodies. A mesh lists what some lane has; fields named ``lanes`` are masks, bit k of
an int for lane k of the pack, -1 for all (see :mod:`warpvox.batch.grid_mesh`, also for twins). Not in exact arithmetic.

The arithmetic is ``fast`` or ``exact``; exact repeats every sum and product of the released simulator in its order, in
float64. Four fields mean something else there, because it works on positions where fast works on displacements since
the sub-step's start: ``disp`` is the position, ``stages`` holds velocities and the sums of velocities and paths,
``force`` is that of a spring, and ``spring`` holds equilibrium lengths.
"""

import functools
import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import warp as wp

from warpvox.kernels.device import allocate as device_arrays
from warpvox.kernels.lanes import REALS

REAL = "real"  # the precision of the springs, float32 or float64
STATE = wp.float64

# How a control step of an environment ended (bits).
UNSTABLE, DIVERGED, OVERFLOW = 1, 2, 4
STOPPED = UNSTABLE | DIVERGED
DISTANT = 16  # bit in pairs[2]: voxels of one robot that are no neighbours in its grid
STALE = 1.0e9  # a drift that makes the next sub-step rebuild its candidates
FASTEST = 1.0e4
"""Speed of a point, in units of inner time, above which a simulation counts as diverged.

At this speed a point crosses ten voxels between two looks at contacts: what follows is no simulation of anything. A
fall without end reaches gravity / drag = 1100; benchmark tasks under random and alternating actions stay below 30.
An environment that has diverged is computed until the control step is over and is then undone. It disturbs no other:
lanes meet in the candidates of contacts alone, whose list has room for all pairs where lanes share it.
"""
FARTHEST = 1.0e6
"""Coordinate of a point beyond which a simulation counts as diverged; no terrain extends so far."""
CPP_CONSTANTS = dict(
    UNSTABLE=UNSTABLE, DIVERGED=DIVERGED, OVERFLOW=OVERFLOW, DISTANT=DISTANT, STALE=STALE, FASTEST=FASTEST,
    FARTHEST=FARTHEST,
)  # fmt: skip
"""Constants of this module that the C++ uses, by name."""

Table = dict[str, tuple[Any, str, str]]
"""Arrays by name, each with type, shape and meaning."""

MODEL: Table = {
    "pack_mesh": (int, "pack", "the tables of a pack: those with the dimension ``mesh``"),
    "frame": (int, "mesh", "its terrain"),
    "points": (int, "mesh", "points in use"),
    "actives": (int, "mesh", "points that are free or hang on a spring; all others stay where they are"),
    "active": (int, "mesh 2*active", "their rows, x and y; fast: in the order of `last_spring`"),
    "last_spring": (int, "mesh active", "the last spring that pulls at an active point, -1: none"),
    "springs": (int, "mesh", "springs in use"),
    "rigids": (int, "mesh", "entries of rigid_spring in use"),
    "twins": (int, "mesh", "entries of twin in use"),
    "voxels": (int, "mesh", "surface voxels in use"),
    "robots": (int, "mesh", "robots"),
    "rest_pos": (STATE, "mesh 2*point lane", "position at time 0"),
    "free_lanes": (int, "mesh point", "where the point can move"),
    "twin_range": (wp.vec2i, "mesh point", "entries of twin about the point's grid node: from, to"),
    "twin": (wp.vec2i, "mesh twin", "a point and that whose position it shares in some lanes, its leader"),
    "twin_lanes": (int, "mesh twin", "where it does"),
    "spring_ends": (wp.vec2i, "mesh spring", "the two points"),
    "spring_rest": (STATE, "mesh spring", "rest length"),
    "spring_lanes": (int, "mesh spring", "where there is the spring"),
    "spring_k": (REAL, "mesh spring lane", "stiffness; 0 where there is no spring"),
    "alike": (int, "mesh", "1: springs are as stiff in all lanes"),
    "stiffness": (REAL, "mesh spring", "stiffness in lane 0"),
    "spring_drive": (int, "mesh spring lane", "the one or two actions that drive its length, plus 1, 16 bits each"),
    "link_start": (int, "mesh joint", "where in `link` the springs of a point begin; one entry more than points"),
    "link": (int, "mesh link", "springs of the points, fast: ascending: s where it pulls on, -1 - s where off"),
    "links": (wp.vec4i, "mesh point", "in groups: eight places of 16 bits for the springs of a point"),
    "twin_ends": (int, "mesh", "entries of twin_end in use"),
    "twin_end": (
        wp.vec4i,
        "mesh twin_end",
        "springs, ascending, that pull at a twin of an end: spring, twin, end, lanes",
    ),
    "rigid_spring": (
        int,
        "mesh rigid",
        "sides of rigid voxels in the order of the second strain pass; in groups level by level, the last as -1 - s",
    ),
    "rigid_lanes": (int, "mesh rigid", "where the voxel is rigid and has this side"),
    "corner": (
        wp.vec4i,
        "mesh voxel",
        "points of a surface voxel: top left, top right, bottom right, bottom left",
    ),
    "pushed": (wp.vec4i, "mesh voxel", "the same, -1 where the point is not active: nothing it feels matters"),
    "side_lanes": (wp.vec4i, "mesh voxel", "where its top, right, bottom and left are surface sides"),
    "body": (int, "mesh voxel", "index of its object"),
    "robot": (int, "mesh voxel", "index of its robot, or -1"),
    "grid": (wp.vec2i, "mesh voxel", "column and row in its object"),
    "fixed_voxel": (int, "mesh voxel", "1: none of its corners is active"),
    "movables": (int, "mesh", "entries of `movable` in use"),
    "movable": (int, "mesh movable", "surface voxels that are not in `fixed_at`, in ascending order"),
    "first_other": (int, "mesh", "the surface voxel from which `fixed_at` counts"),
    "fold_limit": (
        int,
        "mesh robot lane",
        "surface voxels of the robot: more folded pairs than these stop the step",
    ),
    "order": (int, "mesh row lane", "points in the order in which observations list them, object by object"),
    "object_range": (wp.vec2i, "mesh object lane", "where the points of an object lie in `order`: from, to"),
    "objects": (int, "mesh", "bodies and terrain; this and the rest about trees only in exact arithmetic"),
    "nodes": (int, "mesh", "nodes of the box trees of bodies; those of terrain come after them in `node`"),
    "node": (
        wp.vec4i,
        "mesh node",
        "children and leaves before the second; of a leaf -1 - its voxel, its rank, object, root",
    ),
    "node_area": (STATE, "mesh node", "area of the box of a terrain node"),
    "leaf": (int, "mesh leaf", "leaf of a surface voxel"),
    "cell_leaf": (int, "mesh plot", "leaf of a surface cell of the terrain"),
    "fixed_at": (int, "frame cell", "the fixed surface voxel in a cell of the terrain lattice, or -1"),
    "terrain": (wp.vec2i, "frame", "columns and rows of the terrain lattice"),
    "terrain_side": (int, "frame cell", "bits of the surface sides; 0: empty or buried cell"),
    "terrain_box": (STATE, "frame cell 4", "left, right, bottom, top of the cell"),
}

# Of these, ``weight`` is the force of gravity on a point and ``inverse_mass`` turns a force into an acceleration.
CONSTANTS = dict.fromkeys(
    ("weight", "inverse_mass", "drag", "strain_limit", "strain_share", "rigid_strain_limit", "rigid_strain_share"), REAL
) | dict.fromkeys(("actuation_rate", "friction", "floor_stiffness", "floor_friction", "margin"), STATE)
# A struct of its own: the contact function is too large to be inlined and is called with as little as it needs.
CONTACT = dict.fromkeys(("stiffness", "depth", "damping", "friction", "friction_multiplier"), STATE)

DATA: Table = {
    "pos": (STATE, "pack 2*point lane", "position"),
    "vel": (STATE, "pack 2*point lane", "velocity of the integrator"),
    "true_vel": (
        STATE,
        "pack 2*point lane",
        "displacement of the last sub-step / dt; within one, from Runge-Kutta to the strain limits, the displacement",
    ),
    "saved_pos": (STATE, "pack 2*point lane", "state at the start of the control step ..."),
    "saved_vel": (STATE, "pack 2*point lane", "... to which a stopped or frozen environment returns"),
    "saved_true_vel": (STATE, "pack 2*point lane", ""),
    "disp": (REAL, "pack 2*point lane", "displacement since the sub-step's start; exact: the position"),
    "start_vel": (REAL, "pack 2*point lane", "velocity at the sub-step's start"),
    "force": (REAL, "pack 2*pulled lane", "force on a point in the last stage; exact: of a spring on its first end"),
    "contact": (REAL, "pack 2*point lane", "contact force, constant during a sub-step"),
    "in_contact": (int, "unit point", "1: `contact` may not be 0 in some lane"),
    "stages": (
        REAL,
        "pack 6*point lane",
        "forces in the first three stages, one after another, then corrections of the strain limit; exact: other sums",
    ),
    "corrected": (int, "unit point", "1: a pass of the strain limits moves the point in some lane"),
    "hits": (int, "pack lane", "contacts met in this sub-step; these and the box trees only in exact arithmetic"),
    "hit": (wp.vec4i, "pack hit lane", "leaves in the order of their objects, 4 x way + corner, point (-1: fixed)"),
    "hit_ends": (wp.vec2i, "pack hit lane", "points of the side"),
    "hit_side": (wp.vec3d, "pack hit lane", "vector of the side, and depth of the corner under it"),
    "hit_key": (wp.int64, "pack hit lane", "place in the released order, ascending"),
    "hit_rank": (int, "pack hit lane", "the contact with that key"),
    "node_box": (STATE, "pack 4*node lane", "bounds of the nodes of bodies, as box"),
    "goal": (STATE, "pack spring lane", "length toward which that of a spring relaxes"),
    "spring": (
        REAL,
        "pack 4*spring lane",
        "at the sub-step's start: vector, 1 / length^2, force density; exact: equilibrium lengths",
    ),
    "box": (STATE, "pack 4*voxel lane", "bounds of surface voxels: x min, x max, y min, y max"),
    "action": (STATE, "pack action lane", "clipped actions"),
    "folds": (int, "pack robot lane", "overlapping pairs of distant voxels, both orders"),
    "frozen": (int, "pack lane", "1: keeps its state"),
    "status": (int, "pack lane", "bits UNSTABLE, DIVERGED, OVERFLOW of the last control step"),
    "time": (int, "pack lane", "complete control steps since the reset"),
    "drift": (STATE, "unit", "bound of every point's path since the candidates were collected"),
    "pairs": (
        wp.vec4i,
        "unit pair",
        "candidate voxels i < j, and which corners of i (of j) may come to be in the other",
    ),
    "pair_count": (int, "unit", ""),
    "touching": (int, "unit", "lanes in which the corner of a candidate that was found last is in the other voxel"),
    "near": (int, "unit voxel", "voxels that may touch terrain"),
    "near_count": (int, "unit", ""),
    "near_box": (STATE, "pack 4*voxel lane", "bounds of the terrain cells that a near voxel may touch, as box"),
    "overflow": (int, "unit", "1: more candidates than capacity"),
    "hull": (STATE, "unit 4*movable", "boxes of movable voxels around all lanes; in groups in float32"),
    "pair_bit": (int, "unit word", "candidate matrix, a bit per pair"),
    "grid_head": (int, "unit slot", "first entry of a hash slot, or -1"),
    "grid_next": (int, "unit entry", "next entry of the same slot, or -1"),
    "grid_voxel": (int, "unit entry", "the voxel of an entry"),
}

TAPE = {
    "pos": (REAL, "pack 2*trail lane", "position at the start of each sub-step, and after the last one"),
    "vel": (REAL, "pack 2*trail lane", "velocity, likewise"),
    "contact": (
        REAL,
        "pack 6*trail lane",
        "derivatives of the contact force with terrain: x by x, x by y, y by x, y by y, x and y by true velocity",
    ),
    "substeps": (int, "unit", "sub-steps on the tape"),
    "by_pos": (REAL, "pack 2*point lane", "derivative of a loss by the position, at the end, later at the start ..."),
    "by_vel": (REAL, "pack 2*point lane", "... by the velocity of the integrator"),
    "by_true_vel": (REAL, "pack 2*point lane", "... by the displacement of the last sub-step / dt"),
    "by_goal": (REAL, "pack spring lane", "... by the lengths toward which springs relax, over all sub-steps"),
    "by_action": (REAL, "pack action lane", "... by the clipped actions"),
    "by_force": (REAL, "pack 10*point lane", "... by the forces of the four stages, then by their sum"),
    "product": (REAL, "pack 2*point lane", "a matrix of all springs times a vector"),
    "spring": (
        REAL,
        "pack 6*spring lane",
        "unit vector halfway, stiffness or share of a correction, force density, unit vector at the start",
    ),
}
"""Arrays of the reverse pass (:mod:`warpvox.kernels.reverse`); ``trail`` has points times sub-steps plus 1 entries."""


def rows(shape: str, sizes: dict[str, int]) -> tuple[int, ...]:
    """Return the size of each axis of a symbolic shape such as 'pack 2*point lane'; at least 1, as Warp needs."""

    return tuple([max(factor * sizes[name] if name else factor, 1) for factor, name in _axes(shape)])


@functools.cache
def _axes(shape: str) -> list[tuple[int, str]]:
    """Parse a symbolic shape into (factor, symbol) for each axis; an empty symbol stands for a number."""
    axes = []
    for term in shape.split():
        factor, _, name = term.rpartition("*")
        axes.append((int(name), "") if name.isdigit() else (int(factor or 1), name))
    return axes


@functools.cache
def structs(precision: str) -> SimpleNamespace:
    """Create the Warp structs ``Model``, ``Data``, ``Tape`` and ``Contact`` (contact constants) for a precision."""
    real = REALS[precision]

    def struct(name, table, scalars):
        fields = {k: wp.array(dtype=real if t is REAL else t, ndim=len(s.split())) for k, (t, s, _) in table.items()}
        fields.update({k: real if t is REAL else t for k, t in scalars.items()})
        return wp.struct(type(f"{name}_{precision}", (), {"__annotations__": fields, "__module__": __name__}))

    contact = struct("Contact", {}, CONTACT)
    model = struct("Model", MODEL, CONSTANTS | {"contact": contact})
    tape = struct("Tape", TAPE, {"smoothing": REAL})
    return SimpleNamespace(Model=model, Data=struct("Data", DATA, {}), Tape=tape, Contact=contact)


def bytes_of(table: Table, sizes: dict[str, int], precision: str) -> int:
    """Return the memory of a table's arrays in bytes."""
    real = REALS[precision]
    return sum(
        math.prod(rows(shape, sizes)) * wp.types.type_size_in_bytes(real if kind is REAL else kind)
        for kind, shape, _ in table.values()
    )


def allocate(table: Table, sizes: dict[str, int], precision: str, device: str) -> Mapping[str, wp.array]:
    """Allocate zeros for all fields of a table, by name."""
    real = REALS[precision]
    kinds = {name: (rows(shape, sizes), real if kind is REAL else kind) for name, (kind, shape, _) in table.items()}
    return device_arrays(kinds, device)
