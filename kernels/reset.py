"""Masked reset of environments, and restoring of frozen and undone ones after a step, without waiting on the host."""

import warp as wp

from warpvox.kernels import device
from warpvox.kernels.device import kernel
from warpvox.kernels.kit import Kit, builder
from warpvox.kernels.state import STALE


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
