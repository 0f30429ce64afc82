"""Spring, gravity, drag and floor forces, integrated by RK4 over positions and velocities (paper section A.2).

The sub-step itself is in ``native/integrate.h``.
"""

import functools
from pathlib import Path

import warp as wp

from warpvox.kernels.lanes import inline, lane_ops, native
from warpvox.kernels.state import structs

SUBSTEP = Path(__file__).with_name("native").joinpath("integrate.h").read_text(encoding="utf-8")


@functools.cache
def runge_kutta(precision: str, width: int):
    """Stage: displacement and new velocity of every free point after dt."""
    types = structs(precision)

    @wp.func_native(native(precision, width) + SUBSTEP)
    def substep(model: types.Model, data: types.Data, design: int, pack: int, lane: int, dt: wp.float64): ...

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        substep(model, data, design, pack, lane, dt)

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
