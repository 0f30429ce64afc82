"""Spring, gravity, drag and floor forces, integrated by RK4 over positions and velocities (paper section A.2).

The sub-step itself is in ``native/integrate.h``.
"""

import warp as wp

from warpvox.kernels.kit import Kit, builder


@builder
def runge_kutta(kit: Kit):
    """Stage: displacement and new velocity of every free point after dt."""

    @kit.func_native("native/springs.h", "native/forces.h", "native/integrate.h")
    def substep(model, data, mesh, pack, lane, dt): ...

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        substep(model, data, mesh, pack, lane, dt)

    return stage


@builder
def advance(kit: Kit):
    """Stage: positions move; true velocity and drift follow."""

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        path = kit.wide.splat(wp.float64(0.0))
        for n in range(2 * model.actives[mesh]):
            r = model.active[mesh, n]
            move = kit.wide.load(data.move, pack, r, lane)
            kit.wide.store(data.pos, pack, r, lane, kit.wide.load(data.pos, pack, r, lane) + move)
            kit.wide.store(data.true_vel, pack, r, lane, move * (wp.float64(1.0) / dt))
            path = kit.wide.grow(path, move)
        data.drift[unit] = data.drift[unit] + kit.wide.largest(path)

    return stage
