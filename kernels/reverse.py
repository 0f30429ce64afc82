"""Derivatives of a control step by its actions and the state at its start: the reverse pass (fast arithmetic).

The control step is done again, with the state at the start of every sub-step on a :data:`warpvox.kernels.state.TAPE`,
which is then gone through from its end. Contacts make this a choice. A point that touches the ground is at once pushed
with 0.5 % of a voxel's worth of stiffness (section A.3, depth additive): a body on the ground is kept there by a
hail of such kicks, of which the derivative knows nothing. Instead, contact
with terrain has the derivative of a push that sets in gradually, over a ``smoothing`` of height. Contacts of voxels with each
other, and corners of terrain in a voxel, have none.
"""

import functools

import warp as wp

from warpvox.kernels.broadphase import boxes, collect, on_lattice
from warpvox.kernels.contact import contacts
from warpvox.kernels.device import kernel, record
from warpvox.kernels.kit import Kit, builder, kit_of
from warpvox.kernels.reset import save
from warpvox.kernels.springs import goals, limit, runge_kutta
from warpvox.kernels.state import BOTTOM, LEFT, RIGHT, TOP
from warpvox.types import VOXEL

__all__ = ["record_reverse"]

REACH = 30.0
"""Smoothings: the height beyond which the ground is not felt any more."""

real = wp.float64


@builder
def soften(kit: Kit):
    """Function: add the derivatives of the contact of a point at ``height`` above a side of terrain.

    The push sets in as (1 - z / sqrt(z^2 + 4)) / 2 with z = height / smoothing. ``level`` 1: a floor or a ceiling, 0: a
    wall; ``sign`` 1 where the height grows with the coordinate, -1 where it falls.
    """
    number = kit.real

    @kit.func
    def add(model, data, tape, pack, k, p, row, height: real, level, sign: real):
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
    """Bits of the surface sides of a terrain cell, 0 beyond the lattice."""
    if x < 0 or x >= size[0] or y < 0 or y >= size[1]:
        return 0
    return sides[frame, y * size[0] + x]


@builder
def ground(kit: Kit):
    """Function: derivatives of contacts with terrain at the start of the sub-step recorded last.

    Every corner of a voxel counts, as in :mod:`warpvox.kernels.contact`.
    """
    add, width = soften(kit), kit.width

    @kit.func
    def side(model, data, tape, frame, pack, k, p, row, cell, bit):
        """The contact with one side of a cell."""
        x, y = data.pos[pack, 2 * p, k], data.pos[pack, 2 * p + 1, k]
        if bit == TOP:
            add(model, data, tape, pack, k, p, row, y - model.terrain_box[frame, cell, 3], 1, real(1.0))
        elif bit == BOTTOM:
            add(model, data, tape, pack, k, p, row, model.terrain_box[frame, cell, 2] - y, 1, real(-1.0))
        elif bit == RIGHT:
            add(model, data, tape, pack, k, p, row, x - model.terrain_box[frame, cell, 1], 0, real(1.0))
        elif bit == LEFT:
            add(model, data, tape, pack, k, p, row, model.terrain_box[frame, cell, 0] - x, 0, real(-1.0))

    @kit.func
    def nearest_side(model, frame, cell, bits, x: real, y: real):
        """Of the surface sides of a cell the one under which a point in it is least deep."""
        found, least = int(0), real(VOXEL)
        for n in range(int(4)):
            if (bits & (1 << n)) != 0:
                depth = model.terrain_box[frame, cell, 3] - y
                if n == 1:
                    depth = model.terrain_box[frame, cell, 1] - x
                if n == 2:
                    depth = y - model.terrain_box[frame, cell, 2]
                if n == 3:
                    depth = x - model.terrain_box[frame, cell, 0]
                if depth < least:
                    found, least = 1 << n, depth
        return found

    @kit.func
    def point(model, data, tape, mesh, pack, k, p, row):
        """The contacts of a point in one lane: with the cell that it is in, or with those about it."""
        x, y, frame = data.pos[pack, 2 * p, k], data.pos[pack, 2 * p + 1, k], model.frame[mesh]
        if not on_lattice(x, x, y, y):
            return
        size = model.terrain[frame]
        cx, cy = int(wp.floor(x * real(1.0 / VOXEL))), int(wp.floor(y * real(1.0 / VOXEL)))
        cell = cy * size[0] + cx
        bits = sides_at(model.terrain_side, size, frame, cx, cy)
        if bits != 0:
            side(model, data, tape, frame, pack, k, p, row, cell, nearest_side(model, frame, cell, bits, x, y))
            return
        if (sides_at(model.terrain_side, size, frame, cx, cy - 1) & TOP) != 0:
            side(model, data, tape, frame, pack, k, p, row, cell - size[0], TOP)
        if (sides_at(model.terrain_side, size, frame, cx, cy + 1) & BOTTOM) != 0:
            side(model, data, tape, frame, pack, k, p, row, cell + size[0], BOTTOM)
        if (sides_at(model.terrain_side, size, frame, cx - 1, cy) & RIGHT) != 0:
            side(model, data, tape, frame, pack, k, p, row, cell - 1, RIGHT)
        if (sides_at(model.terrain_side, size, frame, cx + 1, cy) & LEFT) != 0:
            side(model, data, tape, frame, pack, k, p, row, cell + 1, LEFT)

    @kit.func
    def near(model, data, tape, mesh, pack, lane, unit):
        first = (tape.substeps[unit] - 1) * model.points[mesh]
        for n in range(data.near_count[unit]):
            v = data.near[unit, n]
            for c in range(int(4)):
                p = model.corner[mesh, v][c]
                for k in range(lane, lane + int(width)):
                    if ((model.side_lanes[mesh, v][0] | model.side_lanes[mesh, v][1] | model.side_lanes[mesh, v][2]
                         | model.side_lanes[mesh, v][3]) >> k) & 1 == 1:
                        point(model, data, tape, mesh, pack, k, p, first + p)

    return near


@functools.cache
def reverse_kernel(precision: str, width: int) -> wp.Kernel:
    """The kernel; launch over (units of a pack, packs) with the first pack of this launch."""
    kit = kit_of(precision, width)
    begin, set_goals = save(kit), goals(kit)
    stages = boxes(kit), collect(kit), contacts(kit), runge_kutta(kit), limit(kit)
    bounds, candidates, contact, motion, strain = stages
    soft = ground(kit)

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
            soft(model, data, tape, mesh, pack, lane, unit)
            motion(model, data, mesh, pack, lane, unit, dt)
            strain(model, data, mesh, pack, lane, unit, dt)
        keep(model, data, tape, mesh, pack, lane, unit)
        go_back(model, data, tape, mesh, pack, lane, unit, dt)
        by_actions(model, tape, mesh, pack, lane, unit)

    return reverse_step


def record_reverse(state, tape, substeps: int, first: int, packs: int):
    """A command for the packs ``first`` to ``first + packs``: a control step from the state and the actions taken, which

    leaves the state at its end, and back; ``tape`` is the struct, with what a loss has for derivatives by the state at
    the end in ``by_pos``, ``by_vel`` and ``by_true_vel``.
    """
    inputs = [state.model, state.data, tape, state.units, first, substeps, state.dt]
    return record(reverse_kernel(state.precision, state.width), (packs, state.units), inputs, state.device)
