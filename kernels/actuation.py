"""Delayed actuation: clip the actions, set each spring's goal, and let its rest length relax toward that goal.

Every spring, actuated or not, has in each sub-step the equilibrium length l + rate (goal - l), where l is its
length at the sub-step's start (paper section A.4). This relaxation is also what damps the bodies.
"""

import warp as wp

from warpvox.kernels.kit import Kit, builder


@builder
def goals(kit: Kit):
    """Stage, once a control step: goal = rest length x mean of the actions that drive the spring."""
    load = kit.wide.load

    @kit.func
    def stage(model, data, design, pack, lane, unit, dt):
        for s in range(model.springs[design]):
            rest = model.spring_rest[design, s]
            drive = model.spring_drive[design, s]
            goal = kit.wide.splat(rest)
            if drive[1] >= 0:
                both = load(data.action, pack, drive[0], lane) + load(data.action, pack, drive[1], lane)
                goal = both * (rest * wp.float64(0.5))
            elif drive[0] >= 0:
                goal = load(data.action, pack, drive[0], lane) * rest
            kit.wide.store(data.goal, pack, s, lane, goal)

    return stage


@builder
def creep(kit: Kit):
    """Stage, every sub-step: spring vector, length and pull = equilibrium length - length at its start.

    Lengths are subtracted in float64: their rounding would act like another goal.
    """
    load = kit.wide.load

    @kit.func
    def stage(model, data, design, pack, lane, unit, dt):
        for s in range(model.springs[design]):
            a, b = 2 * model.spring_ends[design, s][0], 2 * model.spring_ends[design, s][1]
            dx = load(data.pos, pack, b, lane) - load(data.pos, pack, a, lane)
            dy = load(data.pos, pack, b + 1, lane) - load(data.pos, pack, a + 1, lane)
            length = kit.wide.root(kit.wide.mul(dx, dx) + kit.wide.mul(dy, dy))
            pull = (load(data.goal, pack, s, lane) - length) * model.actuation_rate
            kit.store(data.span, pack, 2 * s, lane, kit.narrow(dx))
            kit.store(data.span, pack, 2 * s + 1, lane, kit.narrow(dy))
            kit.store(data.length, pack, s, lane, kit.narrow(length))
            kit.store(data.pull, pack, s, lane, kit.narrow(pull))

    return stage
