"""Reverse pass of a control step in fast arithmetic: from the gradient of a loss at the end of the step to the
gradients with respect to the state at its start and to its actions.

The control step is done again with the state at the start of each sub-step written to a
:data:`warpvox.kernels.state.TAPE`, which is then read from its end. A corner of a voxel that enters the terrain is
pushed at once with 0.5 % of a voxel times the stiffness (section A.3, depth additive), so that a body at rest is held
by a rapid series of pushes. Their exact derivative says nothing of the mean force. Contact with terrain therefore has
the derivative of a push that sets in gradually, over a ``smoothing`` of height. Contacts between voxels, and corners of
the terrain inside a voxel, have derivative 0.
"""

import functools

import warp as wp

from warpvox.kernels.broadphase import boxes, collect, on_lattice
from warpvox.kernels.contact import contacts, surface_sides
from warpvox.kernels.device import kernel, record
from warpvox.kernels.kit import Kit, builder, kit_of
from warpvox.kernels.reset import save
from warpvox.kernels.springs import goals, limit, runge_kutta
from warpvox.types import VOXEL

REACH = 30.0
"""Height above a side, in units of the smoothing length, beyond which a point has no contact."""

real = wp.float64


@builder
def soften(kit: Kit):
    """Build a function that adds the gradients of one smoothed contact of a point ``height`` above a side of terrain.

    The push sets in as (1 - z / sqrt(z^2 + 4)) / 2 with z = height / smoothing. ``level`` 1: a floor or a ceiling, 0: a
    wall; ``sign`` 1 where the height grows with the coordinate, -1 where it falls.
    """
    number = kit.real

    @kit.func
    def add(model, data, tape, pack, k, p, row, height: real, level, sign: real):
        """Add or subtract one contact's derivatives by height and by velocity in ``tape.contact``."""
        z = height / real(tape.smoothing)
        if z < real(REACH):
            over, law = real(1.0) / wp.sqrt(z * z + real(4.0)), model.contact
            share = real(0.5) - real(0.5) * z * over
            growth = real(2.0) / real(tape.smoothing) * over * over * over  # of the share, for each unit of depth
            slip = data.true_vel[pack, 2 * p + 1 - level, k]
            first = 6 * row
            # The normal force by the height; friction, viscous at small slip, by the height; both by the velocity.
            normal, rubbing = first + 3 * level, first + 2 - level
            damping, friction = first + 4 + level, first + 5 - level
            push = law.stiffness * (law.depth * growth + share)
            rub = law.friction_multiplier * slip * growth * sign
            tape.contact[pack, normal, k] = tape.contact[pack, normal, k] - number(push)
            tape.contact[pack, rubbing, k] = tape.contact[pack, rubbing, k] + number(rub)
            tape.contact[pack, damping, k] = tape.contact[pack, damping, k] - number(law.damping * share)
            tape.contact[pack, friction, k] = tape.contact[pack, friction, k] - number(law.friction_multiplier * share)

    return add


@wp.func
def sides_at(sides: wp.array2d(dtype=int), size: wp.vec2i, frame: int, x: int, y: int):
    """Return the surface sides of a terrain cell as bits; 0 outside the lattice."""
    if x < 0 or x >= size[0] or y < 0 or y >= size[1]:
        return 0
    return sides[frame, y * size[0] + x]


