"""Springs in fast arithmetic: goals, forces and motion, strain limits (paper sections A.2 and A.4)."""

from warpvox.kernels.kit import Kit, builder


@builder
def goals(kit: Kit):
    """Build the stage that sets each spring's goal length, once a control step.

    The goal is the rest length times the mean of the actions that drive the spring.
    """
    return kit.stage("native/goals.h", precision="float64")


@builder
def runge_kutta(kit: Kit):
    """Build the stage that integrates every free point over ``dt``: displacement and new velocity.

    Every spring, actuated or not, has in each sub-step the equilibrium length l + rate (goal - l), where l is its
    length at the sub-step's start (section A.4). This relaxation is also what damps the bodies. Its force, gravity,
    drag, contacts and the floor are integrated by RK4.
    """
    return kit.stage("native/tanh.h", "native/springs.h", "native/forces.h", "native/integrate.h")


@builder
def limit(kit: Kit):
    """Build the stage that applies the strain limits, which change positions but not velocities.

    Then it computes new positions, true velocity and drift.

    First pass: all springs from one snapshot, beyond ``strain_limit`` (25 % of the rest length). Second pass: the sides
    of rigid voxels one after another, in place, beyond ``rigid_strain_limit`` (3 %). Each end of a spring moves by the
    pass's share of half the excess.
    """
    return kit.stage("native/springs.h", "native/limit.h")
