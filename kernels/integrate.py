"""Spring, gravity, drag and floor forces, integrated by RK4 over positions and velocities (paper section A.2).

The unknown is the displacement since the sub-step's start, never the position: a spring's stretch comes from
small differences, so that float32 keeps its relative precision wherever the robot stands.
"""

import functools

import warp as wp

from warpvox.kernels.lanes import casts, inline, lane_ops
from warpvox.kernels.launch import launch_stage
from warpvox.kernels.state import structs


@functools.cache
def outer_forces(precision: str, width: int):
    """Contact, drag, gravity and the implicit floor at y = 0, into ``force``."""
    ops, types = lane_ops(precision, width), structs(precision)
    real, load, store, splat = ops.real, ops.load, ops.store, ops.splat
    at_most, first, drop = ops.at_most, ops.first, ops.drop

    @inline
    def stand(model: types.Model, data: types.Data, pack: int, p: int, lane: int, y: real):
        normal = -model.floor_stiffness * wp.float64(y)
        grip = model.friction * normal
        slip = wp.float64(data.stage_vel[pack, 2 * p, lane])
        drag = real(model.floor_friction * grip * wp.tanh(slip * grip))
        data.force[pack, 2 * p, lane] = data.force[pack, 2 * p, lane] - drag
        data.force[pack, 2 * p + 1, lane] = data.force[pack, 2 * p + 1, lane] + real(normal)

    @inline
    def outer(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        weight = splat(model.gravity)
        for n in range(model.actives[design]):
            x = model.active[design, 2 * n]
            y, p = x + 1, x // 2
            fx = load(data.contact, pack, x, lane) - load(data.stage_vel, pack, x, lane) * model.drag
            fy = load(data.contact, pack, y, lane) - load(data.stage_vel, pack, y, lane) * model.drag - weight
            store(data.force, pack, x, lane, fx)
            store(data.force, pack, y, lane, fy)
            height = load(data.height, pack, p, lane) + load(data.disp, pack, y, lane)
            below = at_most(height, splat(real(0.0)))
            while below != 0:
                k = lane + first(below)
                stand(model, data, pack, p, k, data.height[pack, p, k] + data.disp[pack, y, k])
                below = drop(below)

    return outer


@functools.cache
def spring_forces(precision: str, width: int):
    """Hooke forces k (l - l_eq) along the springs, added to ``force`` in the order of the springs."""
    ops, types = lane_ops(precision, width), structs(precision)
    load, store, mul, div, root = ops.load, ops.store, ops.mul, ops.div, ops.root

    @inline
    def springs(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        for s in range(model.springs[design]):
            ends = model.spring_ends[design, s]
            a, b = 2 * ends[0], 2 * ends[1]
            ux = load(data.disp, pack, b, lane) - load(data.disp, pack, a, lane)
            uy = load(data.disp, pack, b + 1, lane) - load(data.disp, pack, a + 1, lane)
            dx = load(data.span, pack, 2 * s, lane)
            dy = load(data.span, pack, 2 * s + 1, lane)
            ex = dx + ux
            ey = dy + uy
            length = root(mul(ex, ex) + mul(ey, ey))
            # l - l0 = (|e|^2 - |d|^2) / (l + l0), without the cancellation
            stretch = div(mul(dx + ex, ux) + mul(dy + ey, uy), length + load(data.length, pack, s, lane))
            tension = div((stretch - load(data.pull, pack, s, lane)) * model.spring_k[design, s], length)
            fx = mul(tension, ex)
            fy = mul(tension, ey)
            store(data.force, pack, a, lane, load(data.force, pack, a, lane) + fx)
            store(data.force, pack, a + 1, lane, load(data.force, pack, a + 1, lane) + fy)
            store(data.force, pack, b, lane, load(data.force, pack, b, lane) - fx)
            store(data.force, pack, b + 1, lane, load(data.force, pack, b + 1, lane) - fy)

    return springs


@functools.cache
def runge_kutta(precision: str, width: int):
    """Stage: displacement and new velocity of every free point after dt."""
    ops, types = lane_ops(precision, width), structs(precision)
    real, load, store, splat = ops.real, ops.load, ops.store, ops.splat
    wide, cast = lane_ops("float64", width), casts(precision, width)
    load_state, store_state, widen, narrow = wide.load, wide.store, cast.widen, cast.narrow
    outer = outer_forces(precision, width)
    springs = spring_forces(precision, width)

    @inline
    def start(model: types.Model, data: types.Data, design: int, pack: int, lane: int):
        zero = splat(real(0.0))
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            velocity = narrow(load_state(data.vel, pack, r, lane))
            store(data.start_vel, pack, r, lane, velocity)
            store(data.stage_vel, pack, r, lane, velocity)
            store(data.disp, pack, r, lane, zero)
            store(data.sum_bend, pack, r, lane, zero)
            store(data.sum_vel, pack, r, lane, zero)
        for n in range(model.actives[design]):
            y = model.active[design, 2 * n + 1]
            store(data.height, pack, y // 2, lane, narrow(load_state(data.pos, pack, y, lane)))

    @inline
    def slope(
        model: types.Model,
        data: types.Data,
        design: int,
        pack: int,
        lane: int,
        weight: real,
        bend: real,
        ahead: real,
    ):
        """Add a stage's acceleration to the sums, and go to the next stage, ``ahead`` of the start."""
        outer(model, data, design, pack, lane)
        springs(model, data, design, pack, lane)
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            force = load(data.force, pack, r, lane)
            store(data.sum_bend, pack, r, lane, load(data.sum_bend, pack, r, lane) + force * bend)
            store(data.sum_vel, pack, r, lane, load(data.sum_vel, pack, r, lane) + force * weight)
            store(data.disp, pack, r, lane, load(data.stage_vel, pack, r, lane) * ahead)
            store(data.stage_vel, pack, r, lane, load(data.start_vel, pack, r, lane) + force * ahead)

    @inline
    def finish(data: types.Data, pack: int, r: int, lane: int, dt: wp.float64, free: wp.float64):
        """x += dt v + dt^2 / 6 (a1 + a2 + a3) and v += dt / 6 (a1 + 2 a2 + 2 a3 + a4), in float64."""
        velocity = load_state(data.vel, pack, r, lane)
        sixth = free * dt / wp.float64(6.0)
        move = velocity * (free * dt) + widen(load(data.sum_bend, pack, r, lane)) * (sixth * dt)
        store_state(data.move, pack, r, lane, move)
        store(data.disp, pack, r, lane, narrow(move))
        store_state(data.vel, pack, r, lane, velocity + widen(load(data.sum_vel, pack, r, lane)) * sixth)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        start(model, data, design, pack, lane)
        step = real(dt)
        stages = int(4)  # a constant bound would be unrolled
        for k in range(stages):
            inner = k == 1 or k == 2
            weight = wp.where(inner, real(2.0), real(1.0))
            bend = wp.where(k < 3, real(1.0), real(0.0))
            ahead = wp.where(k < 2, step * real(0.5), step)
            slope(model, data, design, pack, lane, weight, bend, ahead)
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            # A fixed point takes part in the stages; only its update is dropped.
            finish(data, pack, r, lane, dt, wp.float64(1 - model.fixed[design, r // 2]))

    return stage


@functools.cache
def advance(precision: str, width: int):
    """Stage: positions move; true velocity and drift follow."""
    ops, types = lane_ops("float64", width), structs(precision)
    load, store, splat, grow, largest = ops.load, ops.store, ops.splat, ops.grow, ops.largest

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        path = splat(wp.float64(0.0))
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            move = load(data.move, pack, r, lane)
            store(data.pos, pack, r, lane, load(data.pos, pack, r, lane) + move)
            store(data.true_vel, pack, r, lane, move * (wp.float64(1.0) / dt))
            path = grow(path, move)
        data.drift[unit] = data.drift[unit] + largest(path)

    return stage


def launch(state):
    """Displacements and velocities after one sub-step, from the current contacts and pulls."""
    launch_stage(runge_kutta, state)


def launch_advance(state):
    """Move the points."""
    launch_stage(advance, state)