@builder
def ground(kit: Kit):
    """Build a function that computes the gradients of terrain contacts at the start of the last recorded sub-step.

    Every corner of a voxel counts, as in :mod:`warpvox.kernels.contact`.
    """
    add = soften(kit)
    width = kit.width

    @kit.func
    def above(model, frame, cell, n, x: real, y: real):
        """Return a point's height above side n of a cell (clockwise from the top); negative inside the cell."""
        height = y - model.terrain_box[frame, cell, 3]
        if n == 1:
            height = x - model.terrain_box[frame, cell, 1]
        if n == 2:
            height = model.terrain_box[frame, cell, 2] - y
        if n == 3:
            height = model.terrain_box[frame, cell, 0] - x
        return height

    @kit.func
    def nearest(model, frame, cell, bits, x: real, y: real):
        """Return the surface side closest to a point in the cell."""
        found, highest = int(0), real(-VOXEL)
        for n in range(int(4)):
            height = above(model, frame, cell, n, x, y)
            if ((bits >> n) & 1) == 1 and height > highest:
                found = n
                highest = height
        return found

    @kit.func
    def touch(model, data, tape, frame, pack, k, p, row, cell, n, x: real, y: real):
        """Add the derivatives of the contact of point p with side n of a cell."""
        sign = wp.where(n < 2, real(1.0), real(-1.0))
        add(model, data, tape, pack, k, p, row, above(model, frame, cell, n, x, y), 1 - (n & 1), sign)

    @kit.func
    def point(model, data, tape, mesh, pack, k, p, row):
        """Add the gradients of point p's contacts in lane k with its terrain cell, or with the cells beside it."""
        x, y, frame = data.pos[pack, 2 * p, k], data.pos[pack, 2 * p + 1, k], model.frame[mesh]
        if not on_lattice(x, x, y, y):
            return
        size = model.terrain[frame]
        cx, cy = int(wp.floor(x * real(1.0 / VOXEL))), int(wp.floor(y * real(1.0 / VOXEL)))
        bits = sides_at(model.terrain_side, size, frame, cx, cy)
        if bits != 0:
            cell = cy * size[0] + cx
            n = nearest(model, frame, cell, bits, x, y)
            touch(model, data, tape, frame, pack, k, p, row, cell, n, x, y)
            return
        for n in range(int(4)):  # side n of the cell on the other side of it
            nx = cx + wp.where(n == 3, 1, 0) - wp.where(n == 1, 1, 0)
            ny = cy + wp.where(n == 2, 1, 0) - wp.where(n == 0, 1, 0)
            if ((sides_at(model.terrain_side, size, frame, nx, ny) >> n) & 1) == 1:
                touch(model, data, tape, frame, pack, k, p, row, ny * size[0] + nx, n, x, y)

    @kit.func
    def all_near(model, data, tape, mesh, pack, lane, unit):
        """Add the gradients of all corners of voxels near terrain, lane by lane."""
        first = (tape.substeps[unit] - 1) * model.points[mesh]
        for n in range(data.near_count[unit]):
            v = data.near[unit, n]
            for c in range(int(4)):
                p = model.corner[mesh, v][c]
                for k in range(lane, lane + int(width)):
                    if surface_sides(model.side_lanes, mesh, v, k) != 0:
                        point(model, data, tape, mesh, pack, k, p, first + p)

    return all_near


@functools.cache
def reverse_kernel(precision: str, width: int) -> wp.Kernel:
    """Build the kernel of a control step with its reverse pass; launch it over (packs, units of a pack).

    ``first_pack`` is the first pack of a launch.
    """
    kit = kit_of(precision, width)
    begin = save(kit)
    set_goals = goals(kit)
    bounds = boxes(kit)
    candidates = collect(kit)
    contact = contacts(kit)
    motion = runge_kutta(kit)
    strain = limit(kit)
    contact_derivatives = ground(kit)

    @kit.func_native("native/record.h")
    def keep(model, data, tape, mesh, pack, lane, unit): ...

    @kit.func_native("native/springs.h", "native/fold_twins.h", "native/reverse.h")
    def go_back(model, data, tape, mesh, pack, lane, unit, dt): ...

    @kit.func_native("native/reverse_goals.h")
    def by_actions(model, tape, mesh, pack, lane, unit): ...

    @kernel
    def reverse_step(
        model: kit.Model, data: kit.Data, tape: kit.Tape, units: int, first_pack: int, substeps: int, dt: wp.float64
    ):
        """Do one unit's control step while keeping all states, then propagate gradients back to its start."""
        row, part = wp.tid()
        pack = first_pack + row
        lane = part * width
        unit = pack * units + part
        mesh = model.pack_mesh[pack]
        tape.substeps[unit] = 0
        begin(model, data, mesh, pack, lane, unit, dt)
        set_goals(model, data, mesh, pack, lane, unit, dt)
        for _ in range(substeps):
            bounds(model, data, mesh, pack, lane, unit, dt)
            candidates(model, data, mesh, pack, lane, unit, dt)
            contact(model, data, mesh, pack, lane, unit, dt)
            keep(model, data, tape, mesh, pack, lane, unit)
            contact_derivatives(model, data, tape, mesh, pack, lane, unit)
            motion(model, data, mesh, pack, lane, unit, dt)
            strain(model, data, mesh, pack, lane, unit, dt)
        keep(model, data, tape, mesh, pack, lane, unit)
        go_back(model, data, tape, mesh, pack, lane, unit, dt)
        by_actions(model, tape, mesh, pack, lane, unit)

    return reverse_step


def record_reverse(state, tape, substeps: int, first: int, packs: int):
    """Record a control step with its reverse pass, for the packs ``first`` to ``first + packs``.

    It leaves the state at the end of the step. ``tape`` is the struct; the caller has written the derivatives by that
    state into its ``by_pos``, ``by_vel`` and ``by_true_vel``, which then hold those by the state at the start.
    """
    inputs = [state.model, state.data, tape, state.units, first, substeps, state.dt]
    return record(reverse_kernel(state.precision, state.width), (packs, state.units), inputs, state.device)
