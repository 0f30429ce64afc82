"""Divergence: environments whose state is not finite or out of bounds, at the start and at the end of a control step.

An environment that has diverged goes on being computed until the control step is over and is then undone. It disturbs
no other: lanes meet in the candidates of contacts alone, whose list has room for all pairs where lanes share it.
"""

import warp as wp

from warpvox.kernels.kit import Kit, builder
from warpvox.kernels.state import DIVERGED

FASTEST = 1.0e4
"""Speed of a point, in units of inner time, beyond which a simulation has diverged.

At this speed a point crosses ten voxels between two looks at contacts: what follows is no simulation of anything. A
fall without end reaches gravity / drag = 1100; benchmark tasks under random and alternating actions stay below 30.
"""
FARTHEST = 1.0e6
"""Coordinate beyond which it has diverged: no lattice goes so far, so that contacts are not looked for there."""


@builder
def diverged(kit: Kit):
    """Function: set DIVERGED in the status of lanes that are not finite or beyond the bounds; the sound lanes."""
    width, full = kit.width, kit.full

    @kit.func
    def mark(model, data, mesh, pack, lane):
        sound = int(full)
        far, fast = kit.wide.splat(wp.float64(FARTHEST)), kit.wide.splat(wp.float64(FASTEST))
        for r in range(2 * model.points[mesh]):
            sound = sound & kit.wide.within(kit.wide.load(data.pos, pack, r, lane), far)
            sound = sound & kit.wide.within(kit.wide.load(data.vel, pack, r, lane), fast)
            sound = sound & kit.wide.within(kit.wide.load(data.true_vel, pack, r, lane), fast)
        if sound != int(full):
            for k in range(int(width)):
                if ((sound >> k) & 1) == 0:
                    data.status[pack, lane + k] = data.status[pack, lane + k] | DIVERGED
        return sound

    return mark


@builder
def restore(kit: Kit):
    """Function: one lane goes back to the start of the control step."""

    @kit.func
    def back(model, data, mesh, pack, k):
        for n in range(2 * model.actives[mesh]):
            r = model.active[mesh, n]
            data.pos[pack, r, k] = data.saved_pos[pack, r, k]
            data.vel[pack, r, k] = data.saved_vel[pack, r, k]
            data.true_vel[pack, r, k] = data.saved_true_vel[pack, r, k]

    return back
