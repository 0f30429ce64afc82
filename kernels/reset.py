"""Masked reset, frozen environments and state in and out, without host synchronisation."""

import functools

import warp as wp

from warpvox.kernels.guard import diverged, restore
from warpvox.kernels.lanes import inline, lane_ops
from warpvox.kernels.state import DIVERGED, OVERFLOW, UNSTABLE, structs

STALE = 1.0e9  # a drift that makes the next sub-step collect its candidates anew


@functools.cache
def save(precision: str, width: int):
    """Stage, at the start of a control step: remember the state; bad numbers that were put there go home first."""
    ops, types = lane_ops("float64", width), structs(precision)
    load, store = ops.load, ops.store
    mark, full = diverged(precision, width), ops.full

    @inline
    def go_home(model: types.Model, data: types.Data, design: int, pack: int, k: int):
        for r in range(2 * model.points[design]):
            data.pos[pack, r, k] = model.home[design, r]
            data.vel[pack, r, k] = wp.float64(0.0)
            data.true_vel[pack, r, k] = wp.float64(0.0)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        if mark(model, data, design, pack, lane) != int(full):
            for k in range(lane, lane + int(width)):
                if (data.status[pack, k] & DIVERGED) != 0:
                    go_home(model, data, design, pack, k)
                    data.drift[unit] = wp.float64(STALE)
        for n in range(2 * model.actives[design]):
            r = model.active[design, n]
            store(data.saved_pos, pack, r, lane, load(data.pos, pack, r, lane))
            store(data.saved_vel, pack, r, lane, load(data.vel, pack, r, lane))
            store(data.saved_true_vel, pack, r, lane, load(data.true_vel, pack, r, lane))

    return stage


@functools.cache
def settle(precision: str, width: int):
    """Stage, at the end of a control step: frozen and stopped environments go back to its start."""
    types = structs(precision)
    mark, undo = diverged(precision, width), restore(precision)

    @inline
    def stage(model: types.Model, data: types.Data, design: int, pack: int, lane: int, unit: int, dt: wp.float64):
        mark(model, data, design, pack, lane)
        for e in range(lane, lane + int(width)):
            if data.overflow[unit] == 1:
                data.status[pack, e] = data.status[pack, e] | OVERFLOW
            if data.frozen[pack, e] == 1:
                data.status[pack, e] = 0
            if data.frozen[pack, e] == 1 or (data.status[pack, e] & (UNSTABLE | DIVERGED)) != 0:
                undo(model, data, design, pack, e)
                data.drift[unit] = wp.float64(STALE)
            else:
                data.time[pack, e] = data.time[pack, e] + 1

    return stage


@functools.cache
def reset_kernel(precision: str):
    """Kernel over environments: those with a mask go back to time 0."""
    types = structs(precision)

    @wp.kernel(enable_backward=False, module="unique")
    def reset(
        model: types.Model, data: types.Data, units: int, width: int,
        env_pack: wp.array(dtype=int), env_lane: wp.array(dtype=int), mask: wp.array(dtype=wp.bool),
    ):  # fmt: skip
        env = wp.tid()
        if not mask[env]:
            return
        pack, k = env_pack[env], env_lane[env]
        design = model.pack_design[pack]
        zero = wp.float64(0.0)
        for r in range(2 * model.points[design]):
            data.pos[pack, r, k] = model.home[design, r]
            data.vel[pack, r, k] = zero
            data.true_vel[pack, r, k] = zero
        data.time[pack, k] = 0
        data.status[pack, k] = 0
        data.frozen[pack, k] = 0
        data.drift[pack * units + k // width] = wp.float64(STALE)

    return reset


def launch(state, mask):
    """Reset the environments of a mask, a Warp bool array [environment]."""
    wp.launch(
        reset_kernel(state.precision),
        state.num_envs,
        [state.model, state.data, state.units, state.width, state.env_pack, state.env_lane, mask],
        device=state.device,
    )
