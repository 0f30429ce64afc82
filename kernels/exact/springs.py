"""Springs and strain limits in float64, with the released simulator's rounding.

Sums and products are taken in its order, so that runs are equal bit for bit, which neither chaos nor ties can tell
apart. Fast arithmetic is the same physics on displacements; here ``disp`` is the position after the sub-step.
"""

from warpvox.kernels.kit import Kit, builder


@builder
def runge_kutta(kit: Kit):
    """Build the stage that integrates every free point over ``dt`` from spring forces."""
    return kit.stage("native/tanh.h", "native/springs.h", "exact/substep.h")


@builder
def limit(kit: Kit):
    """Build the stage that applies strain limits to the new positions, then recomputes velocities and drift."""
    return kit.stage("native/springs.h", "exact/limit.h")


STAGES = (runge_kutta, limit)
