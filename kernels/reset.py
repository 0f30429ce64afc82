"""Masked reset of environments, and restoring of frozen and undone ones after a step, without waiting on the host."""

import warp as wp

from warpvox.kernels import device
from warpvox.kernels.device import kernel
from warpvox.kernels.kit import Kit, builder
from warpvox.kernels.state import STALE
from warpvox.types import VOXEL


@builder
def save(kit: Kit):
    """Build the first stage of a control step: stop diverged environments, then save the state of all."""
    return kit.stage("native/springs.h", "native/bounds.h", "native/save.h")


@builder
def settle(kit: Kit):
    """Build the last stage of a control step: restore the saved state of frozen and undone environments."""
    return kit.stage("native/springs.h", "native/bounds.h", "native/settle.h")


@builder
def reset_kernel(kit: Kit):
    """Build the kernel that resets environments with a True mask to time 0, one thread per environment."""

    @kernel
    def reset(
        model: kit.Model, data: kit.Data, units: int, width: int,
        env_pack: wp.array(dtype=int), env_lane: wp.array(dtype=int), mask: wp.array(dtype=wp.bool),
    ):  # fmt: skip
        """Reset one environment to time 0 if its mask is True."""
        env = wp.tid()
        if not mask[env]:
            return
        pack, k = env_pack[env], env_lane[env]
        mesh = model.pack_mesh[pack]
        zero = wp.float64(0.0)
        for r in range(2 * model.points[mesh]):
            data.pos[pack, r, k] = model.rest_pos[mesh, r, k]
            data.vel[pack, r, k] = zero
            data.true_vel[pack, r, k] = zero
        data.time[pack, k] = 0
        data.status[pack, k] = 0
        data.frozen[pack, k] = 0
        data.drift[pack * units + k // width] = wp.float64(STALE)

    return reset


def launch(state, mask):
    """Reset the environments where ``mask``, a Warp bool array [environment], is True."""
    inputs = [state.model, state.data, state.units, state.width, state.env_pack, state.env_lane, mask]
    device.launch(reset_kernel(state.precision), state.num_envs, inputs, state.device)


@builder
def shift_kernel(kit: Kit) -> wp.Kernel:
    """Build the kernel over (environments, points) that moves points of objects to cells, at rest."""

    @kernel
    def shift(
        data: kit.Data,
        env_pack: wp.array(dtype=int),
        env_lane: wp.array(dtype=int),
        mask: wp.array(dtype=wp.bool),
        cells: wp.array2d(dtype=wp.int64),
        points: wp.array3d(dtype=wp.int64),
    ):
        """Move one point, if the mask is True: by the expressions with which a world is compiled, to the last bit."""
        env, n = wp.tid()
        if not mask[env]:
            return
        side = wp.float64(VOXEL)
        x = wp.float64(points[env, n, 1] + cells[env, 0]) * side
        y = wp.float64(points[env, n, 2] + cells[env, 1]) * side
        height = wp.float64(points[env, n, 3])
        across = wp.float64(points[env, n, 4])
        down = wp.float64(points[env, n, 5])
        place = wp.vec2d(x + across * side, (y + height * side) - down * side)
        pack = env_pack[env]
        k = env_lane[env]
        for axis in range(int(2)):
            r = 2 * int(points[env, n, 0]) + axis
            data.pos[pack, r, k] = place[axis]
            data.vel[pack, r, k] = wp.float64(0.0)
            data.true_vel[pack, r, k] = wp.float64(0.0)

    return shift


def launch_shift(state, mask, cells, points):
    """Move points where ``mask`` is True; the others are Warp arrays of integers.

    Args:
        cells: [environment, axis], to the right and up from the places in the world.
        points: [environment, point, 6]: index, x, y and height of its object, its column and row in that.
    """
    inputs = [state.data, state.env_pack, state.env_lane, mask, cells, points]
    device.launch(shift_kernel(state.precision), points.shape[:2], inputs, state.device)


@builder
def follow_kernel(kit: Kit) -> wp.Kernel:
    """Build the kernel that copies the state of each leading point to the points that coincide with it.

    Twins are points that a lane joins into one, the leader.
    """

    @kernel
    def follow(model: kit.Model, data: kit.Data):
        """Copy the state of leading points to the points that coincide with them, in one lane."""
        pack, k = wp.tid()
        mesh = model.pack_mesh[pack]
        for e in range(model.twins[mesh]):
            if ((model.twin_lanes[mesh, e] >> k) & 1) == 1:
                pair = model.twin[mesh, e]
                for axis in range(int(2)):
                    r, leader = 2 * pair[0] + axis, 2 * pair[1] + axis
                    data.pos[pack, r, k] = data.pos[pack, leader, k]
                    data.vel[pack, r, k] = data.vel[pack, leader, k]
                    data.true_vel[pack, r, k] = data.true_vel[pack, leader, k]

    return follow


def launch_follow(state):
    """Copy the state of leading points to the points that coincide with them, after writing leaders only."""
    inputs = [state.model, state.data]
    device.launch(follow_kernel(state.precision), (state.packs, state.lanes), inputs, state.device)
