"""Delayed actuation: clip the actions, set each spring's goal, and let its rest length relax toward that goal.

Every spring, actuated or not, has in each sub-step the equilibrium length l + rate (goal - l), where l is its
length at the sub-step's start (paper section A.4). This relaxation is also what damps the bodies.
"""

from warpvox.kernels.kit import Kit, builder


@builder
def goals(kit: Kit):
    """Stage, once a control step: goal = rest length x mean of the actions that drive the spring."""

    @kit.func_native("native/goals.h", precision="float64")
    def aim(model, data, mesh, pack, lane): ...

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        aim(model, data, mesh, pack, lane)

    return stage


@builder
def creep(kit: Kit):
    """Stage, every sub-step: spring vector, length and pull = equilibrium length - length at its start.

    Lengths are subtracted in float64: their rounding would act like another goal.
    """
    load = kit.wide.load

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        for s in range(model.springs[mesh]):
            a, b = 2 * model.spring_ends[mesh, s][0], 2 * model.spring_ends[mesh, s][1]
            dx = load(data.pos, pack, b, lane) - load(data.pos, pack, a, lane)
            dy = load(data.pos, pack, b + 1, lane) - load(data.pos, pack, a + 1, lane)
            length = kit.wide.root(kit.wide.mul(dx, dx) + kit.wide.mul(dy, dy))
            pull = (load(data.goal, pack, s, lane) - length) * model.actuation_rate
            kit.store(data.span, pack, 2 * s, lane, kit.narrow(dx))
            kit.store(data.span, pack, 2 * s + 1, lane, kit.narrow(dy))
            kit.store(data.length, pack, s, lane, kit.narrow(length))
            kit.store(data.pull, pack, s, lane, kit.narrow(pull))

    return stage
