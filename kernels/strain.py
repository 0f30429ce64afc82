"""Strain limiting (paper section A.4): moves points, leaves velocities alone.

First pass: all springs from one snapshot, beyond ``strain_limit`` (25 % of the rest length). Second pass: the sides of
rigid voxels one after another, in place, beyond ``rigid_strain_limit`` (3 %). Each end of a spring moves by the pass's
share of half the excess. Both passes work on displacements, after the integration; they are in ``native/strain.h``.
"""

from warpvox.kernels.kit import Kit, builder


@builder
def limit(kit: Kit):
    """Stage: both passes."""

    @kit.func_native("native/springs.h", "native/strain.h")
    def passes(model, data, mesh, pack, lane): ...

    @kit.func
    def stage(model, data, mesh, pack, lane, unit, dt):
        passes(model, data, mesh, pack, lane)

    return stage
