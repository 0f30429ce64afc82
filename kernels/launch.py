"""How stages run: alone, a kernel each (tests, per-stage times), or fused into a control step (``step.py``).

A stage is a Warp function ``(model, data, mesh, pack, lane, unit, dt)`` that serves the ``width`` environments
at ``lane`` of a pack. A *unit* is the thread that does so.
"""

import functools

import warp as wp

from warpvox.kernels.kit import kit_of

# Contacts at time 0 hang on the last bit of a double: round as the formulas are written, without fused operations.
EXACT = {"fuse_fp": False}


@functools.cache
def stage_kernel(build, precision: str, width: int) -> wp.Kernel:
    """The kernel that runs one stage; launch over (units of a pack, packs)."""
    kit = kit_of(precision, width)
    stage = build(kit)

    @wp.kernel(enable_backward=False, module="unique", module_options=EXACT)
    def kernel(model: kit.Model, data: kit.Data, units: int, dt: wp.float64):
        pack, part = wp.tid()
        stage(model, data, model.pack_mesh[pack], pack, part * width, pack * units + part, dt)

    return kernel


def launch_stage(build, state) -> None:
    """Run one stage for every environment of a :class:`warpvox.packs.State`."""
    kernel = stage_kernel(build, state.precision, state.width)
    wp.launch(
        kernel,
        (state.packs, state.units),
        [state.model, state.data, state.units, state.dt],
        device=state.device,
    )
